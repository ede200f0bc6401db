//! A stream that is open for sending and has no sample yet.

use jiff::Timestamp;

use super::stored::REORDER_S;
use crate::recording::stream::{Assembler, StreamFormat};

/// A stream that is created with its first sample.
#[derive(Debug, Clone)]
pub(crate) struct NewStream {
    /// When its asset was created.
    pub(crate) asset_created_at: Timestamp,
    pub(crate) format: StreamFormat,
    /// Its first index; by default that of the first chunk.
    pub(crate) first: Option<u64>,
}

impl NewStream {
    /// Where the first chunks are put in order.
    pub(crate) fn assembler(&self) -> Assembler {
        Assembler::new(&self.format, self.first, self.format.frames_in(REORDER_S))
    }
}
