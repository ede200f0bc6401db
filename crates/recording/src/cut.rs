//! Cutting of a long multi-channel recording into records, in bounded memory.

use std::collections::VecDeque;

use jiff::{SignedDuration, Timestamp};

use super::block::check_sample_count;
use super::{Frames, FramesInfo, RecordDefaults, RecordingError};
use flankwatch_signal::{MAX_RECORD_SAMPLES, OperatingPoint, Record, RecordError};

/// Longest recording that becomes one record per channel by default, in seconds and in samples per channel.
/// Its analysis takes about 85 bytes per sample.
const WHOLE_SECONDS: f64 = 120.0;
const WHOLE_SAMPLES: u64 = 1 << 22;

/// Default length of the records of a longer recording, in seconds.
const DEFAULT_SECONDS: f64 = 10.0;

/// Largest number of samples in memory over all channels: 256 MiB of `f32`.
const MAX_BUFFERED_SAMPLES: usize = 4 * MAX_RECORD_SAMPLES;

/// Length of the records of a cut recording. The remainder at the end is a record too if it is at least half
/// as long.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cut {
    /// Seconds, rounded to whole samples.
    Seconds(f64),
    /// Samples per channel.
    Samples(usize),
}

/// Plan for cutting a recording into records.
#[derive(Debug, Clone, Copy, PartialEq)]
struct CutPlan {
    /// Samples per channel in a record.
    frames: usize,
    /// Length of the records in seconds if the recording is cut by default.
    default_seconds: Option<f64>,
}

impl CutPlan {
    /// Creates the plan for at most `total_frames` samples per channel.
    ///
    /// # Errors
    /// The sampling rate is not positive, or the records have no samples or too many.
    fn new(
        cut: Option<Cut>,
        total_frames: u64,
        sample_rate_hz: f64,
        channels: usize,
    ) -> Result<Self, RecordingError> {
        if !(sample_rate_hz > 0.0 && sample_rate_hz.is_finite()) {
            return Err(RecordError::SampleRate(sample_rate_hz).into());
        }
        let max_frames = MAX_RECORD_SAMPLES.min(MAX_BUFFERED_SAMPLES / channels.max(1));
        let frames = match cut {
            Some(Cut::Samples(frames)) => frames as f64,
            Some(Cut::Seconds(seconds)) => (seconds * sample_rate_hz).round(),
            None if total_frames <= WHOLE_SAMPLES.min(max_frames as u64)
                && total_frames as f64 <= WHOLE_SECONDS * sample_rate_hz =>
            {
                return Ok(Self { frames: max_frames, default_seconds: None });
            }
            None => {
                let frames =
                    (DEFAULT_SECONDS * sample_rate_hz).round().clamp(1.0, max_frames as f64) as usize;
                return Ok(Self { frames, default_seconds: Some(frames as f64 / sample_rate_hz) });
            }
        };
        if !(frames >= 1.0 && frames <= max_frames as f64) {
            return Err(RecordingError::field(
                "the cut",
                format!("{frames} samples ({channels} channels at {sample_rate_hz} Hz)"),
                "1 to 16777216 samples a record, and at most 67108864 over all channels",
            ));
        }
        Ok(Self { frames: frames as usize, default_seconds: None })
    }
}

/// Collects frames into records.
#[derive(Debug)]
struct Cutter {
    channels: Vec<String>,
    /// Units of the channels, and the factors for their values.
    units: Vec<(String, Option<f64>)>,
    sample_rate_hz: f64,
    start_time: Timestamp,
    operating_point: OperatingPoint,
    frames: usize,
    first_frame: u64,
    /// Number of frames added so far.
    added: u64,
    columns: Vec<Vec<f32>>,
}

impl Cutter {
    /// Creates an empty cutter for records of `plan.frames` frames.
    fn new(info: &FramesInfo, defaults: &RecordDefaults, plan: CutPlan) -> Result<Self, RecordingError> {
        Ok(Self {
            columns: vec![Vec::new(); info.channels.len()],
            units: info.units_and_scales(defaults)?,
            channels: info.channels.clone(),
            sample_rate_hz: info.sample_rate_hz,
            start_time: info.start_time,
            operating_point: defaults.operating_point,
            frames: plan.frames,
            first_frame: 0,
            added: 0,
        })
    }

