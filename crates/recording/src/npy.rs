//! NumPy arrays (.npy): the samples of one channel, or one row of samples per time step.
//!
//! Values are used unchanged, including integers; `scale` of [`RecordDefaults`] converts them. The array has
//! neither rate nor time; the defaults give both.

use std::io::Read;

use super::error::shortened;
use super::number::Number;
use super::{Frames, FramesInfo, RecordBlocks, RecordDefaults, RecordingError};
use flankwatch_signal::Record;

/// Magic number.
pub(crate) const MAGIC: &[u8] = b"\x93NUMPY";

/// Longest header in bytes; those of NumPy have about a hundred.
const MAX_HEADER: usize = 1 << 16;

/// Largest number of channels.
const MAX_CHANNELS: u64 = 256;

/// Largest number of frames read at once.
const FRAMES_AT_ONCE: u64 = 4096;

/// Reads a NumPy array as one record per channel; the sampling rate is that of the defaults.
///
/// # Errors
/// The array is damaged, not one of real numbers, or longer than a record may be; there is no rate.
pub fn decode_npy(bytes: &[u8], defaults: &RecordDefaults) -> Result<Vec<Record>, RecordingError> {
    if bytes.is_empty() {
        return Err(RecordingError::NoBytes);
    }
    RecordBlocks::whole(NpyFrames::new(bytes)?, defaults)?.collect()
}

/// The frames of a NumPy array, read on demand.
#[derive(Debug)]
pub struct NpyFrames<R> {
    reader: R,
    number: Number,
    big_endian: bool,
    frames: u64,
    channels: usize,
    read: u64,
    buffer: Vec<u8>,
    next: usize,
}

impl<R: Read> NpyFrames<R> {
    /// Reads the header of the array.
    ///
    /// # Errors
    /// The header is damaged, the array is not one of real numbers in one or two dimensions, or reading
    /// fails.
    pub fn new(mut reader: R) -> Result<Self, RecordingError> {
        let header = header(&mut reader)?;
        let field = |key: &'static str, expected| {
            value_of(&header, key).ok_or_else(|| npy("description", shortened(header.trim()), expected))
        };
        let descr = field("descr", "an array with a type, 'descr'")?;
        let (number, big_endian) = number(descr)?;
        let shape = field("shape", "an array with a shape")?;
        let (frames, channels) = shape_of(shape)?;
        let is_fortran = field("fortran_order", "an array with an order, 'fortran_order'")?;
        if is_fortran != "False" && channels > 1 {
            let expected = "False: rows of channels, one after the other (numpy.ascontiguousarray)";
            return Err(npy("fortran_order", shortened(is_fortran), expected));
        }
        Ok(Self { reader, number, big_endian, frames, channels, read: 0, buffer: Vec::new(), next: 0 })
    }

    fn frame_bytes(&self) -> usize {
        self.channels * self.number.bytes()
    }

    fn fill(&mut self) -> Result<(), RecordingError> {
        let frames = FRAMES_AT_ONCE.min(self.frames - self.read);
        let wanted = frames as usize * self.frame_bytes();
        self.buffer.clear();
        self.next = 0;
        self.reader.by_ref().take(wanted as u64).read_to_end(&mut self.buffer)?;
        if self.buffer.len() < wanted {
            let found = self.read + (self.buffer.len() / self.frame_bytes()) as u64;
            let what = format!("{} frames, but {found} are there", self.frames);
            return Err(npy("shape", what, "as many frames as the file holds"));
        }
        self.read += frames;
        Ok(())
    }
}

impl<R: Read> Frames for NpyFrames<R> {
    fn info(&self, defaults: &RecordDefaults) -> Result<FramesInfo, RecordingError> {
        let rate_hz = defaults.sample_rate_hz.ok_or_else(|| {
            let expected = "a rate in hertz, as a NumPy array does not contain it";
            RecordingError::field("sample rate", "missing", expected)
        })?;
        Ok(FramesInfo::without_time(defaults.names_of(self.channels), rate_hz, self.frames, defaults))
    }

    fn next_frame(&mut self, frame: &mut [f32]) -> Result<bool, RecordingError> {
        if self.next == self.buffer.len() {
            self.fill()?;
            if self.buffer.is_empty() {
                return Ok(false);
            }
        }
        let end = self.next + self.frame_bytes();
        let width = self.number.bytes();
        for (sample, bytes) in frame.iter_mut().zip(self.buffer[self.next..end].chunks_exact_mut(width)) {
            if self.big_endian {
                bytes.reverse();
            }
            *sample = self.number.value(bytes) as f32;
        }
        self.next = end;
        Ok(true)
    }
}

