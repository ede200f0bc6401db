//! The variables of a MATLAB file of version 5: arrays of real numbers, including those in structs.
//!
//! Format: MathWorks, *MAT-File Format*, chapter 1. Everything except two-dimensional arrays of real numbers
//! (text, cells, sparse and complex arrays, objects, arrays of structs) is skipped.

use std::borrow::Cow;
use std::io::Read;

use flate2::read::ZlibDecoder;

use super::RecordingError;
use super::error::shortened;
use super::number::Number;

/// Number of bytes before the first variable.
const HEADER: usize = 128;

/// Largest nesting depth of structs.
const MAX_DEPTH: usize = 8;

/// Largest number of variables and fields in a file.
const MAX_VARIABLES: usize = 4096;

/// Element types.
const COMPRESSED: u32 = 15;
const MATRIX: u32 = 14;

/// Array classes.
const STRUCT: u8 = 2;
const NUMERIC: std::ops::RangeInclusive<u8> = 6..=15;
const COMPLEX: u32 = 0x800;
const LOGICAL: u32 = 0x200;

/// An array of real numbers in column-major order.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Variable {
    /// Name, preceded by the names of the enclosing structs.
    pub(crate) name: String,
    /// Numbers of rows and columns.
    pub(crate) shape: [usize; 2],
    /// Whether its values are truth values.
    pub(crate) is_logical: bool,
    number: Number,
    big_endian: bool,
    bytes: Vec<u8>,
}

impl Variable {
    /// Returns its number of values.
    pub(crate) fn len(&self) -> usize {
        self.bytes.len() / self.number.bytes()
    }

    /// Returns one of its values; NaN beyond the end.
    pub(crate) fn value(&self, at: usize) -> f64 {
        let width = self.number.bytes();
        let mut word = [0; 8];
        let Some(bytes) = self.bytes.get(at * width..(at + 1) * width) else { return f64::NAN };
        word[..width].copy_from_slice(bytes);
        if self.big_endian {
            word[..width].reverse();
        }
        self.number.value(&word[..width])
    }
}

/// A variable that is not an array of real numbers: its name, and what it is.
pub(crate) type Skipped = (String, &'static str);

/// Reads the arrays of real numbers in a file, which may take `max_bytes` once inflated. Also returns what
/// else is in it.
///
/// # Errors
/// The file is damaged, truncated or too large.
pub(crate) fn variables(
    bytes: &[u8],
    max_bytes: u64,
) -> Result<(Vec<Variable>, Vec<Skipped>), RecordingError> {
    let big_endian = match bytes.get(HEADER - 2..HEADER) {
        Some(b"IM") => false,
        Some(b"MI") => true,
        Some(other) => return Err(invalid("byte order", format!("{other:02x?}"), "IM or MI")),
        None => return Err(invalid("header", format!("{} bytes long", bytes.len()), "128 bytes")),
    };
    let mut reader =
        Variables { big_endian, bytes: 0, max_bytes, found: Vec::new(), skipped: Vec::new(), count: 0 };
    let mut elements = Elements { bytes: &bytes[HEADER..], big_endian };
    while let Some((kind, data)) = elements.next()? {
        match kind {
            COMPRESSED => {
                let data = reader.inflate(data)?;
                let mut inner = Elements { bytes: &data, big_endian };
                if let Some((MATRIX, data)) = inner.next()? {
                    reader.add(data, "", 0)?;
                }
            }
            MATRIX => reader.add(data, "", 0)?,
            _ => {}
        }
    }
    Ok((reader.found, reader.skipped))
}

struct Variables {
    big_endian: bool,
    /// Number of allocated bytes, and the largest one.
    bytes: u64,
    max_bytes: u64,
    found: Vec<Variable>,
    skipped: Vec<Skipped>,
    count: usize,
}

impl Variables {
    fn inflate<'a>(&mut self, data: &'a [u8]) -> Result<Cow<'a, [u8]>, RecordingError> {
        let mut inflated = Vec::new();
        let read = ZlibDecoder::new(data).take(self.max_bytes - self.bytes + 1).read_to_end(&mut inflated);
        read.map_err(|error| invalid("compressed variable", error, "whole zlib data"))?;
        self.take(inflated.len())?;
        Ok(Cow::Owned(inflated))
    }

    fn take(&mut self, bytes: usize) -> Result<(), RecordingError> {
        self.bytes += bytes as u64;
        if self.bytes > self.max_bytes {
            let expected = format!("at most {} bytes: split the file into several", self.max_bytes);
            return Err(invalid("size of the variables", format!("{} bytes or more", self.bytes), expected));
        }
        Ok(())
    }

    /// Adds the variable of a matrix element, or the fields of a struct.
    fn add(&mut self, data: &[u8], within: &str, depth: usize) -> Result<(), RecordingError> {
        self.count += 1;
        if self.count > MAX_VARIABLES {
            return Err(invalid("number of variables", format!("{} or more", self.count), "at most 4096"));
        }
        if depth > MAX_DEPTH {
            return Err(invalid("depth of structs", depth, "at most 8"));
        }
        let mut parts = Elements { bytes: data, big_endian: self.big_endian };
        // An array without content, as a field may be.
        let Some((_, flags)) = parts.next()? else { return Ok(()) };
        let flags = self.words(flags).next().ok_or_else(|| invalid("flags", "missing", "8 bytes"))?;
        let class = flags as u8;
        let kind = match class {
            _ if flags & COMPLEX != 0 => Some("complex"),
            1 => Some("a cell array"),
            3 => Some("an object"),
            4 => Some("text"),
            5 => Some("sparse"),
            class if class == STRUCT || NUMERIC.contains(&class) => None,
            // What is stored after these, such as a table, is not laid out like an array.
            _ => return Ok(()),
        };
        let shape: Vec<usize> = self.words(parts.part("dimensions")?.1).map(|word| word as usize).collect();
        let own = String::from_utf8_lossy(parts.part("name")?.1).into_owned();
        let name = if within.is_empty() { own } else { within.to_owned() };
        if let Some(kind) = kind {
            self.skipped.push((name, kind));
            return Ok(());
        }
        let [rows, columns] = shape[..] else { return Ok(()) };
        if class == STRUCT {
            return if (rows, columns) == (1, 1) { self.add_fields(parts, &name, depth) } else { Ok(()) };
        }
        let (kind, data) = parts.part("numbers")?;
        let number = number(kind).ok_or_else(|| invalid("type of numbers", kind, "one of 1 to 13"))?;
        let bytes = rows.checked_mul(columns).and_then(|count| count.checked_mul(number.bytes()));
        if bytes != Some(data.len()) {
            let value =
                format!("{rows} × {columns} numbers of {:?} in {} bytes", shortened(&name), data.len());
            return Err(invalid("shape", value, format!("{} bytes for each number", number.bytes())));
        }
        self.take(data.len())?;
        let big_endian = self.big_endian;
        let (shape, is_logical, bytes) = ([rows, columns], flags & LOGICAL != 0, data.to_vec());
        self.found.push(Variable { name, shape, is_logical, number, big_endian, bytes });
        Ok(())
    }

    fn add_fields(
        &mut self,
        mut parts: Elements<'_>,
        name: &str,
        depth: usize,
    ) -> Result<(), RecordingError> {
        let length = self.words(parts.part("length of field names")?.1).next().unwrap_or_default() as usize;
        let names = parts.part("field names")?.1;
        if length == 0 {
            return Ok(());
        }
        for field in names.chunks_exact(length) {
            let end = field.iter().position(|byte| *byte == 0).unwrap_or(length);
            let field = String::from_utf8_lossy(&field[..end]);
            let (kind, data) = parts.part("field")?;
            if kind == MATRIX {
                self.add(data, &format!("{name}.{field}"), depth + 1)?;
            }
        }
        Ok(())
    }

    fn words<'a>(&self, bytes: &'a [u8]) -> impl Iterator<Item = u32> + use<'a> {
        let big_endian = self.big_endian;
        bytes.chunks_exact(4).map(move |word| word_of(word, big_endian))
    }
}