    /// Adds one frame; returns true when the records are complete and must be taken.
    fn push(&mut self, frame: &[f32]) -> bool {
        self.added += 1;
        for ((column, &sample), (_, scale)) in self.columns.iter_mut().zip(frame).zip(&self.units) {
            column.push(match scale {
                None => sample,
                Some(scale) => (f64::from(sample) * scale) as f32,
            });
        }
        self.columns.first().is_some_and(|column| column.len() >= self.frames)
    }

    /// Returns the time of a frame.
    fn time_of(&self, frame: u64) -> Result<Timestamp, RecordingError> {
        time_after(self.start_time, frame as f64 / self.sample_rate_hz)
    }

    /// Takes the collected frames as one record per channel. Returns nothing if there are none, except for an
    /// empty recording. A remainder of less than half a record is dropped if the recording was cut: its
    /// features would have another resolution than the others'.
    fn take(&mut self) -> Vec<Result<Record, RecordingError>> {
        let frames = self.columns.first().map_or(0, Vec::len);
        if self.first_frame > 0 && 2 * frames < self.frames {
            self.columns.iter_mut().for_each(Vec::clear);
            return Vec::new();
        }
        let columns: Vec<Vec<f32>> = self.columns.iter_mut().map(std::mem::take).collect();
        let first_sample = self.first_frame;
        self.first_frame += frames as u64;
        let start_time = match self.time_of(first_sample) {
            Ok(time) => time,
            Err(error) => return vec![Err(error)],
        };
        let named = self.channels.iter().zip(&self.units);
        let records = named.zip(columns).map(|((channel, (unit, scale)), samples)| {
            Record::new(channel, start_time, self.sample_rate_hz, unit, samples)
                .and_then(|record| record.with_operating_point(self.operating_point))
                .map(|record| record.with_source_scale(*scale))
                .map_err(|source| match (first_sample, source) {
                    (0, source) => RecordingError::Record(source),
                    (first_sample, source @ RecordError::NotFinite { .. }) => {
                        RecordingError::Cut { first_sample, source }
                    }
                    (_, source) => RecordingError::Record(source),
                })
        });
        records.collect()
    }
}

/// The records of a recording that is read frame by frame: all channels of one block, then those of the next.
///
/// Only one block is in memory at a time. A block with an invalid sample is an error, and reading continues
/// after it; a truncated or damaged recording is an error and the last item.
#[derive(Debug)]
pub struct RecordBlocks<F> {
    frames: F,
    cutter: Cutter,
    plan: CutPlan,
    frame: Vec<f32>,
    ready: VecDeque<Result<Record, RecordingError>>,
    ended: bool,
}

impl<F: Frames> RecordBlocks<F> {
    /// Cuts a recording into records.
    ///
    /// Without a cut, up to 2 minutes (and 4 194 304 samples) are one record per channel; longer recordings
    /// are cut into records of 10 s.
    ///
    /// # Errors
    /// Those of [`Frames::info`] and [`FramesInfo::units_and_scales`]; an invalid cut.
    pub fn new(frames: F, defaults: &RecordDefaults, cut: Option<Cut>) -> Result<Self, RecordingError> {
        let info = frames.info(defaults)?;
        let plan = CutPlan::new(cut, info.frames_at_most, info.sample_rate_hz, info.channels.len())?;
        Self::with_plan(frames, &info, defaults, plan)
    }

    /// Returns the recording that is cut.
    pub fn frames(&self) -> &F {
        &self.frames
    }

