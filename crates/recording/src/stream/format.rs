//! What has to be known to read the samples of a stream.

use serde::{Deserialize, Serialize};

use super::super::{RawLayout, RawSample, RecordingError};

/// The highest sampling rate in hertz.
const MAX_RATE_HZ: f64 = 1e7;

/// How the samples of a stream are written. It stays the same for the whole stream.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StreamFormat {
    sample: RawSample,
    sample_rate_hz: f64,
    channels: u32,
    scale: Option<f64>,
    /// Unit of the samples, where the sender says it.
    pub unit: Option<String>,
    /// Names of the channels in their order; empty where the sender does not say them.
    pub channel_names: Vec<String>,
}

impl StreamFormat {
    /// Checks the parts. `scale` is the value of one count in the unit.
    ///
    /// # Errors
    /// A rate, number of channels, scale or list of names that cannot be used.
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
        Ok(Self { sample, sample_rate_hz, channels, scale, unit: None, channel_names: Vec::new() })
    }

    /// The same with a unit and the names of the channels.
    ///
    /// # Errors
    /// Not as many names as channels, or a name twice.
    pub fn with_names(
        mut self,
        unit: Option<String>,
        channel_names: Vec<String>,
    ) -> Result<Self, RecordingError> {
        let is_repeated = (1..channel_names.len()).any(|n| channel_names[..n].contains(&channel_names[n]));
        if is_repeated || !channel_names.is_empty() && channel_names.len() != self.channels as usize {
            let expected = "a name of its own for each channel";
            return Err(RecordingError::field("channel_names", channel_names.join(","), expected));
        }
        self.unit = unit;
        self.channel_names = channel_names;
        Ok(self)
    }

    /// Sampling rate in hertz, as the sender says it.
    pub fn sample_rate_hz(&self) -> f64 {
        self.sample_rate_hz
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.channels as usize
    }

    /// How one sample is written.
    pub fn sample(&self) -> RawSample {
        self.sample
    }

    /// Bytes of one frame: one sample of every channel.
    pub fn frame_bytes(&self) -> usize {
        self.sample.bytes() * self.channels()
    }

    /// How bytes of the stream are read as a record.
    ///
    /// # Errors
    /// None for a format made by [`new`](Self::new); a stored one may be damaged.
    pub fn layout(&self) -> Result<RawLayout, RecordingError> {
        RawLayout::new(self.sample, self.sample_rate_hz, self.channels, self.scale)
    }

    /// The values of frames in the stream's unit, one channel after the other within each frame.
    pub fn values<'a>(&self, frames: &'a [u8]) -> impl Iterator<Item = f32> + 'a {
        let (sample, scale) = (self.sample, self.scale.unwrap_or(self.sample.default_scale()));
        frames.chunks_exact(sample.bytes()).map(move |bytes| (sample.value(bytes) * scale) as f32)
    }

    /// So many frames in seconds, at the rate that the sender says.
    pub fn seconds(&self, frames: u64) -> f64 {
        frames as f64 / self.sample_rate_hz
    }

    /// The frames of so many seconds, at the rate that the sender says.
    pub fn frames_in(&self, seconds: f64) -> u64 {
        (seconds * self.sample_rate_hz).round() as u64
    }
}
