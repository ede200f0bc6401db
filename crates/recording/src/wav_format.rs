//! The header of a WAV recording: RIFF, RIFX (big endian), RF64 or its successor BW64 (64-bit lengths), up to
//! the first byte of the data.
//!
//! It is not read by hound, which rejects RIFX, RF64, BW64, 64-bit samples and unusual bit depths without a
//! specific error. Memory is never allocated by declared lengths: skipped bytes are read and counted.

use std::io::{self, Read};

use super::RecordingError;

/// Largest number of channels.
const MAX_CHANNELS: u16 = 256;

/// Length of the `fmt` chunk in bytes: basic, and with its extension.
const FMT_BASIC: u64 = 16;
const FMT_EXTENSIBLE: u64 = 40;

/// The last bytes of every EXTENSIBLE subformat that represents a plain format tag.
const SUBFORMAT_TAIL: [u8; 8] = [0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71];

/// The length that means "unknown": of a stream, or of RF64 and BW64, whose lengths are in `ds64`.
const UNKNOWN_LENGTH: u32 = u32::MAX;

/// A declared length from here on is a placeholder of a program that did not know it: `sox` and `arecord`
/// write about 2 GiB to a pipe.
const OPEN_LENGTH: u64 = 0x7ff0_0000;

/// Format of the samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WavFormat {
    /// Number of channels, at least one.
    pub channels: usize,
    /// Sampling rate in hertz, above 0.
    pub sample_rate_hz: u32,
    /// Valid bits per sample.
    pub bits: usize,
    /// Bytes per sample, 1 to 8.
    pub container: usize,
    /// Whether samples are IEEE floating point, 32 or 64 bits; otherwise integers (up to 8 bits unsigned).
    pub float: bool,
    /// Whether the most significant byte comes first.
    pub big_endian: bool,
}

impl WavFormat {
    /// Returns the bytes of one frame (one sample of every channel).
    pub fn frame_bytes(&self) -> usize {
        self.channels * self.container
    }

    /// Reads the header of a WAV that is still being written, up to its first sample. Returns the declared
    /// bytes of samples, or `None` if their number is open, as programs that write to a pipe declare nothing
    /// or the maximum; and the position of the first sample.
    ///
    /// # Errors
    /// A header that is not a WAV recording's, or samples in an unsupported format.
    pub fn read_open_ended(reader: &mut impl Read) -> Result<(Self, Option<u64>, u64), RecordingError> {
        let header = WavHeader::read_any_length(reader)?;
        let declared = header.data_bytes.filter(|bytes| (1..OPEN_LENGTH).contains(bytes));
        Ok((header.format, declared, header.data_start))
    }
}

/// The header before the data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct WavHeader {
    /// Format of the samples.
    pub(crate) format: WavFormat,
    /// Declared length of the data, a multiple of the frame; `None` if the writer left it open (then the data
    /// extends to the end).
    pub(crate) data_bytes: Option<u64>,
    /// Position of the data's first byte.
    pub(crate) data_start: u64,
}

impl WavHeader {
    /// Reads the header up to the first byte of the data.
    pub(crate) fn read(reader: &mut impl Read) -> Result<Self, RecordingError> {
        let header = Self::read_any_length(reader)?;
        let frame_bytes = header.format.frame_bytes();
        if let Some(bytes) = header.data_bytes
            && bytes % frame_bytes as u64 != 0
        {
            return Err(RecordingError::wav(
                "data chunk length",
                format!("{bytes} with frames of {frame_bytes} bytes"),
                "a whole number of frames",
            ));
        }
        Ok(header)
    }

