//! WAV recordings: read into records, written as 32-bit floating point.
//!
//! Floating-point samples are used unchanged, in the unit of the defaults. Integers of any number of bits are
//! scaled to a full scale of −1…1; `scale` of the defaults converts them to a unit. Without a unit it is
//! `"1"`. WAV has no time: the defaults give the start time.

use std::io::{Read, Seek, Write};

use super::{Frames, FramesInfo, RecordBlocks, RecordDefaults, RecordingError, WavFormat, WavFrames};
use flankwatch_signal::Record;

/// Largest number of sample bytes in a written WAV: the lengths in its header have 32 bits.
const MAX_DATA_BYTES: u64 = u32::MAX as u64 - 128;

/// Reads a WAV recording as one record per channel.
///
/// Channels are named `"1"`, `"2"`, …; a single one takes the name of the defaults.
///
/// # Errors
/// A recording longer than a record may be, a truncated one, or a sample that is not finite.
pub fn decode_wav(bytes: &[u8], defaults: &RecordDefaults) -> Result<Vec<Record>, RecordingError> {
    if bytes.is_empty() {
        return Err(RecordingError::NoBytes);
    }
    let frames = WavFrames::new(bytes, bytes.len() as u64)?;
    frames.check_length()?;
    RecordBlocks::whole(frames, defaults)?.collect()
}

impl<R: Read> Frames for WavFrames<R> {
    fn info(&self, defaults: &RecordDefaults) -> Result<FramesInfo, RecordingError> {
        let WavFormat { channels, sample_rate_hz, .. } = self.format();
        let names = defaults.names_of(channels);
        let rate_hz = match sample_rate_hz {
            0 => defaults
                .sample_rate_hz
                .ok_or_else(|| RecordingError::wav("sample rate", 0, "a rate above 0 Hz"))?,
            rate => rate.into(),
        };
        Ok(FramesInfo::without_time(names, rate_hz, self.frames_at_most(), defaults))
    }

    fn next_frame(&mut self, frame: &mut [f32]) -> Result<bool, RecordingError> {
        Self::next_frame(self, frame)
    }
}

/// Writes 32-bit floating-point WAV.
pub struct WavWriter<W: Write + Seek> {
    inner: hound::WavWriter<W>,
    channels: usize,
    bytes: u64,
}

impl<W: Write + Seek> WavWriter<W> {
    /// Starts a recording. Its rate must be a whole number of hertz, as the header stores no fraction.
    pub fn new(writer: W, channels: usize, sample_rate_hz: f64) -> Result<Self, RecordingError> {
        if !(1.0..=1e7).contains(&sample_rate_hz) || sample_rate_hz.fract() != 0.0 {
            return Err(RecordingError::wav(
                "sample rate",
                sample_rate_hz,
                "a whole number of hertz up to 10 MHz (MCAP stores any rate)",
            ));
        }
        if !(1..=256).contains(&channels) {
            return Err(RecordingError::wav("channel count", channels, "1 to 256"));
        }
        let spec = hound::WavSpec {
            channels: channels as u16,
            sample_rate: sample_rate_hz as u32,
            bits_per_sample: 32,
            sample_format: hound::SampleFormat::Float,
        };
        Ok(Self { inner: hound::WavWriter::new(writer, spec).map_err(write_error)?, channels, bytes: 0 })
    }

    /// Adds one sample of every channel.
    pub fn write_frame(&mut self, frame: &[f32]) -> Result<(), RecordingError> {
        if frame.len() != self.channels {
            return Err(RecordingError::wav("frame length", frame.len(), "one sample a channel"));
        }
        self.bytes += 4 * frame.len() as u64;
        if self.bytes > MAX_DATA_BYTES {
            return Err(RecordingError::wav(
                "data chunk length",
                self.bytes,
                "less than 4 GiB (MCAP has no such limit)",
            ));
        }
        for &sample in frame {
            self.inner.write_sample(sample).map_err(write_error)?;
        }
        Ok(())
    }

    /// Completes the header. Without this call the recording is incomplete.
    pub fn finish(self) -> Result<(), RecordingError> {
        self.inner.finalize().map_err(write_error)
    }
}

fn write_error(error: hound::Error) -> RecordingError {
    match error {
        hound::Error::IoError(error) => error.into(),
        other => RecordingError::Io(std::io::Error::other(other)),
    }
}
