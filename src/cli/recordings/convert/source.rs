//! One recording to convert: its frames, reduced to the selected channels.

use std::path::Path;

use super::ConvertArgs;
use crate::cli::CliError;
use crate::recording::{FileFrames, Format, Frames, FramesInfo, RecordDefaults, RecordingError};

/// Frames of one file.
pub(super) struct Source {
    frames: FileFrames,
    info: FramesInfo,
    /// One sample of every channel of the file.
    whole_frame: Vec<f32>,
    /// Indices of the selected channels in a frame of the file.
    selected: Vec<usize>,
}

impl Source {
    pub(super) fn open(path: &Path, args: &ConvertArgs, defaults: &RecordDefaults) -> Result<Self, CliError> {
        let input = CliError::recording(path);
        let frames = FileFrames::open(path, &args.channels).map_err(&input)?;
        let mut info = frames.info(defaults).map_err(&input)?;
        let whole_frame = vec![0.0; info.channels.len()];
        // Only the selected columns of a CSV file are read.
        let names = if frames.format() == Format::Csv { &[] } else { args.channels.as_slice() };
        let selected = select(&info.channels, names)?;
        info.channels = selected.iter().map(|&at| info.channels[at].clone()).collect();
        Ok(Self { frames, info, whole_frame, selected })
    }

    pub(super) fn channels(&self) -> &[String] {
        &self.info.channels
    }

    pub(super) fn sample_rate_hz(&self) -> f64 {
        self.info.sample_rate_hz
    }

    /// Returns the number of bytes of the file read so far.
    pub(super) fn bytes_read(&self) -> u64 {
        self.frames.bytes_read()
    }

    /// Returns the unit of each channel, and the factor for its values.
    pub(super) fn units_and_scales(
        &self,
        defaults: &RecordDefaults,
    ) -> Result<Vec<(String, Option<f64>)>, RecordingError> {
        self.info.units_and_scales(defaults)
    }

    /// Returns the first selected channel whose unit the recording does not state.
    pub(super) fn channel_without_unit(&self) -> Option<&str> {
        let mut channels = self.info.channels.iter();
        channels.find(|channel| !self.info.channel_units.contains_key(*channel)).map(String::as_str)
    }
}

impl Frames for Source {
    fn info(&self, _: &RecordDefaults) -> Result<FramesInfo, RecordingError> {
        Ok(self.info.clone())
    }

    fn next_frame(&mut self, frame: &mut [f32]) -> Result<bool, RecordingError> {
        let more = self.frames.next_frame(&mut self.whole_frame)?;
        for (sample, &at) in frame.iter_mut().zip(&self.selected) {
            *sample = self.whole_frame[at];
        }
        Ok(more)
    }
}

/// Returns the indices of the requested channels; all where none is requested.
fn select(names: &[String], requested: &[String]) -> Result<Vec<usize>, CliError> {
    if requested.is_empty() {
        return Ok((0..names.len()).collect());
    }
    let find = |name: &String| {
        let found = names.iter().position(|other| other == name);
        found.ok_or_else(|| {
            CliError::argument("--channels", name, format!("names among {}", names.join(", ")))
        })
    };
    requested.iter().map(find).collect()
}
