//! Format of the samples of a stream.

use bytes::Bytes;
use flankwatch_signal::Tachometer;
use serde::{Deserialize, Serialize};

use super::super::{RawLayout, RawSample, RecordingError};
use super::TachometerChannel;

/// Highest sampling rate in hertz.
const MAX_RATE_HZ: f64 = 1e7;

/// Format of the samples of a stream. It is the same for the whole stream.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StreamFormat {
    sample: RawSample,
    sample_rate_hz: f64,
    pub(super) channels: u32,
    scale: Option<f64>,
    /// Unit of the samples, if the sender states it.
    pub unit: Option<String>,
    /// Names of the channels in order; empty if the sender does not state them.
    pub channel_names: Vec<String>,
    #[serde(default)]
    pub(super) tachometer: Option<TachometerChannel>,
}

impl StreamFormat {
    /// Creates a format. `scale` is the value of one count in the unit.
    ///
    /// # Errors
    /// An invalid rate, number of channels or scale.
    pub fn new(
        sample: RawSample,
        sample_rate_hz: f64,
        channels: u32,
        scale: Option<f64>,
    ) -> Result<Self, RecordingError> {
        if !(1.0..=MAX_RATE_HZ).contains(&sample_rate_hz) {
            return Err(RecordingError::field("sample_rate_hz", sample_rate_hz, "a rate from 1 to 1e7 Hz"));
        }
        RawLayout::new(sample, sample_rate_hz, channels, scale)?;
        let (unit, channel_names, tachometer) = (None, Vec::new(), None);
        Ok(Self { sample, sample_rate_hz, channels, scale, unit, channel_names, tachometer })
    }

    /// Sets the unit and the names of the channels.
    ///
    /// # Errors
    /// The number of names differs from that of the channels, or a name occurs twice.
    pub fn with_names(
        mut self,
        unit: Option<String>,
        channel_names: Vec<String>,
    ) -> Result<Self, RecordingError> {
        let is_repeated = (1..channel_names.len()).any(|n| channel_names[..n].contains(&channel_names[n]));
        if is_repeated || !channel_names.is_empty() && channel_names.len() != self.channels as usize {
            let expected = "one unique name per channel";
            return Err(RecordingError::field("channel_names", channel_names.join(","), expected));
        }
        self.unit = unit;
        self.channel_names = channel_names;
        Ok(self)
    }

    /// Returns the sampling rate in hertz, as stated by the sender.
    pub fn sample_rate_hz(&self) -> f64 {
        self.sample_rate_hz
    }

    /// Returns the number of channels.
    pub fn channels(&self) -> usize {
        self.channels as usize
    }

    /// Returns the type of a sample.
    pub fn sample(&self) -> RawSample {
        self.sample
    }

    /// Returns the bytes of one frame: one sample of every channel.
    pub fn frame_bytes(&self) -> usize {
        self.sample.bytes() * self.channels()
    }

    /// Returns the first field in which another format differs, with its value there and here.
    pub fn difference(&self, other: &Self) -> Option<(&'static str, String, String)> {
        let pairs = self.fields().into_iter().zip(other.fields());
        let differs = pairs.filter(|((_, own), (_, others))| own != others);
        differs.map(|((name, own), (_, others))| (name, others, own)).next()
    }

    /// The fields, as a sender states them.
    fn fields(&self) -> [(&'static str, String); 10] {
        fn text<T: ToString>(value: Option<T>) -> String {
            value.map_or_else(|| "not given".to_owned(), |value| value.to_string())
        }
        let names = Some(self.channel_names.join(",")).filter(|names| !names.is_empty());
        let tachometer = self.tachometer.as_ref();
        [
            ("sample", self.sample.name().to_owned()),
            ("sample_rate_hz", self.sample_rate_hz.to_string()),
            ("channels", self.channels.to_string()),
            ("scale", text(self.scale)),
            ("unit", text(self.unit.as_ref())),
            ("channel_names", text(names)),
            ("tachometer_channel", text(tachometer.map(|tachometer| self.name_of(tachometer)))),
            ("tachometer_level", text(tachometer.map(TachometerChannel::level))),
            ("tachometer_hysteresis", text(tachometer.map(TachometerChannel::hysteresis))),
            ("pulses_per_revolution", text(tachometer.map(TachometerChannel::pulses_per_revolution))),
        ]
    }

    /// Returns the layout for reading bytes of the stream as a record.
    ///
    /// # Errors
    /// Only for a damaged stored format, not for one created by [`new`](Self::new).
    pub fn layout(&self) -> Result<RawLayout, RecordingError> {
        RawLayout::new(self.sample, self.sample_rate_hz, self.channels, self.scale)
    }

    /// Returns the values of frames in the stream's unit, channels interleaved.
    pub fn values<'a>(&self, frames: &'a [u8]) -> impl Iterator<Item = f32> + 'a {
        let (sample, scale) = (self.sample, self.value_of_count());
        frames.chunks_exact(sample.bytes()).map(move |bytes| (sample.value(bytes) * scale) as f32)
    }

    /// Returns the value of the first sample of some bytes in the stream's unit.
    pub(super) fn value(&self, bytes: &[u8]) -> f64 {
        self.sample.value(bytes) * self.value_of_count()
    }

    fn value_of_count(&self) -> f64 {
        self.scale.unwrap_or(self.sample.default_scale())
    }

    /// Converts frames to seconds, at the sender's rate.
    pub fn seconds(&self, frames: u64) -> f64 {
        frames as f64 / self.sample_rate_hz
    }

    /// Converts seconds to frames, at the sender's rate.
    pub fn frames_in(&self, seconds: f64) -> u64 {
        (seconds * self.sample_rate_hz).round() as u64
    }
}

