//! FLAC recordings, decoded as they are read.
//!
//! Samples are integers, which are scaled to a full scale of −1…1 as those of WAV are; what that is worth
//! says `scale` of the defaults. FLAC has no time: the defaults say when it began.

use std::io::{ErrorKind, Read};

use claxon::frame::Block;
use claxon::{FlacReader, FlacReaderOptions};

use super::cut::{Blocks, Cut, CutPlan, Cutter, Frames};
use super::{RecordDefaults, RecordingError};
use flankwatch_signal::Record;

/// How every such file begins.
pub(crate) const MAGIC: &[u8] = b"fLaC";

/// The frames (one sample of every channel) of a FLAC recording, read as they are asked for.
struct FlacFrames<R: Read> {
    reader: FlacReader<R>,
    channels: usize,
    sample_rate_hz: f64,
    /// Frames that there are by its description; none where it does not say, as of a recording that was
    /// written to a pipe.
    declared: Option<u64>,
    read: u64,
    /// What one count is worth.
    count: f32,
    block: Block,
    /// The next frame's place in the block.
    next: u32,
}

impl<R: Read> FlacFrames<R> {
    /// Reads the description at the beginning.
    fn new(reader: R) -> Result<Self, RecordingError> {
        // Pictures and comments are passed over.
        let options = FlacReaderOptions { metadata_only: false, read_vorbis_comment: false };
        let reader = FlacReader::new_ext(reader, options).map_err(damaged)?;
        let info = reader.streaminfo();
        if info.sample_rate == 0 {
            return Err(flac("sampling rate", info.sample_rate, "one in hertz"));
        }
        Ok(Self {
            reader,
            channels: info.channels as usize,
            sample_rate_hz: f64::from(info.sample_rate),
            declared: info.samples,
            read: 0,
            count: 1.0 / (1_u64 << info.bits_per_sample.clamp(1, 32).saturating_sub(1)) as f32,
            block: Block::empty(),
            next: 0,
        })
    }

    /// Decodes the next block; false at the end.
    fn fill(&mut self) -> Result<bool, RecordingError> {
        let buffer = std::mem::replace(&mut self.block, Block::empty()).into_buffer();
        let Some(block) = self.reader.blocks().read_next_or_eof(buffer).map_err(damaged)? else {
            return match self.declared.filter(|declared| self.read < *declared) {
                Some(declared) => {
                    let what = format!("{declared} frames, of which {} are there", self.read);
                    Err(flac("length", what, "as many frames as the file holds"))
                }
                None => Ok(false),
            };
        };
        if block.channels() as usize != self.channels {
            return Err(flac("channels", block.channels(), "as many as at the beginning"));
        }
        (self.block, self.next) = (block, 0);
        Ok(true)
    }
}

impl<R: Read> Frames for FlacFrames<R> {
    fn next_frame(&mut self, frame: &mut [f32]) -> Result<bool, RecordingError> {
        if self.next >= self.block.duration() && !self.fill()? {
            return Ok(false);
        }
        for (channel, sample) in (0..).zip(frame) {
            *sample = self.block.sample(channel, self.next) as f32 * self.count;
        }
        self.next += 1;
        self.read += 1;
        Ok(true)
    }
}

/// Reads a FLAC recording of any length as consecutive records: all channels of one stretch, then those of
/// the next.
pub struct FlacBlocks<R: Read> {
    blocks: Blocks<FlacFrames<R>>,
}

impl<R: Read> FlacBlocks<R> {
    /// Reads the description of a recording. One that does not say its length is cut as a long one is.
    ///
    /// # Errors
    /// It is damaged, or without a sampling rate; a cut that no record can have; what the reader says.
    pub fn new(reader: R, defaults: &RecordDefaults, cut: Option<Cut>) -> Result<Self, RecordingError> {
        let frames = FlacFrames::new(reader)?;
        let (channels, rate_hz) = (frames.channels, frames.sample_rate_hz);
        let plan = CutPlan::new(cut, frames.declared.unwrap_or(u64::MAX), rate_hz, channels)?;
        let cutter = Cutter::new(defaults.names_of(channels), rate_hz, defaults, plan);
        Ok(Self { blocks: Blocks::new(frames, channels, cutter, plan) })
    }

    /// Length of the records in seconds where a long recording is cut without having been asked to.
    pub fn default_cut_seconds(&self) -> Option<f64> {
        self.blocks.default_cut_seconds()
    }
}

impl<R: Read> Iterator for FlacBlocks<R> {
    type Item = Result<Record, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.blocks.next()
    }
}

fn flac(field: &'static str, value: impl ToString, expected: &'static str) -> RecordingError {
    RecordingError::Content { format: "flac", field, value: value.to_string(), expected }
}

fn damaged(error: claxon::Error) -> RecordingError {
    match error {
        claxon::Error::IoError(error) if error.kind() != ErrorKind::UnexpectedEof => error.into(),
        claxon::Error::IoError(_) => flac("stream", "cut off", "a whole recording"),
        claxon::Error::FormatError(what) | claxon::Error::Unsupported(what) => {
            flac("stream", what, "one that is not damaged")
        }
    }
}
