//! The entries of a stream's journal, in files or rows.
//!
//! An entry consists of its length, the CRC-32 of the rest, its kind and its content; numbers are
//! little-endian.

use std::io::{self, Read};

use bytes::{BufMut, Bytes, BytesMut};

/// Maximum size of an entry that is read; samples stored at once are fewer.
const MAX_ENTRY_BYTES: usize = 9 << 20;

/// Encodes a missing time.
const NO_TIME: i64 = i64::MIN;

/// Size of length and checksum.
const HEAD_BYTES: usize = 8;

/// One entry of a journal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum JournalEntry {
    /// The state after all previous entries.
    Checkpoint(Bytes),
    /// Samples that follow the previous ones or a gap.
    Frames {
        /// Index of the first frame.
        first: u64,
        /// Time of the first frame, by the sender's clock or at its receipt, in nanoseconds since 1970;
        /// `None` if unknown.
        time_ns: Option<i64>,
        /// Frames as received.
        bytes: Bytes,
    },
    /// Samples that were never received.
    Gap {
        /// Index of the first frame.
        first: u64,
        /// Number of frames.
        frames: u64,
    },
    /// Any other event.
    Event(Bytes),
}

/// What a reader finds at its position.
#[derive(Debug)]
pub(in crate::store) enum ReadEntry {
    Whole(JournalEntry),
    /// The end, in the middle of an entry or not.
    Incomplete,
    /// An entry whose length or checksum is wrong.
    Damaged,
}

impl JournalEntry {
    /// Encodes entries one after the other.
    pub(in crate::store) fn encode(entries: &[Self]) -> Bytes {
        let mut bytes = BytesMut::new();
        entries.iter().for_each(|entry| entry.write(&mut bytes));
        bytes.freeze()
    }

    /// Decodes whole entries; returns `None` if one is damaged or incomplete.
    pub(in crate::store) fn decode(mut bytes: &[u8]) -> Option<Vec<Self>> {
        let mut entries = Vec::new();
        while !bytes.is_empty() {
            match Self::read_from(&mut bytes) {
                Ok(ReadEntry::Whole(entry)) => entries.push(entry),
                _ => return None,
            }
        }
        Some(entries)
    }

    /// Reads the next entry.
    pub(in crate::store) fn read_from(reader: &mut impl Read) -> io::Result<ReadEntry> {
        let mut head = [0; HEAD_BYTES];
        if !read_whole(reader, &mut head)? {
            return Ok(ReadEntry::Incomplete);
        }
        let [a, b, c, d, e, f, g, h] = head;
        let length = u32::from_le_bytes([a, b, c, d]) as usize;
        if length > MAX_ENTRY_BYTES {
            return Ok(ReadEntry::Damaged);
        }
        let mut content = vec![0; length];
        if !read_whole(reader, &mut content)? {
            return Ok(ReadEntry::Incomplete);
        }
        if crc32fast::hash(&content) != u32::from_le_bytes([e, f, g, h]) {
            return Ok(ReadEntry::Damaged);
        }
        Ok(Self::read(content.into()).map_or(ReadEntry::Incomplete, ReadEntry::Whole))
    }

    /// Index after its samples or its gap; `None` if it has neither.
    pub(in crate::store) fn end(&self, frame_bytes: usize) -> Option<u64> {
        match self {
            Self::Frames { first, bytes, .. } => Some(first + (bytes.len() / frame_bytes) as u64),
            Self::Gap { first, frames } => Some(first + frames),
            Self::Checkpoint(_) | Self::Event(_) => None,
        }
    }

    /// Appends those of its frames that are from the index `next` on and before `end`, if it has the first of
    /// them; returns the index after them.
    pub(in crate::store) fn copy_frames(
        &self,
        next: u64,
        end: u64,
        frame_bytes: usize,
        out: &mut BytesMut,
    ) -> u64 {
        let Self::Frames { first, bytes, .. } = self else { return next };
        let until = (first + (bytes.len() / frame_bytes) as u64).min(end);
        if *first > next || next >= until {
            return next;
        }
        let at = |index: u64| (index - first) as usize * frame_bytes;
        out.put_slice(&bytes[at(next)..at(until)]);
        until
    }

    fn write(&self, out: &mut BytesMut) {
        let begin = out.len();
        out.put_bytes(0, HEAD_BYTES);
        match self {
            Self::Checkpoint(text) => {
                out.put_u8(1);
                out.put_slice(text);
            }
            Self::Frames { first, time_ns, bytes } => {
                out.put_u8(2);
                out.put_u64_le(*first);
                out.put_i64_le(time_ns.unwrap_or(NO_TIME));
                out.put_slice(bytes);
            }
            Self::Gap { first, frames } => {
                out.put_u8(3);
                out.put_u64_le(*first);
                out.put_u64_le(*frames);
            }
            Self::Event(text) => {
                out.put_u8(4);
                out.put_slice(text);
            }
        }
        let content = &out[begin + HEAD_BYTES..];
        let (length, sum) = (content.len() as u32, crc32fast::hash(content));
        out[begin..begin + 4].copy_from_slice(&length.to_le_bytes());
        out[begin + 4..begin + HEAD_BYTES].copy_from_slice(&sum.to_le_bytes());
    }

    /// Decodes an entry; returns `None` if its kind or content is unknown.
    fn read(content: Bytes) -> Option<Self> {
        let (kind, content) = (*content.first()?, content.slice(1..));
        let number = |at: usize| <[u8; 8]>::try_from(content.get(at..at + 8)?).ok();
        match kind {
            1 => Some(Self::Checkpoint(content)),
            2 => Some(Self::Frames {
                first: u64::from_le_bytes(number(0)?),
                time_ns: Some(i64::from_le_bytes(number(8)?)).filter(|time_ns| *time_ns != NO_TIME),
                bytes: content.slice(16..),
            }),
            3 => Some(Self::Gap {
                first: u64::from_le_bytes(number(0)?),
                frames: u64::from_le_bytes(number(8)?),
            }),
            4 => Some(Self::Event(content)),
            _ => None,
        }
    }
}

/// Fills `bytes`; returns whether there were enough.
fn read_whole(reader: &mut impl Read, bytes: &mut [u8]) -> io::Result<bool> {
    match reader.read_exact(bytes) {
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(false),
        read => read.map(|()| true),
    }
}
