//! The channel of a stream that carries a tachometer's signal: how its pulses are found, and how it is
//! separated from the other channels.

use serde::{Deserialize, Serialize};

use super::super::RecordingError;

/// Highest level, in the stream's unit.
const MAX_LEVEL: f64 = 1e30;

/// How pulses are found in a channel of a stream: by its rising crossings of a level.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TachometerChannel {
    /// Position of the channel in a frame, from 0.
    pub(super) channel: usize,
    level: f64,
    hysteresis: f64,
    pulses_per_revolution: u32,
}

impl TachometerChannel {
    /// Creates a tachometer at the channel with this position. A pulse begins where the signal reaches
    /// `level`, having been lower by `hysteresis` since the last one; by default half the level.
    ///
    /// # Errors
    /// A level or hysteresis out of range, or 0 pulses per revolution.
    pub fn new(
        channel: usize,
        level: f64,
        hysteresis: Option<f64>,
        pulses_per_revolution: u32,
    ) -> Result<Self, RecordingError> {
        if !(-MAX_LEVEL..=MAX_LEVEL).contains(&level) {
            return Err(RecordingError::field("tachometer_level", level, "a number within ± 1e30"));
        }
        let hysteresis = hysteresis.unwrap_or(level.abs() / 2.0);
        if !(0.0..=MAX_LEVEL).contains(&hysteresis) {
            return Err(RecordingError::field(
                "tachometer_hysteresis",
                hysteresis,
                "a number from 0 to 1e30",
            ));
        }
        if pulses_per_revolution == 0 {
            return Err(RecordingError::field("pulses_per_revolution", 0, "at least 1"));
        }
        Ok(Self { channel, level, hysteresis, pulses_per_revolution })
    }

    /// Returns the level.
    pub fn level(&self) -> f64 {
        self.level
    }

    /// Returns by how much the signal falls below the level between two pulses.
    pub fn hysteresis(&self) -> f64 {
        self.hysteresis
    }

    /// Returns the number of pulses per revolution.
    pub fn pulses_per_revolution(&self) -> u32 {
        self.pulses_per_revolution
    }

    /// Returns the positions of the pulses in a signal, in samples after the first one: on the straight line
    /// between the two samples around the level.
    pub(super) fn crossings(&self, signal: impl Iterator<Item = f64>) -> impl Iterator<Item = f64> {
        let low = self.level - self.hysteresis;
        // Whether the signal has been low since the last pulse, and consisted of numbers since then.
        let (mut is_armed, mut before) = (false, f64::NAN);
        signal.enumerate().filter_map(move |(index, value)| {
            let previous = std::mem::replace(&mut before, value);
            if value < self.level {
                is_armed |= value <= low;
                return None;
            }
            let is_pulse = std::mem::take(&mut is_armed) && previous.is_finite() && value >= self.level;
            is_pulse.then(|| index as f64 - 1.0 + (self.level - previous) / (value - previous))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::StreamFormat;
    use super::*;
    use crate::RawSample;

    fn crossings(level: f64, hysteresis: Option<f64>, signal: &[f64]) -> Vec<f64> {
        let tachometer = TachometerChannel::new(0, level, hysteresis, 1).unwrap();
        tachometer.crossings(signal.iter().copied()).collect()
    }

    #[test]
    fn a_pulse_begins_where_the_signal_reaches_the_level() {
        // Not known to have been low; a pulse with noise at its edges; one that starts at a sample.
        let signal = [5.0, 0.0, 1.0, 4.0, 2.0, 3.0, 5.0, 0.0, 2.5, 2.4, 2.6];
        assert_eq!(crossings(2.5, None, &signal), [2.5, 8.0]);
        assert_eq!(crossings(2.5, Some(0.0), &signal), [2.5, 4.5, 8.0, 9.5]);
        // A signal around zero.
        assert_eq!(crossings(0.0, Some(0.5), &[-1.0, 1.0, -0.4, 1.0, -0.5, 0.5]), [0.5, 4.5]);
        // Samples that are not numbers give no pulse, and neither does an edge beside one.
        assert_eq!(crossings(1.0, None, &[0.0, f64::NAN, 2.0, 0.0, 2.0]), [3.5]);
        assert_eq!(crossings(1.0, None, &[0.0, 2.0, f64::NEG_INFINITY, 2.0, 0.0, 2.0]), [0.5, 4.5]);
    }

    #[test]
    fn the_tachometers_channel_is_separated_from_the_others() {
        let format = StreamFormat::new(RawSample::I16, 10.0, 3, Some(0.5)).unwrap();
        let format = format.with_tachometer("2", 10.0, None, 2).unwrap();
        let frames: Vec<u8> = [[1_i16, 0, 2], [3, 40, 4], [5, 0, 6]]
            .as_flattened()
            .iter()
            .flat_map(|x| x.to_le_bytes())
            .collect();
        let pulses = format.pulses(&frames, 1).unwrap();
        assert_eq!((pulses.pulse_times_s.as_slice(), pulses.pulses_per_revolution), (&[-0.05][..], 2));
        let (others, bytes) = format.without_tachometer(frames.into());
        assert_eq!((others.channels(), others.names()), (2, vec!["1".to_owned(), "3".to_owned()]));
        assert_eq!(others.tachometer(), None);
        assert_eq!(others.values(&bytes).collect::<Vec<_>>(), [0.5, 1.0, 1.5, 2.0, 2.5, 3.0]);
        assert_eq!(others.pulses(&bytes, 0), None);
    }

    #[test]
    fn errors_about_a_tachometer_name_their_parameter() {
        let format = |channels| StreamFormat::new(RawSample::F32, 10.0, channels, None).unwrap();
        let named = format(2).with_names(None, vec!["in".to_owned(), "tacho".to_owned()]).unwrap();
        assert!(named.clone().with_tachometer("tacho", 1.0, None, 1).is_ok());
        for (format, channel, level, hysteresis, of_revolution, words) in [
            (named, "2", 1.0, None, 1, "tachometer_channel is 2"),
            (format(1), "1", 1.0, None, 1, "tachometer_channel is 1"),
            (format(2), "1", f64::NAN, None, 1, "tachometer_level is NaN"),
            (format(2), "1", 1.0, Some(-1.0), 1, "tachometer_hysteresis is -1"),
            (format(2), "1", 1.0, None, 0, "pulses_per_revolution is 0"),
        ] {
            let error = format.with_tachometer(channel, level, hysteresis, of_revolution).unwrap_err();
            assert!(error.to_string().contains(words), "{error}");
        }
    }
}