    /// Like [`read`](Self::read), but accepts a declared length that is not a whole number of frames, as that
    /// of a stream is a placeholder.
    fn read_any_length(reader: &mut impl Read) -> Result<Self, RecordingError> {
        let mut chunks = Chunks::open(reader)?;
        let mut format = None;
        let mut long_data_bytes = None;
        loop {
            let (name, declared) = chunks.next_chunk()?;
            match &name {
                b"ds64" => {
                    let body: [u8; 16] = chunks.body("the ds64 chunk", declared.into())?;
                    let (_, data) = body.split_at(8);
                    long_data_bytes = Some(u64::from_le_bytes(data.try_into().expect("half of 16 bytes")));
                }
                b"fmt " => format = Some(chunks.format(declared.into())?),
                b"data" => {
                    let format: WavFormat = format.ok_or_else(|| {
                        RecordingError::wav("fmt chunk", "missing", "one before the data chunk")
                    })?;
                    let data_bytes = match (declared, long_data_bytes) {
                        (UNKNOWN_LENGTH, Some(long)) if chunks.has_long_lengths => Some(long),
                        (UNKNOWN_LENGTH, _) => None,
                        (bytes, _) => Some(u64::from(bytes)),
                    };
                    return Ok(Self { format, data_bytes, data_start: chunks.position });
                }
                _ => chunks.skip("a chunk before the data", u64::from(declared) + u64::from(declared % 2))?,
            }
        }
    }
}

/// Iterates over the chunks, counting bytes.
struct Chunks<'a, R> {
    reader: &'a mut R,
    position: u64,
    big_endian: bool,
    /// Whether lengths of 64 bits are in `ds64`: RF64, BW64.
    has_long_lengths: bool,
}

impl<'a, R: Read> Chunks<'a, R> {
    fn open(reader: &'a mut R) -> Result<Self, RecordingError> {
        let mut chunks = Self { reader, position: 0, big_endian: false, has_long_lengths: false };
        let head: [u8; 12] = chunks.bytes("the RIFF header", 12)?;
        match &head[..4] {
            b"RIFF" => {}
            b"RIFX" => chunks.big_endian = true,
            b"RF64" | b"BW64" => chunks.has_long_lengths = true,
            other => {
                return Err(RecordingError::wav(
                    "file tag",
                    format!("\"{}\"", other.escape_ascii()),
                    "RIFF, RIFX, RF64 or BW64",
                ));
            }
        }
        if &head[8..] != b"WAVE" {
            return Err(RecordingError::wav(
                "form type",
                format!("\"{}\"", head[8..].escape_ascii()),
                "WAVE",
            ));
        }
        // The length in the RIFF header is ignored: existing files have wrong values, and every chunk has its
        // own.
        Ok(chunks)
    }

    fn next_chunk(&mut self) -> Result<([u8; 4], u32), RecordingError> {
        let head: [u8; 8] = self.bytes("a chunk header before the data chunk", 8)?;
        let [a, b, c, d, e, f, g, h] = head;
        Ok(([a, b, c, d], self.u32([e, f, g, h])))
    }

