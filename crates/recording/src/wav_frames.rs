//! The frames of a WAV recording.

use std::io::{self, Read};

use super::RecordingError;
use super::wav_format::{WavFormat, WavHeader};

/// Number of bytes read at a time (rounded to whole frames).
const READ_BYTES: usize = 1 << 16;

/// Position of the valid bits in a wider container.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Justification {
    /// In the upper bits, as specified.
    Left,
    /// In the lower bits, as some writers do.
    Right,
}

/// Reads frames (one sample of every channel) in bounded memory.
///
/// Integers are scaled to a full scale of −1…1, that is by two to the power of the number of bits less one;
/// floating-point samples are unchanged.
#[derive(Debug)]
pub struct WavFrames<R> {
    reader: R,
    /// Length of the file in bytes.
    file_bytes: u64,
    declared: Option<u64>,
    data_start: u64,
    read: u64,
    early_end: Option<u64>,
    buffer: Vec<u8>,
    next: usize,
    samples: WavSamples,
}

/// Reads the values of samples in consecutive parts of the data, as [`WavFrames`] does.
#[derive(Debug)]
pub struct WavSamples {
    format: WavFormat,
    /// Position of the valid bits, as far as the parts so far show it.
    justification: Option<Justification>,
}

impl<R: Read> WavFrames<R> {
    /// Reads the header of a file of `file_bytes` bytes.
    ///
    /// # Errors
    /// A header that is not a WAV recording's, or samples in an unsupported format.
    pub fn new(mut reader: R, file_bytes: u64) -> Result<Self, RecordingError> {
        let header = WavHeader::read(&mut reader)?;
        Ok(Self {
            reader,
            file_bytes,
            declared: header.data_bytes,
            data_start: header.data_start,
            read: 0,
            early_end: None,
            buffer: Vec::new(),
            next: 0,
            samples: WavSamples::new(header.format),
        })
    }

    /// Returns the format of the samples.
    pub fn format(&self) -> WavFormat {
        self.samples.format
    }

    /// Returns the largest possible number of frames in the file.
    pub fn frames_at_most(&self) -> u64 {
        let available = self.file_bytes.saturating_sub(self.data_start);
        self.declared.unwrap_or(available).min(available) / self.format().frame_bytes() as u64
    }

    /// Rejects a truncated recording.
    ///
    /// # Errors
    /// [`RecordingError::WavEnds`].
    pub fn check_length(&self) -> Result<(), RecordingError> {
        let byte = self.file_bytes;
        let found = byte.saturating_sub(self.data_start);
        match self.declared {
            Some(declared) if declared > found => {
                Err(RecordingError::WavEnds { part: "the data chunk", byte, declared, found })
            }
            _ => Ok(()),
        }
    }

    /// Reads the next frame; returns false at the end. `frame` has one sample per channel.
    ///
    /// # Errors
    /// A truncated file, samples with non-empty padding, and reading errors.
    pub fn next_frame(&mut self, frame: &mut [f32]) -> Result<bool, RecordingError> {
        if self.next == self.buffer.len() {
            self.fill()?;
            if self.buffer.is_empty() {
                return Ok(false);
            }
        }
        let format = self.format();
        let bytes = &self.buffer[self.next..self.next + format.frame_bytes()];
        for (sample, bytes) in frame.iter_mut().zip(bytes.chunks_exact(format.container)) {
            *sample = self.samples.value(bytes);
        }
        self.next += format.frame_bytes();
        Ok(true)
    }

    /// Reads the next whole frames.
    fn fill(&mut self) -> Result<(), RecordingError> {
        let frame = self.format().frame_bytes();
        if let Some(found) = self.early_end {
            return Err(RecordingError::WavEnds {
                part: "the data chunk",
                byte: self.data_start + found,
                declared: self.declared.unwrap_or(self.read + frame as u64),
                found,
            });
        }
        let wanted = (READ_BYTES / frame).max(1) * frame;
        let wanted = match self.declared {
            Some(declared) => wanted.min(usize::try_from(declared - self.read).unwrap_or(wanted)),
            None => wanted,
        };
        self.next = 0;
        self.buffer.resize(wanted, 0);
        let mut filled = 0;
        while filled < wanted {
            match self.reader.read(&mut self.buffer[filled..]) {
                Ok(0) => break,
                Ok(n) => filled += n,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error.into()),
            }
        }
        // Complete frames are returned first; the next call reports the truncation.
        let whole = filled / frame * frame;
        let found = self.read + filled as u64;
        if filled < wanted && (self.declared.is_some() || filled > whole) {
            self.early_end = Some(found);
        }
        self.read += whole as u64;
        self.buffer.truncate(whole);
        self.samples.check_padding(&self.buffer)
    }
}

impl WavSamples {
    /// Creates a reader of samples in this format.
    pub fn new(format: WavFormat) -> Self {
        Self { format, justification: None }
    }

    /// Returns the format of the samples.
    pub fn format(&self) -> WavFormat {
        self.format
    }

