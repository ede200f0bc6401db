//! Live streams: in a journal of files, or in rows of a shared store.

pub(super) mod copies;
pub(super) mod entry;
pub(super) mod journal;
pub(super) mod levels;
pub(super) mod rows;
