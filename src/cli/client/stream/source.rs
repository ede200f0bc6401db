//! A source of samples: a pipe or a growing file, with raw samples or WAV.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};

use crate::cli::CliError;
use crate::cli::output::print_stderr;
use crate::recording::stream::StreamFormat;
use crate::recording::{RawSample, WavFormat, WavSamples};

/// Seconds of samples in one block.
pub(super) const BLOCK_S: f64 = 0.25;

/// Interval at which a growing file is polled.
const GROWTH_INTERVAL: Duration = Duration::from_millis(100);

/// Samples, read block by block.
pub(super) trait SampleSource: Send {
    fn format(&self) -> &StreamFormat;

    /// Returns the next block of frames, `None` at the end.
    fn next(&mut self) -> Result<Option<SourceBlock>, CliError>;
}

/// Consecutive samples of a source.
#[derive(Debug)]
pub(super) struct SourceBlock {
    /// Frames lost before it.
    pub(super) lost: u64,
    /// The time of its first frame, by the clock.
    pub(super) time: Timestamp,
    pub(super) bytes: Vec<u8>,
}

/// The bytes of a pipe or a file.
pub(super) struct Source {
    reader: Box<dyn Read + Send>,
    name: String,
    format: StreamFormat,
    /// Format of a WAV whose samples are converted before they are sent.
    converted: Option<WavSamples>,
    /// Position of the first sample.
    begin: u64,
    /// Bytes not read yet, where their number is known.
    remaining: Option<u64>,
    /// Samples that are not finite numbers.
    not_finite: u64,
    /// Bytes after the last whole frame, at the end.
    rest: usize,
    /// Whether to wait at the end of the file for it to grow.
    is_followed: bool,
    stop: Arc<AtomicBool>,
}

impl Source {
    /// Opens a file, or standard input for `-`. Without a `format`, it must be a WAV.
    pub(super) fn open(
        path: &str,
        format: Option<StreamFormat>,
        is_followed: bool,
        stop: Arc<AtomicBool>,
    ) -> Result<Self, CliError> {
        let mut reader: Box<dyn Read + Send> = match path {
            "-" => Box::new(io::stdin()),
            path => Box::new(File::open(path).map_err(CliError::file(path))?),
        };
        let (mut converted, mut begin, mut remaining) = (None, 0, None);
        let format = match format {
            Some(format) => format,
            None => {
                let failed = CliError::file(path);
                let (wav, declared, data_start) = WavFormat::read_open_ended(&mut reader).map_err(&failed)?;
                begin = data_start;
                remaining = declared.filter(|_| !is_followed);
                let (sample, is_same) = match (wav.float, wav.bits, wav.container) {
                    (false, 16, 2) => (RawSample::I16, !wav.big_endian),
                    (true, 32, 4) => (RawSample::F32, !wav.big_endian),
                    _ => (RawSample::F32, false),
                };
                let sample = if is_same { sample } else { RawSample::F32 };
                converted = (!is_same).then(|| WavSamples::new(wav));
                let channels = u32::try_from(wav.channels).unwrap_or(u32::MAX);
                StreamFormat::new(sample, wav.sample_rate_hz.into(), channels, None).map_err(failed)?
            }
        };
        let name = if path == "-" { "standard input" } else { path }.to_owned();
        Ok(Self {
            reader,
            name,
            format,
            converted,
            begin,
            remaining,
            not_finite: 0,
            rest: 0,
            is_followed,
            stop,
        })
    }

    /// Skips frames of a file; returns how many it has, which may be fewer.
    pub(super) fn skip(&mut self, path: &str, frames: u64) -> Result<u64, CliError> {
        let width = self.read_frame_bytes() as u64;
        let mut file = File::open(path).map_err(CliError::file(path))?;
        let length = file.metadata().map_err(CliError::file(path))?.len();
        let available = length.saturating_sub(self.begin) / width;
        if frames > 0 {
            let bytes = frames.saturating_mul(width);
            file.seek(SeekFrom::Start(self.begin.saturating_add(bytes))).map_err(CliError::file(path))?;
            self.reader = Box::new(file);
            self.remaining = self.remaining.map(|remaining| remaining.saturating_sub(bytes));
        }
        Ok(available)
    }

    /// Reports samples that are not numbers when the first ones occur: those after them may be good.
    fn count_not_finite(&mut self, samples: u64) {
        if samples > 0 && self.not_finite == 0 {
            print_stderr(&format!(
                "{}: samples are not finite numbers: no record is made of them",
                self.name
            ));
        }
        self.not_finite += samples;
    }

    /// Checks, when all is read, that it was complete and consisted of numbers. A WAV may end with a padding
    /// byte.
    fn check_end(&self) -> Result<(), CliError> {
        let failed = CliError::file(&self.name);
        if self.stop.load(Ordering::Relaxed) {
            return Ok(());
        }
        match self.remaining {
            Some(bytes) if bytes >= self.read_frame_bytes() as u64 => {
                Err(failed(format!("it ends {bytes} bytes before the length in its header")))
            }
            None if self.begin == 0 && self.rest > 0 => Err(failed(format!(
                "it ends within a frame: {} bytes follow the last one, expected frames of {} bytes ({} of {} \
                 channels)",
                self.rest,
                self.format.frame_bytes(),
                self.format.sample().name(),
                self.format.channels()
            ))),
            _ if self.not_finite > 0 => {
                Err(failed(format!("{} samples are not finite numbers", self.not_finite)))
            }
            _ => Ok(()),
        }
    }