impl StreamFormat {
    /// Sets the channel that is a tachometer, by its name: one of `channel_names`, or else its number from 1.
    ///
    /// # Errors
    /// There is no such channel, or no other one; an invalid level.
    pub fn with_tachometer(
        mut self,
        channel: &str,
        level: f64,
        hysteresis: Option<f64>,
        pulses_per_revolution: u32,
    ) -> Result<Self, RecordingError> {
        let Some(position) = self.names().iter().position(|name| name == channel) else {
            return Err(RecordingError::field("tachometer_channel", channel, "the name of a channel"));
        };
        if self.channels() < 2 {
            let expected = "one of several channels: another one measures vibration";
            return Err(RecordingError::field("tachometer_channel", channel, expected));
        }
        self.tachometer = Some(TachometerChannel::new(position, level, hysteresis, pulses_per_revolution)?);
        Ok(self)
    }

    /// Returns the channel that is a tachometer.
    pub fn tachometer(&self) -> Option<&TachometerChannel> {
        self.tachometer.as_ref()
    }

    /// Returns the name of the channel that is a tachometer.
    pub fn name_of(&self, tachometer: &TachometerChannel) -> String {
        self.names().into_iter().nth(tachometer.channel).unwrap_or_default()
    }

    /// Returns the names of the channels, which are numbers from 1 unless they are stated.
    pub fn names(&self) -> Vec<String> {
        if self.channel_names.is_empty() {
            return (1..=self.channels()).map(|number| number.to_string()).collect();
        }
        self.channel_names.clone()
    }

    /// Returns the names of the channels that are not a tachometer.
    pub fn signal_names(&self) -> Vec<String> {
        let mut names = self.names();
        if let Some(tachometer) = &self.tachometer {
            names.remove(tachometer.channel);
        }
        names
    }

    /// Returns the pulses in frames of which `lead` precede a record; `None` without any.
    pub fn pulses(&self, frames: &[u8], lead: u64) -> Option<Tachometer> {
        let tachometer = self.tachometer.as_ref()?;
        let place = tachometer.channel * self.sample().bytes();
        let signal = frames.chunks_exact(self.frame_bytes()).map(|frame| self.value(&frame[place..]));
        let seconds = |position: f64| (position - lead as f64) / self.sample_rate_hz();
        let pulse_times_s: Vec<f64> = tachometer.crossings(signal).map(seconds).collect();
        let pulses_per_revolution = tachometer.pulses_per_revolution();
        (!pulse_times_s.is_empty()).then_some(Tachometer { pulse_times_s, pulses_per_revolution })
    }

    /// Returns the format of the other channels, and frames of only these.
    pub fn without_tachometer(&self, frames: Bytes) -> (Self, Bytes) {
        let Some(tachometer) = &self.tachometer else { return (self.clone(), frames) };
        let channel_names = self.signal_names();
        let place = tachometer.channel * self.sample().bytes();
        let after = place + self.sample().bytes();
        let mut others = Vec::with_capacity(frames.len() / self.channels() * channel_names.len());
        for frame in frames.chunks_exact(self.frame_bytes()) {
            others.extend_from_slice(&frame[..place]);
            others.extend_from_slice(&frame[after..]);
        }
        let mut format = self.clone();
        format.channels -= 1;
        (format.channel_names, format.tachometer) = (channel_names, None);
        (format, others.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_field_that_differs_is_named() {
        let format = |rate_hz, scale| StreamFormat::new(RawSample::F32, rate_hz, 2, scale).unwrap();
        let own = format(1000.0, None);
        assert_eq!(own.difference(&own), None);
        let difference = |other: StreamFormat| own.difference(&other).unwrap();
        let rate = difference(format(2000.0, Some(2.0)));
        assert_eq!(rate, ("sample_rate_hz", "2000".to_owned(), "1000".to_owned()));
        assert_eq!(difference(format(1000.0, Some(2.0))).0, "scale");
        let named = own.clone().with_names(None, vec!["a".to_owned(), "b".to_owned()]).unwrap();
        assert_eq!(difference(named), ("channel_names", "a,b".to_owned(), "not given".to_owned()));
        let with_pulses = own.clone().with_tachometer("2", 1.0, None, 1).unwrap();
        assert_eq!(difference(with_pulses).0, "tachometer_channel");
    }
}