    /// Returns the values of the next whole samples.
    ///
    /// # Errors
    /// Samples with non-empty padding.
    pub fn values<'a>(
        &'a mut self,
        bytes: &'a [u8],
    ) -> Result<impl Iterator<Item = f32> + 'a, RecordingError> {
        self.check_padding(bytes)?;
        let this = &*self;
        Ok(bytes.chunks_exact(this.format.container).map(|sample| this.value(sample)))
    }

    fn value(&self, bytes: &[u8]) -> f32 {
        decode(bytes, &self.format, self.justification)
    }

    /// Determines the position of the valid bits from the samples, and rejects samples that fit neither
    /// position.
    fn check_padding(&mut self, bytes: &[u8]) -> Result<(), RecordingError> {
        let padding = padding_bits(&self.format);
        if padding == 0 {
            return Ok(());
        }
        let samples = bytes.chunks_exact(self.format.container);
        if samples.clone().all(|bytes| bytes.iter().all(|&byte| byte == 0)) {
            return Ok(());
        }
        // The position found in earlier data applies to the rest.
        let may_be = |justification| self.justification.is_none_or(|found| found == justification);
        let is_left = |empty_bits: usize| {
            may_be(Justification::Left)
                && samples.clone().all(|bytes| low_bits(bytes, &self.format, empty_bits) == 0)
        };
        let is_right = || {
            may_be(Justification::Right)
                && samples.clone().all(|bytes| {
                    let high = most_significant_first(bytes, &self.format) >> (64 - padding);
                    high == 0 || high == (1 << padding) - 1
                })
        };
        self.justification = if is_left(padding) {
            Some(Justification::Left)
        } else if is_right() {
            Some(Justification::Right)
        } else if is_left(padding / 8 * 8) {
            // Some writers use all bits of the last byte, such as 24 for 20.
            Some(Justification::Left)
        } else {
            return Err(RecordingError::wav(
                "sample padding",
                format!(
                    "not empty in containers of {} bytes for {} bits",
                    self.format.container, self.format.bits
                ),
                "all samples in the upper bits of the container, or all in the lower ones",
            ));
        };
        Ok(())
    }
}

/// Returns a container's bytes in the upper bytes of a word, most significant byte first.
fn most_significant_first(bytes: &[u8], format: &WavFormat) -> u64 {
    let mut word = [0; 8];
    let used = &mut word[..bytes.len()];
    used.copy_from_slice(bytes);
    if !format.big_endian {
        used.reverse();
    }
    u64::from_be_bytes(word)
}

fn low_bits(bytes: &[u8], format: &WavFormat, padding: usize) -> u64 {
    (most_significant_first(bytes, format) >> (64 - 8 * bytes.len())) & ((1 << padding) - 1)
}

/// Returns the number of bits of a container that hold no sample. Those of a single byte, whose samples are
/// unsigned, are always the lower ones.
fn padding_bits(format: &WavFormat) -> usize {
    if format.float || format.container == 1 { 0 } else { 8 * format.container - format.bits }
}

fn decode(bytes: &[u8], format: &WavFormat, justification: Option<Justification>) -> f32 {
    let word = most_significant_first(bytes, format);
    if format.float {
        return match format.container {
            4 => f32::from_bits((word >> 32) as u32),
            _ => f64::from_bits(word) as f32,
        };
    }
    let word = match justification {
        Some(Justification::Right) => word << padding_bits(format),
        _ => word,
    };
    // Samples of up to 8 bits are unsigned around 128: flipping the sign bit makes them signed.
    let word = if format.container == 1 { word ^ (1 << 63) } else { word };
    const FULL_SCALE: f64 = 9_223_372_036_854_775_808.0;
    (word.cast_signed() as f64 / FULL_SCALE) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The values of words, in the lower or the upper bits of a container.
    fn values_of(bits: usize, container: usize, words: &[i32]) -> Result<Vec<f32>, String> {
        let (channels, sample_rate_hz, float, big_endian) = (1, 8000, false, false);
        let format = WavFormat { channels, sample_rate_hz, bits, container, float, big_endian };
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()[..container].to_vec()).collect();
        let mut samples = WavSamples::new(format);
        samples.values(&bytes).map(Iterator::collect).map_err(|error| error.to_string())
    }

    #[test]
    fn bits_that_are_no_whole_bytes_are_found_in_either_position() {
        for (bits, container, words) in [
            (12, 2, [0x7ff, -0x800, 1]),
            (12, 2, [0x7ff0, -0x8000, 0x10]),
            (20, 4, [0x7_ffff, -0x8_0000, 1]),
            (20, 4, [0x7_ffff << 12, i32::MIN, 1 << 12]),
            (20, 3, [0x7_ffff, -0x8_0000, 1]),
        ] {
            let full = f32::from(1_u16 << (bits - 9)) * 256.0;
            let expected = [(full - 1.0) / full, -1.0, 1.0 / full];
            assert_eq!(values_of(bits, container, &words).unwrap(), expected, "{bits} in {container}");
        }
        // All bits of the last byte may be used.
        assert_eq!(values_of(20, 3, &[0x40_0001]).unwrap(), [0.500_000_1]);
        let error = values_of(20, 4, &[0x4000_0001]).unwrap_err();
        assert!(error.contains("not empty in containers of 4 bytes for 20 bits"), "{error}");
        // Eight bits and fewer are unsigned.
        assert_eq!(values_of(7, 1, &[0xc0, 0x01]).unwrap(), [0.5, -0.992_187_5]);
    }

    #[test]
    fn parts_of_the_data_share_the_position_of_the_bits() {
        let format = WavFormat {
            channels: 1,
            sample_rate_hz: 8000,
            bits: 24,
            container: 4,
            float: false,
            big_endian: false,
        };
        let mut samples = WavSamples::new(format);
        let mut values = |words: &[i32]| -> Result<Vec<f32>, RecordingError> {
            let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
            Ok(samples.values(&bytes)?.collect())
        };
        // The second sample has no sign in its upper byte.
        assert_eq!(values(&[0, 0]).unwrap(), [0.0, 0.0]);
        assert_eq!(values(&[0x40_0001, 0xc0_0000, -0x40_0000]).unwrap()[1..], [-0.5, -0.5]);
        assert_eq!(values(&[0x40_0000]).unwrap(), [0.5]);
        let error = values(&[0x4000_0000]).unwrap_err().to_string();
        assert!(
            error.contains("sample padding is not empty in containers of 4 bytes for 24 bits"),
            "{error}"
        );
    }
}