    /// Reads a recording as one record per channel.
    ///
    /// # Errors
    /// Those of [`Frames::info`] and [`FramesInfo::units_and_scales`]; a recording longer than a record may
    /// be.
    pub fn whole(frames: F, defaults: &RecordDefaults) -> Result<Self, RecordingError> {
        let info = frames.info(defaults)?;
        let count = usize::try_from(info.frames_at_most).unwrap_or(usize::MAX);
        check_sample_count(info.channels.first().map_or("1", String::as_str), count)?;
        let plan = CutPlan { frames: count.max(1), default_seconds: None };
        Self::with_plan(frames, &info, defaults, plan)
    }

    fn with_plan(
        frames: F,
        info: &FramesInfo,
        defaults: &RecordDefaults,
        plan: CutPlan,
    ) -> Result<Self, RecordingError> {
        let cutter = Cutter::new(info, defaults, plan)?;
        let frame = vec![0.0; info.channels.len()];
        Ok(Self { frames, cutter, plan, frame, ready: VecDeque::new(), ended: false })
    }

    /// Returns the time after the last frame read so far, which may belong to a dropped remainder; at most
    /// the last one that can be represented.
    pub fn end_time(&self) -> Timestamp {
        self.cutter.time_of(self.cutter.added).unwrap_or(Timestamp::MAX)
    }

    /// Returns the length of the records in seconds if a long recording is cut by default.
    pub fn default_cut_seconds(&self) -> Option<f64> {
        self.plan.default_seconds
    }
}

impl<F: Frames> Iterator for RecordBlocks<F> {
    type Item = Result<Record, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.ready.is_empty() && !self.ended {
            match self.frames.next_frame(&mut self.frame) {
                Ok(true) => {
                    if self.cutter.push(&self.frame) {
                        self.ready.extend(self.cutter.take());
                    }
                }
                Ok(false) => {
                    self.ended = true;
                    self.ready.extend(self.cutter.take());
                }
                Err(error) => {
                    self.ended = true;
                    self.ready.push_back(Err(error));
                }
            }
        }
        self.ready.pop_front()
    }
}