    fn format(&mut self, declared: u64) -> Result<WavFormat, RecordingError> {
        if declared < FMT_BASIC {
            return Err(RecordingError::wav("fmt chunk length", declared, "at least 16 bytes"));
        }
        let (basic, extension): ([u8; 16], Option<[u8; 24]>) = if declared >= FMT_EXTENSIBLE {
            let all: [u8; 40] = self.body("the fmt chunk", declared)?;
            let (basic, extension) = all.split_at(16);
            (basic.try_into().expect("first 16 bytes"), Some(extension.try_into().expect("other 24 bytes")))
        } else {
            (self.body("the fmt chunk", declared)?, None)
        };
        let [t0, t1, c0, c1, r0, r1, r2, r3, _, _, _, _, a0, a1, b0, b1] = basic;
        let mut tag = self.u16([t0, t1]);
        let channels = self.u16([c0, c1]);
        let sample_rate_hz = self.u32([r0, r1, r2, r3]);
        let block_align = self.u16([a0, a1]);
        let container_bits = self.u16([b0, b1]);
        let mut bits = container_bits;
        if tag == 0xfffe {
            let Some(extension) = extension else {
                return Err(RecordingError::wav(
                    "fmt chunk length",
                    declared,
                    "at least 40 bytes with an EXTENSIBLE format",
                ));
            };
            let valid = self.u16([extension[2], extension[3]]);
            // Some writers leave the valid bits at 0 or above the container's: then the container's count.
            if valid > 0 && valid < bits {
                bits = valid;
            }
            let [_, _, _, _, _, _, _, _, s0, s1, s2, s3, _, _, _, _, tail @ ..] = extension;
            match u16::try_from(self.u32([s0, s1, s2, s3])) {
                Ok(plain) if tail == SUBFORMAT_TAIL => tag = plain,
                _ => {
                    return Err(RecordingError::wav(
                        "subformat",
                        extension[8..].escape_ascii(),
                        "that of integer or floating-point PCM",
                    ));
                }
            }
        }
        let float = match tag {
            1 => false,
            3 => true,
            other => {
                return Err(RecordingError::wav(
                    "format tag",
                    describe(other),
                    "1 (integer PCM) or 3 (IEEE float)",
                ));
            }
        };
        if !(1..=MAX_CHANNELS).contains(&channels) {
            return Err(RecordingError::wav("channel count", channels, "1 to 256"));
        }
        let container = block_align / channels;
        if !block_align.is_multiple_of(channels)
            || !(1..=8).contains(&container)
            || bits == 0
            || container_bits > 8 * container
        {
            return Err(RecordingError::wav(
                "block align",
                format!("{block_align} bytes with {channels} channels of {container_bits} bits"),
                "channels times 1 to 8 bytes, enough for the bits",
            ));
        }
        if float && !(bits == 32 && container == 4 || bits == 64 && container == 8) {
            return Err(RecordingError::wav(
                "float sample size",
                format!("{bits} bits in {container} bytes"),
                "32 or 64 bits without padding",
            ));
        }
        Ok(WavFormat {
            channels: channels.into(),
            sample_rate_hz,
            bits: bits.into(),
            container: container.into(),
            float,
            big_endian: self.big_endian,
        })
    }

    /// Returns the first `N` bytes of a chunk's body and skips the rest.
    fn body<const N: usize>(&mut self, part: &'static str, declared: u64) -> Result<[u8; N], RecordingError> {
        if declared < N as u64 {
            return Err(RecordingError::wav(part, format!("{declared} bytes long"), "a longer chunk"));
        }
        let bytes = self.bytes(part, declared)?;
        let rest = declared - N as u64;
        self.skip(part, rest + declared % 2)?;
        Ok(bytes)
    }

    fn bytes<const N: usize>(
        &mut self,
        part: &'static str,
        declared: u64,
    ) -> Result<[u8; N], RecordingError> {
        let mut bytes = [0; N];
        let mut filled = 0;
        while filled < N {
            match self.reader.read(&mut bytes[filled..]) {
                Ok(0) => return Err(self.ends(part, declared, filled as u64)),
                Ok(n) => {
                    filled += n;
                    self.position += n as u64;
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(bytes)
    }

    fn skip(&mut self, part: &'static str, bytes: u64) -> Result<(), RecordingError> {
        let skipped = io::copy(&mut self.reader.by_ref().take(bytes), &mut io::sink())?;
        self.position += skipped;
        if skipped < bytes {
            return Err(self.ends(part, bytes, skipped));
        }
        Ok(())
    }

    fn ends(&self, part: &'static str, declared: u64, found: u64) -> RecordingError {
        RecordingError::WavEnds { part, byte: self.position, declared, found }
    }

    fn u16(&self, bytes: [u8; 2]) -> u16 {
        if self.big_endian { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) }
    }

    fn u32(&self, bytes: [u8; 4]) -> u32 {
        if self.big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
    }
}

/// Returns a format tag with its common name.
fn describe(tag: u16) -> String {
    let name = match tag {
        0x0002 => "Microsoft ADPCM",
        0x0006 => "A-law",
        0x0007 => "µ-law",
        0x0011 => "IMA ADPCM",
        0x0055 => "MP3",
        _ => return format!("{tag:#06x}"),
    };
    format!("{tag:#06x} ({name})")
}