fn word_of(bytes: &[u8], big_endian: bool) -> u32 {
    let bytes = bytes.try_into().unwrap_or_default();
    if big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
}

/// A sequence of elements: type, length, data, and padding to 8 bytes.
struct Elements<'a> {
    bytes: &'a [u8],
    big_endian: bool,
}

impl<'a> Elements<'a> {
    /// Returns type and data of the next element; `None` at the end.
    fn next(&mut self) -> Result<Option<(u32, &'a [u8])>, RecordingError> {
        let Some((tag, rest)) = self.bytes.split_at_checked(8) else {
            let rest = std::mem::take(&mut self.bytes);
            if rest.iter().any(|byte| *byte != 0) {
                return Err(invalid(
                    "end",
                    format!("{} bytes of a variable", rest.len()),
                    "a whole variable",
                ));
            }
            return Ok(None);
        };
        let first = word_of(&tag[..4], self.big_endian);
        // Up to 4 bytes of data are stored within the tag.
        if first >> 16 != 0 {
            let length = (first >> 16) as usize;
            let data = tag.get(4..4 + length).ok_or_else(|| invalid("length", length, "at most 4"))?;
            self.bytes = rest;
            return Ok(Some((first & 0xffff, data)));
        }
        let length = word_of(&tag[4..], self.big_endian) as usize;
        let (data, rest) = rest.split_at_checked(length).ok_or_else(|| {
            let expected = "as many bytes as the file holds";
            invalid("length", format!("{length}, but {} are there", rest.len()), expected)
        })?;
        let padding = if first == COMPRESSED { 0 } else { length.next_multiple_of(8) - length };
        self.bytes = rest.get(padding..).unwrap_or_default();
        Ok(Some((first, data)))
    }

    /// Returns type and data of the next element, which must exist.
    fn part(&mut self, what: &'static str) -> Result<(u32, &'a [u8]), RecordingError> {
        self.next()?.ok_or_else(|| invalid(what, "missing", "a part of every variable"))
    }
}

fn number(kind: u32) -> Option<Number> {
    Some(match kind {
        1 => Number::I8,
        2 => Number::U8,
        3 => Number::I16,
        4 => Number::U16,
        5 => Number::I32,
        6 => Number::U32,
        7 => Number::F32,
        9 => Number::F64,
        12 => Number::I64,
        13 => Number::U64,
        _ => return None,
    })
}

/// Creates the error for an invalid part of a MATLAB file.
pub(super) fn invalid(
    field: &'static str,
    value: impl ToString,
    expected: impl Into<Cow<'static, str>>,
) -> RecordingError {
    RecordingError::Content { format: "mat", field, value: value.to_string(), expected: expected.into() }
}
