//! FLAC recordings, decoded while reading.
//!
//! Samples are integers, scaled to a full scale of −1…1 like those of WAV; `scale` of the defaults converts
//! them to a unit. FLAC has no time: the defaults give the start time.

use std::io::{ErrorKind, Read};

use claxon::frame::Block;
use claxon::{FlacReader, FlacReaderOptions};

use super::{Frames, FramesInfo, RecordBlocks, RecordDefaults, RecordingError};
use flankwatch_signal::Record;

/// Magic number.
pub(crate) const MAGIC: &[u8] = b"fLaC";

/// Largest number of samples of an upload, over all channels: 128 MiB of `f32`. A small file may hold many
/// samples of silence.
const MAX_UPLOAD_SAMPLES: u64 = 1 << 25;

/// Reads a FLAC recording as one record per channel.
///
/// # Errors
/// The recording is damaged or longer than a record may be, or has more than 33 554 432 samples.
pub fn decode_flac(bytes: &[u8], defaults: &RecordDefaults) -> Result<Vec<Record>, RecordingError> {
    if bytes.is_empty() {
        return Err(RecordingError::NoBytes);
    }
    let mut frames = FlacFrames::new(bytes)?;
    let max_frames = MAX_UPLOAD_SAMPLES / frames.channels.max(1) as u64;
    let length = match frames.declared {
        Some(length) => length,
        None => FlacFrames::new(bytes)?.count(max_frames)?,
    };
    if length > max_frames {
        let expected = "at most 33554432 samples over all channels in an upload";
        return Err(flac("length", format!("{length} frames of {} samples", frames.channels), expected));
    }
    frames.declared = Some(length);
    RecordBlocks::whole(frames, defaults)?.collect()
}

/// The frames (one sample of every channel) of a FLAC recording, read on demand.
pub struct FlacFrames<R: Read> {
    reader: FlacReader<R>,
    channels: usize,
    sample_rate_hz: f64,
    /// Declared number of frames; `None` if not declared, as in a recording that was written to a pipe.
    declared: Option<u64>,
    read: u64,
    /// Value of one count.
    count: f32,
    block: Block,
    /// Index of the next frame in the block.
    next: u32,
}

impl<R: Read> FlacFrames<R> {
    /// Reads the stream information at the beginning.
    ///
    /// # Errors
    /// The recording is damaged or has no sampling rate; reading fails.
    pub fn new(reader: R) -> Result<Self, RecordingError> {
        // Pictures and comments are skipped.
        let options = FlacReaderOptions { metadata_only: false, read_vorbis_comment: false };
        let reader = FlacReader::new_ext(reader, options).map_err(damaged)?;
        let info = reader.streaminfo();
        if info.sample_rate == 0 {
            return Err(flac("sampling rate", info.sample_rate, "a rate above 0 Hz"));
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

    /// Reads to the end; returns the number of frames, or one more than `most`.
    fn count(mut self, most: u64) -> Result<u64, RecordingError> {
        while self.read <= most && self.fill()? {
            self.read += u64::from(self.block.duration());
        }
        Ok(self.read.min(most + 1))
    }

    /// Decodes the next block; returns false at the end.
    fn fill(&mut self) -> Result<bool, RecordingError> {
        let buffer = std::mem::replace(&mut self.block, Block::empty()).into_buffer();
        let Some(block) = self.reader.blocks().read_next_or_eof(buffer).map_err(damaged)? else {
            return match self.declared.filter(|declared| self.read < *declared) {
                Some(declared) => {
                    let what = format!("{declared} frames, but {} are there", self.read);
                    Err(flac("length", what, "as many frames as the file holds"))
                }
                None => Ok(false),
            };
        };
        if block.channels() as usize != self.channels {
            return Err(flac("channels", block.channels(), "as many as at the beginning"));
        }
        let decoded = self.read + u64::from(block.duration());
        if let Some(declared) = self.declared.filter(|declared| decoded > *declared) {
            let what = format!("{declared} frames, but at least {decoded} are there");
            return Err(flac("length", what, "as many frames as the file holds"));
        }
        (self.block, self.next) = (block, 0);
        Ok(true)
    }
}

impl<R: Read> Frames for FlacFrames<R> {
    fn info(&self, defaults: &RecordDefaults) -> Result<FramesInfo, RecordingError> {
        // A recording of undeclared length is cut like a long one.
        let frames = self.declared.unwrap_or(u64::MAX);
        Ok(FramesInfo::without_time(defaults.names_of(self.channels), self.sample_rate_hz, frames, defaults))
    }

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

fn flac(field: &'static str, value: impl ToString, expected: &'static str) -> RecordingError {
    RecordingError::Content { format: "flac", field, value: value.to_string(), expected: expected.into() }
}

fn damaged(error: claxon::Error) -> RecordingError {
    match error {
        claxon::Error::IoError(error) if error.kind() != ErrorKind::UnexpectedEof => error.into(),
        claxon::Error::IoError(_) => flac("stream", "cut off", "a whole recording"),
        claxon::Error::FormatError(what) => RecordingError::FlacDamaged(what),
        claxon::Error::Unsupported(what) => flac("stream", what, "one that can be decoded"),
    }
}