fn npy(field: &'static str, value: impl ToString, expected: &'static str) -> RecordingError {
    RecordingError::Content { format: "npy", field, value: value.to_string(), expected }
}

/// Reads the header, a dictionary in Python notation.
fn header(reader: &mut impl Read) -> Result<String, RecordingError> {
    let mut beginning = [0; 8];
    let mut exact = |bytes: &mut [u8]| {
        reader.read_exact(bytes).map_err(|error| match error.kind() {
            std::io::ErrorKind::UnexpectedEof => npy("header", "cut off", "a whole header"),
            _ => error.into(),
        })
    };
    exact(&mut beginning)?;
    if !beginning.starts_with(MAGIC) {
        return Err(npy("beginning", format!("{beginning:02x?}"), "the magic number of a NumPy array"));
    }
    let length = match beginning[6] {
        1 => {
            let mut length = [0; 2];
            exact(&mut length)?;
            u32::from(u16::from_le_bytes(length))
        }
        2 | 3 => {
            let mut length = [0; 4];
            exact(&mut length)?;
            u32::from_le_bytes(length)
        }
        version => return Err(npy("version", version, "1, 2 or 3")),
    };
    if length as usize > MAX_HEADER {
        return Err(npy("header length", length, "at most 65536 bytes"));
    }
    let mut text = vec![0; length as usize];
    exact(&mut text)?;
    String::from_utf8(text).map_err(|_| npy("header", "not UTF-8", "a dictionary in Python's notation"))
}

/// Returns the value after a key, up to the next comma.
fn value_of<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let after = header.find(&format!("'{key}'")).map(|at| &header[at + key.len() + 2..])?;
    let value = after.trim_start().strip_prefix(':')?.trim_start();
    let end = match value.as_bytes().first()? {
        b'(' => value.find(')')? + 1,
        b'[' => value.find(']')? + 1,
        b'\'' => value[1..].find('\'')? + 2,
        _ => value.find([',', '}'])?,
    };
    Some(value[..end].trim_end())
}

/// Parses the type of the values, and whether the most significant byte comes first.
fn number(descr: &str) -> Result<(Number, bool), RecordingError> {
    let name = descr.trim_matches('\'');
    let number = match name.get(1..) {
        Some("f4") => Number::F32,
        Some("f8") => Number::F64,
        Some("i1") => Number::I8,
        Some("u1") => Number::U8,
        Some("i2") => Number::I16,
        Some("u2") => Number::U16,
        Some("i4") => Number::I32,
        Some("u4") => Number::U32,
        Some("i8") => Number::I64,
        Some("u8") => Number::U64,
        _ => {
            let expected = "f4, f8, or i or u with 1, 2, 4 or 8 bytes (numpy.asarray(x, 'f4'))";
            return Err(npy("descr", shortened(descr), expected));
        }
    };
    match name.as_bytes()[0] {
        b'<' | b'|' => Ok((number, false)),
        b'>' => Ok((number, true)),
        _ => Err(npy("descr", shortened(descr), "a byte order, < or >")),
    }
}

