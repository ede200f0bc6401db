//! A recording as frames, each with one sample of every channel.

use std::collections::BTreeMap;

use jiff::Timestamp;

use super::{RecordDefaults, RecordingError};

/// A recording that is read frame by frame.
pub trait Frames {
    /// Returns channels, rate and time of the frames; the defaults fill in what the recording lacks.
    ///
    /// # Errors
    /// Neither the recording nor the defaults give a sampling rate, or the two contradict each other.
    fn info(&self, defaults: &RecordDefaults) -> Result<FramesInfo, RecordingError>;

    /// Reads the next frame; returns false at the end. `frame` has one sample per channel.
    ///
    /// # Errors
    /// The recording is damaged or truncated, or reading fails.
    fn next_frame(&mut self, frame: &mut [f32]) -> Result<bool, RecordingError>;
}

/// Channels, rate and time of a recording's frames.
#[derive(Debug, Clone, PartialEq)]
pub struct FramesInfo {
    /// Names of the channels, in the order of a frame.
    pub channels: Vec<String>,
    /// Units that the recording states, by channel name.
    pub channel_units: BTreeMap<String, String>,
    /// Sampling rate in hertz.
    pub sample_rate_hz: f64,
    /// Time of the first frame.
    pub start_time: Timestamp,
    /// Upper bound of the number of frames; `u64::MAX` if unknown.
    pub frames_at_most: u64,
}

impl FramesInfo {
    /// Returns the unit of each channel, and the factor for its values.
    ///
    /// # Errors
    /// The defaults have a sensitivity, and a channel is in another unit than V or mV.
    pub fn units_and_scales(
        &self,
        defaults: &RecordDefaults,
    ) -> Result<Vec<(String, Option<f64>)>, RecordingError> {
        let stated = |channel| self.channel_units.get(channel).map(String::as_str);
        self.channels.iter().map(|channel| defaults.unit_and_scale(channel, stated(channel))).collect()
    }

    /// Describes a recording that has neither times nor units.
    pub(crate) fn without_time(
        channels: Vec<String>,
        sample_rate_hz: f64,
        frames_at_most: u64,
        defaults: &RecordDefaults,
    ) -> Self {
        let start_time = defaults.start_time;
        Self { channels, channel_units: BTreeMap::new(), sample_rate_hz, start_time, frames_at_most }
    }
}
