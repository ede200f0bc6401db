//! The journal and the levels of a stream, in files or in rows.

use bytes::Bytes;

use super::shared_journal::{RemoteChanges, SharedJournal};
use super::state::{Draft, StreamState};
use crate::service::error::ServiceError;
use crate::store::{StreamJournal, StreamLevels, TimedLevel};

/// The journal of a stream with its levels.
#[derive(Debug)]
pub(super) enum Journal {
    /// Files that only this process uses.
    Folder(StreamJournal, StreamLevels),
    /// Rows that other processes use too.
    Shared(SharedJournal),
}

impl Journal {
    /// Appends the entries of a draft durably, with its levels; returns false if another process has appended
    /// entries since the state `before` them.
    pub(super) fn append(&mut self, before: &StreamState, draft: &Draft) -> Result<bool, ServiceError> {
        let (journal, levels) = match self {
            Self::Folder(journal, levels) => (journal, levels),
            Self::Shared(rows) => return Ok(rows.append(before, draft)?),
        };
        if journal.is_file_full() {
            journal.rotate(before.checkpoint())?;
        }
        journal.append(&draft.entries)?;
        // If this fails, they are computed again from the journal.
        if let Err(error) = levels.append(&draft.levels) {
            tracing::warn!(%error, "failed to write the levels of a stream");
        }
        journal.remove_before(draft.state.needed_from())?;
        Ok(true)
    }

    /// Brings a state up to date with what other processes appended.
    pub(super) fn refresh(&mut self, state: &mut StreamState) -> Result<RemoteChanges, ServiceError> {
        match self {
            Self::Folder(..) => Ok(RemoteChanges::Frames(Vec::new())),
            Self::Shared(rows) => Ok(rows.refresh(state)?),
        }
    }

    /// The bytes of these frames; `None` if some are missing.
    pub(super) fn frames(
        &self,
        first: u64,
        frames: u64,
        frame_bytes: usize,
    ) -> Result<Option<Bytes>, ServiceError> {
        match self {
            Self::Folder(journal, _) => Ok(journal.frames(first, frames)?),
            Self::Shared(rows) => Ok(rows.frames(first, frames, frame_bytes)?),
        }
    }

    /// The levels of the seconds that start from one time to another, in order.
    pub(super) fn levels(
        &self,
        channels: usize,
        from_ns: i64,
        to_ns: i64,
    ) -> Result<Vec<TimedLevel>, ServiceError> {
        match self {
            Self::Folder(_, levels) => Ok(levels.read(from_ns, to_ns)?),
            Self::Shared(rows) => Ok(rows.levels(channels, from_ns, to_ns)?),
        }
    }

    /// Its size in bytes.
    pub(super) fn bytes(&self) -> Result<u64, ServiceError> {
        match self {
            Self::Folder(journal, _) => Ok(journal.bytes()),
            Self::Shared(rows) => Ok(rows.bytes()?),
        }
    }

    /// Acquires or renews the right to store the stream's records; returns false if another process has it.
    /// A process that `takes` it gets it in any case.
    pub(super) fn begin_cutting(&self, takes: bool) -> Result<bool, ServiceError> {
        match self {
            Self::Folder(..) => Ok(true),
            Self::Shared(rows) => Ok(rows.begin_cutting(takes)?),
        }
    }

    /// Releases this right.
    pub(super) fn end_cutting(&self) -> Result<(), ServiceError> {
        match self {
            Self::Folder(..) => Ok(()),
            Self::Shared(rows) => Ok(rows.end_cutting()?),
        }
    }
}