/// Parses the numbers of frames and channels in a shape.
fn shape_of(shape: &str) -> Result<(u64, usize), RecordingError> {
    let wrong =
        || npy("shape", shortened(shape), "(samples,) or (samples, channels) with at most 256 channels");
    let inner = shape.strip_prefix('(').and_then(|shape| shape.strip_suffix(')')).ok_or_else(wrong)?;
    let lengths: Result<Vec<u64>, _> =
        inner.split(',').map(str::trim).filter(|length| !length.is_empty()).map(str::parse).collect();
    match lengths.map_err(|_| wrong())?[..] {
        [frames] => Ok((frames, 1)),
        [frames, channels @ 1..=MAX_CHANNELS] => Ok((frames, channels as usize)),
        _ => Err(wrong()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file as NumPy writes it.
    fn file(description: &str, data: &[u8]) -> Vec<u8> {
        let text = format!("{description:<117}\n");
        let mut bytes = [MAGIC, &[1, 0], &(text.len() as u16).to_le_bytes()].concat();
        bytes.extend_from_slice(text.as_bytes());
        bytes.extend_from_slice(data);
        bytes
    }

    fn array(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        file(&format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}"), data)
    }

    fn read(bytes: &[u8], scale: Option<f64>) -> Result<Vec<Record>, String> {
        let defaults = RecordDefaults { sample_rate_hz: Some(100.0), scale, ..RecordDefaults::default() };
        let blocks = NpyFrames::new(bytes).and_then(|frames| RecordBlocks::new(frames, &defaults, None));
        blocks.and_then(Iterator::collect).map_err(|error| error.to_string())
    }

    fn only(bytes: &[u8]) -> Vec<f32> {
        let records = read(bytes, None).unwrap();
        assert_eq!(records.len(), 1);
        records[0].samples().to_vec()
    }

    #[test]
    fn numbers_of_every_type_are_read() {
        let bytes = |values: &[&[u8]]| values.concat();
        let le = bytes(&[&1.5_f32.to_le_bytes(), &(-2.0_f32).to_le_bytes()]);
        assert_eq!(only(&array("<f4", "(2,)", &le)), [1.5, -2.0]);
        let be = bytes(&[&1.5_f64.to_be_bytes(), &(-2.0_f64).to_be_bytes()]);
        assert_eq!(only(&array(">f8", "(2,)", &be)), [1.5, -2.0]);
        assert_eq!(only(&array("|i1", "(2,)", &[0x80, 0x7f])), [-128.0, 127.0]);
        assert_eq!(only(&array("|u1", "(2,)", &[0x80, 0x7f])), [128.0, 127.0]);
        assert_eq!(only(&array(">i2", "(2,)", &[0x80, 0, 0, 1])), [-32768.0, 1.0]);
        assert_eq!(only(&array("<u2", "(2,)", &[0, 0x80, 1, 0])), [32768.0, 1.0]);
        assert_eq!(only(&array("<i4", "(1,)", &(-70_000_i32).to_le_bytes())), [-70_000.0]);
        assert_eq!(only(&array("<u4", "(1,)", &70_000_u32.to_le_bytes())), [70_000.0]);
    }

    #[test]
    fn rows_are_time_steps_and_columns_are_channels() {
        let data: Vec<u8> = [1_i16, 10, 2, 20, 3, 30].iter().flat_map(|value| value.to_le_bytes()).collect();
        let records = read(&array("<i2", "(3, 2)", &data), Some(0.5)).unwrap();
        assert_eq!((records[0].channel(), records[0].samples()), ("1", &[0.5, 1.0, 1.5][..]));
        assert_eq!((records[1].channel(), records[1].samples()), ("2", &[5.0, 10.0, 15.0][..]));
    }

    #[test]
    fn unreadable_files_name_the_problem() {
        for (bytes, words) in [
            (array("<c16", "(2,)", &[]), ["descr", "'<c16'"]),
            (array("O", "(2,)", &[]), ["descr", "'O'"]),
            (array("=f4", "(2,)", &[]), ["descr", "byte order"]),
            (array("<f4", "(2, 3, 4)", &[]), ["shape", "(2, 3, 4)"]),
            (array("<f4", "(2, 0)", &[]), ["shape", "(2, 0)"]),
            (array("<f4", "(2, 257)", &[]), ["shape", "257"]),
            (array("<f4", "()", &[]), ["shape", "()"]),
            (array("<f4", "(99999999999999999999,)", &[]), ["shape", "99999"]),
            (array("<f4", "(18446744073709551615,)", &[0; 8]), ["frames", "2 are there"]),
            (array("<f4", "(3,)", &[0; 8]), ["3 frames", "2 are there"]),
            (
                file("{'descr': '<f4', 'fortran_order': True, 'shape': (2, 2), }", &[0; 16]),
                ["fortran_order", "True"],
            ),
            (file("{'descr': '<f4', 'shape': (2,), }", &[0; 8]), ["description", "fortran_order"]),
            (file("[]", &[]), ["description", "descr"]),
            (array("<f4", "(2,)", &[])[..40].to_vec(), ["header", "cut off"]),
            ([MAGIC, &[2, 0, 0xff, 0xff, 0xff, 0xff]].concat(), ["header length", "4294967295"]),
            ([MAGIC, &[9, 0]].concat(), ["version", "9"]),
            (array("<f4", "(1,)", &f32::NAN.to_le_bytes()), ["sample", "NaN"]),
        ] {
            let error = read(&bytes, None).unwrap_err();
            for word in words {
                assert!(error.contains(word), "{word:?} in {error:?}");
            }
        }
        let bytes = array("<f4", "(1,)", &[0; 4]);
        let frames = NpyFrames::new(&bytes[..]).unwrap();
        let error = frames.info(&RecordDefaults::default()).unwrap_err();
        assert!(error.to_string().contains("sample rate"), "{error}");
    }

    #[test]
    fn arbitrary_bytes_are_read_or_rejected() {
        let whole = array("<i2", "(3, 2)", &[0; 12]);
        for at in 0..whole.len() {
            let _ = read(&whole[..at], None);
            for value in [0, 0x27, 0x28, 0x2c, 0x7f, 0xff] {
                let mut damaged = whole.clone();
                damaged[at] = value;
                let _ = read(&damaged, None);
            }
        }
    }
}