/// Returns the time `seconds` later.
fn time_after(time: Timestamp, seconds: f64) -> Result<Timestamp, RecordingError> {
    SignedDuration::try_from_secs_f64(seconds)
        .ok()
        .and_then(|duration| time.checked_add(duration).ok())
        .ok_or_else(|| {
            RecordingError::field("start_time", time, "a time whose recording ends before the year 10000")
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cutter(channels: &[&str], plan: CutPlan) -> Cutter {
        let channels = channels.iter().map(|&channel| channel.to_owned()).collect();
        let defaults = RecordDefaults::default();
        Cutter::new(&FramesInfo::without_time(channels, 8.0, 1, &defaults), &defaults, plan).unwrap()
    }

    #[test]
    fn records_follow_each_other_without_gap_or_overlap() {
        let plan = CutPlan::new(Some(Cut::Samples(4)), 10, 8.0, 2).unwrap();
        let mut cutter = cutter(&["a", "b"], plan);
        let mut records = Vec::new();
        for k in 0..10 {
            if cutter.push(&[k as f32, -(k as f32)]) {
                records.extend(cutter.take());
            }
        }
        records.extend(cutter.take());
        let records: Vec<Record> = records.into_iter().map(Result::unwrap).collect();
        let lengths: Vec<usize> = records.iter().map(|r| r.samples().len()).collect();
        assert_eq!(lengths, [4, 4, 4, 4, 2, 2]);
        let milliseconds: Vec<i64> = records.iter().map(|r| r.start_time().as_millisecond()).collect();
        assert_eq!(milliseconds, [0, 0, 500, 500, 1000, 1000]);
        assert_eq!(records[4].samples(), [8.0, 9.0]);
        assert_eq!(records[5].channel(), "b");
    }

    #[test]
    fn a_remainder_below_half_a_record_is_dropped() {
        let lengths = |frames: usize, cut: Option<Cut>| -> Vec<usize> {
            let plan = CutPlan::new(cut, frames as u64, 8.0, 1).unwrap();
            let mut cutter = cutter(&["a"], plan);
            let mut records = Vec::new();
            for k in 0..frames {
                if cutter.push(&[k as f32]) {
                    records.extend(cutter.take());
                }
            }
            records.extend(cutter.take());
            records.into_iter().map(|record| record.unwrap().samples().len()).collect()
        };
        let five = Some(Cut::Samples(5));
        assert_eq!(lengths(12, five), [5, 5]);
        assert_eq!(lengths(13, five), [5, 5, 3]);
        assert_eq!(lengths(10, five), [5, 5]);
        // What is not cut is whole, however short.
        assert_eq!(lengths(2, five), [2]);
        assert_eq!(lengths(2, None), [2]);
    }

    #[test]
    fn a_recording_ends_after_its_dropped_remainder() {
        let mut wav = std::io::Cursor::new(Vec::new());
        let mut writer = crate::WavWriter::new(&mut wav, 1, 8.0).unwrap();
        (0..12).for_each(|k| writer.write_frame(&[k as f32]).unwrap());
        writer.finish().unwrap();
        let frames = crate::WavFrames::new(&wav.get_ref()[..], wav.get_ref().len() as u64).unwrap();
        let mut blocks =
            RecordBlocks::new(frames, &RecordDefaults::default(), Some(Cut::Samples(5))).unwrap();
        let ends: Vec<Timestamp> = blocks.by_ref().map(|record| record.unwrap().end_time()).collect();
        assert_eq!(ends.last().unwrap().as_millisecond(), 1250);
        assert_eq!(blocks.end_time().as_millisecond(), 1500);
    }

    #[test]
    fn long_recordings_are_cut_by_default_and_short_ones_are_not() {
        let whole = CutPlan::new(None, 120 * 20_000, 20_000.0, 1).unwrap();
        assert_eq!(whole.default_seconds, None);
        assert!(whole.frames >= 120 * 20_000);
        let cut = CutPlan::new(None, 120 * 20_000 + 1, 20_000.0, 1).unwrap();
        assert_eq!((cut.frames, cut.default_seconds), (200_000, Some(10.0)));
        // At a high rate it is the samples that are too many, and those of all channels.
        assert_eq!(CutPlan::new(None, (1 << 22) + 1, 100_000.0, 1).unwrap().frames, 1_000_000);
        assert_eq!(CutPlan::new(None, 1 << 22, 100_000.0, 17).unwrap().frames, 1_000_000);
    }

    #[test]
    fn cuts_too_large_for_memory_are_rejected() {
        for cut in [
            Cut::Samples(0),
            Cut::Samples(MAX_RECORD_SAMPLES + 1),
            Cut::Seconds(0.0),
            Cut::Seconds(-1.0),
            Cut::Seconds(f64::NAN),
            Cut::Seconds(1e9),
        ] {
            assert!(CutPlan::new(Some(cut), 10, 1000.0, 1).is_err(), "{cut:?}");
        }
        assert!(CutPlan::new(Some(Cut::Samples(MAX_RECORD_SAMPLES)), 10, 1000.0, 5).is_err());
    }

    #[test]
    fn records_after_the_last_time_are_errors_of_the_same_length() {
        let plan = CutPlan::new(Some(Cut::Samples(2)), 6, 8.0, 1).unwrap();
        let mut cutter = cutter(&["a"], plan);
        cutter.start_time = Timestamp::MAX;
        let pushed: Vec<bool> = (0..6)
            .map(|_| {
                let is_complete = cutter.push(&[0.0]);
                if is_complete {
                    cutter.take();
                }
                is_complete
            })
            .collect();
        assert_eq!(pushed, [false, true, false, true, false, true]);
    }

    #[test]
    fn an_error_in_a_later_record_gives_its_position() {
        let plan = CutPlan::new(Some(Cut::Samples(2)), 4, 8.0, 1).unwrap();
        let mut cutter = cutter(&["a"], plan);
        cutter.push(&[0.0]);
        cutter.push(&[0.0]);
        assert!(cutter.take()[0].is_ok());
        cutter.push(&[f32::NAN]);
        let error = cutter.take().remove(0).unwrap_err().to_string();
        assert!(error.starts_with("record from sample 2 of the recording"), "{error}");
    }
}