    /// Size of a frame in the source.
    fn read_frame_bytes(&self) -> usize {
        self.converted.as_ref().map_or(self.format.frame_bytes(), |wav| wav.format().frame_bytes())
    }
}

impl SampleSource for Source {
    fn format(&self) -> &StreamFormat {
        &self.format
    }

    /// An incomplete frame at the end is dropped, and is an error then.
    fn next(&mut self) -> Result<Option<SourceBlock>, CliError> {
        let width = self.read_frame_bytes();
        let wanted = (self.format.frames_in(BLOCK_S).max(1) as usize).saturating_mul(width);
        let wanted = self.remaining.map_or(wanted, |remaining| wanted.min(remaining as usize));
        let mut bytes = vec![0; wanted];
        let mut filled = 0;
        while filled < wanted && !self.stop.load(Ordering::Relaxed) {
            match self.reader.read(&mut bytes[filled..]) {
                Ok(0) if self.is_followed => std::thread::sleep(GROWTH_INTERVAL),
                Ok(0) => break,
                Ok(count) => filled += count,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(source) => return Err(CliError::file(&self.name)(source)),
            }
        }
        self.rest += filled % width;
        bytes.truncate(filled / width * width);
        self.remaining = self.remaining.map(|remaining| remaining - bytes.len() as u64);
        if bytes.is_empty() {
            return self.check_end().map(|()| None);
        }
        // The last sample was measured just now.
        let length_s = self.format.seconds((bytes.len() / width) as u64);
        let time = Timestamp::now() - SignedDuration::from_secs_f64(length_s);
        let bytes = match &mut self.converted {
            Some(wav) => {
                let values = wav.values(&bytes).map_err(CliError::file(&self.name))?;
                values.flat_map(f32::to_le_bytes).collect()
            }
            None => bytes,
        };
        if self.format.sample() == RawSample::F32 {
            let samples = bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
            self.count_not_finite(samples.filter(|sample| !sample.is_finite()).count() as u64);
        }
        Ok(Some(SourceBlock { lost: 0, time, bytes }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 24 bits in the lower bytes of 4, as `arecord -f S24_LE` writes them.
    #[test]
    fn a_file_continues_behind_the_skipped_frames() {
        let mut wav =
            b"RIFF\0\0\0\0WAVEfmt \x10\0\0\0\x01\0\x01\0\x40\x1f\0\0\0\x7d\0\0\x04\0\x18\0".to_vec();
        wav.extend_from_slice(b"data\0\0\0\0");
        // The lowest bits show where the 24 bits are.
        for sample in [1_i32, 0x20_0001, -0x40_0000, 0x40_0000] {
            wav.extend_from_slice(&sample.to_le_bytes());
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.wav");
        std::fs::write(&path, wav).unwrap();
        let path = path.to_str().unwrap();
        let mut source = Source::open(path, None, false, Arc::default()).unwrap();
        assert_eq!(source.skip(path, 1).unwrap(), 4);
        let block = source.next().unwrap().unwrap();
        let values: Vec<_> = source.format().values(&block.bytes).collect();
        assert_eq!(values, [0.25 + f32::EPSILON, -0.5, 0.5]);
        assert!(source.next().unwrap().is_none());
    }

    #[test]
    fn a_truncated_file_and_samples_that_are_no_numbers_are_errors_at_the_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.wav");
        let path = path.to_str().unwrap();
        let mut wav =
            b"RIFF\0\0\0\0WAVEfmt \x10\0\0\0\x03\0\x01\0\x40\x1f\0\0\0\x7d\0\0\x04\0\x20\0".to_vec();
        wav.extend_from_slice(b"data\x0c\0\0\0");
        for (samples, expected) in [
            (&[1.0, 2.0, 3.0][..], None),
            (&[1.0, 2.0], Some("ends 4 bytes before the length in its header")),
            (&[1.0, f32::NAN, f32::INFINITY], Some("2 samples are not finite numbers")),
        ] {
            let samples: Vec<u8> = samples.iter().flat_map(|sample: &f32| sample.to_le_bytes()).collect();
            std::fs::write(path, [&wav[..], &samples].concat()).unwrap();
            let mut source = Source::open(path, None, false, Arc::default()).unwrap();
            assert_eq!(source.next().unwrap().unwrap().bytes.len(), samples.len());
            let end = source.next().map_err(|error| error.to_string());
            match expected {
                None => assert!(end.unwrap().is_none()),
                Some(words) => assert!(end.as_ref().is_err_and(|error| error.contains(words)), "{end:?}"),
            }
        }
    }

    #[test]
    fn raw_samples_that_end_within_a_frame_are_an_error_at_the_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.f32");
        let path = path.to_str().unwrap();
        std::fs::write(path, [0; 28]).unwrap();
        let format = StreamFormat::new(RawSample::F32, 1000.0, 3, None).unwrap();
        let mut source = Source::open(path, Some(format), false, Arc::default()).unwrap();
        assert_eq!(source.next().unwrap().unwrap().bytes.len(), 24);
        let error = source.next().unwrap_err().to_string();
        let words =
            "within a frame: 4 bytes follow the last one, expected frames of 12 bytes (f32 of 3 channels)";
        assert!(error.contains("a.f32") && error.contains(words), "{error}");
    }
}
