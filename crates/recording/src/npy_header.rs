//! The header of a NumPy array: a dictionary in Python notation.

use std::io::Read;

use super::RecordingError;
use super::error::shortened;
use super::number::Number;

/// Magic number.
pub(crate) const MAGIC: &[u8] = b"\x93NUMPY";

/// Longest header in bytes; those of NumPy have about a hundred.
const MAX_HEADER: usize = 1 << 16;

/// Largest number of channels.
const MAX_CHANNELS: u64 = 256;

/// How the values of an array are stored.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NpyHeader {
    pub(crate) number: Number,
    pub(crate) big_endian: bool,
    pub(crate) frames: u64,
    pub(crate) channels: usize,
    /// Whether the channels follow one another (Fortran order), otherwise the frames.
    pub(crate) is_by_column: bool,
}

impl NpyHeader {
    /// Reads the header; the next byte is the first of the values.
    pub(crate) fn read(reader: &mut impl Read) -> Result<Self, RecordingError> {
        let header = header(reader)?;
        let field = |key: &'static str, expected| {
            value_of(&header, key).ok_or_else(|| npy("description", shortened(header.trim()), expected))
        };
        let descr = field("descr", "an array with a type, 'descr'")?;
        let (number, big_endian) = number(descr)?;
        let shape = field("shape", "an array with a shape")?;
        let (frames, channels) = shape_of(shape)?;
        let is_by_column = match field("fortran_order", "an array with an order, 'fortran_order'")? {
            "True" => channels > 1,
            "False" => false,
            other => return Err(npy("fortran_order", shortened(other), "True or False")),
        };
        Ok(Self { number, big_endian, frames, channels, is_by_column })
    }

    /// Returns the size of a frame in bytes.
    pub(crate) fn frame_bytes(&self) -> usize {
        self.channels * self.number.bytes()
    }
}

pub(crate) fn npy(field: &'static str, value: impl ToString, expected: &'static str) -> RecordingError {
    RecordingError::Content { format: "npy", field, value: value.to_string(), expected: expected.into() }
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
