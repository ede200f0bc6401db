//! The journal of a stream in a shared store, as one process knows it. All methods block.
//!
//! Any process may append. One that has not read the latest entries yet cannot: it reads them first and folds
//! them into its state.

use std::collections::VecDeque;
use std::sync::Arc;

use bytes::Bytes;

use super::location::SharedRows;
use super::state::{Draft, StreamState};
use crate::asset::AssetId;
use crate::store::{JournalEntry, StoreError, StreamAppend, StreamCheckpoint, StreamKey, TimedLevel};

/// Rows and bytes after which a checkpoint is stored: what a process reads at most to continue a stream.
const CHECKPOINT_ROWS: u64 = 128;
const CHECKPOINT_BYTES: usize = 4 << 20;

/// What other processes appended.
#[derive(Debug)]
pub(super) enum RemoteChanges {
    /// Entries with these frames.
    Frames(Vec<(u64, Bytes)>),
    /// So much that the state was read anew.
    Restarted,
    /// The stream is removed.
    Removed,
}

/// A journal in rows.
#[derive(Debug)]
pub(super) struct SharedJournal {
    rows: Arc<SharedRows>,
    asset: AssetId,
    name: String,
    stream: StreamKey,
    /// The number of the last entries in the state, and that of the last known checkpoint.
    last: u64,
    checkpoint: u64,
    /// Bytes of samples since the checkpoint.
    bytes: usize,
    /// The levels completed since the checkpoint, each with the number of the entries that completed it.
    levels: VecDeque<(u64, TimedLevel)>,
}

impl SharedJournal {
    /// Opens a journal; returns it with the state after its last entries, or `None` if there is none.
    pub(super) fn open(
        rows: Arc<SharedRows>,
        asset: &AssetId,
        name: &str,
    ) -> Result<Option<(Self, StreamState)>, StoreError> {
        loop {
            let found = rows.runtime.block_on(rows.store.stream_checkpoint(asset, name))?;
            let Some((stream, checkpoint, state)) = found else { return Ok(None) };
            let mut state: StreamState = serde_json::from_slice(&state)
                .map_err(StoreError::damaged("state", format!("stream {name} of {asset}")))?;
            let mut journal = Self {
                rows: Arc::clone(&rows),
                asset: asset.clone(),
                name: name.to_owned(),
                stream,
                last: checkpoint,
                checkpoint,
                bytes: 0,
                levels: VecDeque::new(),
            };
            if journal.read_new(&mut state)?.is_some() {
                return Ok(Some((journal, state)));
            }
            // Another process has stored a checkpoint in between.
        }
    }

    /// Folds the entries after the last known ones; returns their frames, or `None` if some are removed.
    fn read_new(&mut self, state: &mut StreamState) -> Result<Option<Vec<(u64, Bytes)>>, StoreError> {
        let read = self.rows.store.stream_entries(self.stream, self.last);
        let Some(rows) = self.rows.runtime.block_on(read)? else { return Ok(None) };
        let mut frames = Vec::new();
        for (number, entries) in rows {
            let mut levels = Vec::new();
            for entry in entries {
                state.apply(&entry, &mut levels);
                if let JournalEntry::Frames { first, bytes, .. } = entry {
                    self.bytes += bytes.len();
                    frames.push((first, bytes));
                }
            }
            self.levels.extend(levels.into_iter().map(|level| (number, level)));
            self.last = number;
        }
        Ok(Some(frames))
    }

    /// Brings a state up to date.
    pub(super) fn refresh(&mut self, state: &mut StreamState) -> Result<RemoteChanges, StoreError> {
        let version = self.rows.runtime.block_on(self.rows.store.stream_version(self.stream))?;
        let Some(version) = version else { return Ok(RemoteChanges::Removed) };
        if version.checkpoint > self.checkpoint && version.checkpoint <= self.last {
            self.set_checkpoint(version.checkpoint);
        }
        if version.last <= self.last {
            return Ok(RemoteChanges::Frames(Vec::new()));
        }
        if version.checkpoint <= self.last
            && let Some(frames) = self.read_new(state)?
        {
            return Ok(RemoteChanges::Frames(frames));
        }
        match Self::open(Arc::clone(&self.rows), &self.asset, &self.name)? {
            Some((journal, read)) if journal.stream == self.stream => {
                (*self, *state) = (journal, read);
                Ok(RemoteChanges::Restarted)
            }
            _ => Ok(RemoteChanges::Removed),
        }
    }

    /// Appends the entries of a draft; returns false if other entries follow those that led to `before`.
    pub(super) fn append(&mut self, before: &StreamState, draft: &Draft) -> Result<bool, StoreError> {
        let number = self.last + 1;
        let append = StreamAppend {
            number,
            first: before.next.unwrap_or(0),
            end: draft.state.next.unwrap_or(0),
            pending: draft.state.pending.len(),
            entries: &draft.entries,
        };
        if !self.rows.runtime.block_on(self.rows.store.append_to_stream(self.stream, &append))? {
            return Ok(false);
        }
        self.last = number;
        self.levels.extend(draft.levels.iter().map(|level| (number, level.clone())));
        let frames = draft.entries.iter().map(|entry| match entry {
            JournalEntry::Frames { bytes, .. } => bytes.len(),
            _ => 0,
        });
        self.bytes += frames.sum::<usize>();
        if self.last - self.checkpoint >= CHECKPOINT_ROWS || self.bytes >= CHECKPOINT_BYTES {
            // What is appended is durable in any case; the next append tries again.
            if let Err(error) = self.store_checkpoint(&draft.state) {
                tracing::warn!(asset = %self.asset, name = self.name, %error, "failed to store a checkpoint of a stream");
            }
        }
        Ok(true)
    }

    fn store_checkpoint(&mut self, state: &StreamState) -> Result<(), StoreError> {
        let levels: Vec<TimedLevel> = self.levels.iter().map(|(_, level)| level.clone()).collect();
        let checkpoint = StreamCheckpoint {
            previous: self.checkpoint,
            number: self.last,
            state: state.checkpoint(),
            levels: &levels,
            needed_from: state.needed_from(),
        };
        let SharedRows { store, runtime, .. } = &*self.rows;
        if runtime.block_on(store.store_stream_checkpoint(self.stream, &checkpoint))? {
            self.set_checkpoint(self.last);
        } else if let Some(version) = runtime.block_on(store.stream_version(self.stream))? {
            // Another process has stored one.
            self.set_checkpoint(version.checkpoint.min(self.last));
        }
        Ok(())
    }

    fn set_checkpoint(&mut self, number: u64) {
        self.checkpoint = number;
        self.bytes = 0;
        while self.levels.front().is_some_and(|(completed_by, _)| *completed_by <= number) {
            self.levels.pop_front();
        }
    }

    pub(super) fn frames(
        &self,
        first: u64,
        frames: u64,
        frame_bytes: usize,
    ) -> Result<Option<Bytes>, StoreError> {
        let read = self.rows.store.stream_frames(self.stream, first, frames, frame_bytes);
        self.rows.runtime.block_on(read)
    }

    /// The stored levels, and those since the checkpoint.
    pub(super) fn levels(
        &self,
        channels: usize,
        from_ns: i64,
        to_ns: i64,
    ) -> Result<Vec<TimedLevel>, StoreError> {
        let read = self.rows.store.stream_levels(self.stream, channels, from_ns, to_ns);
        let mut levels = self.rows.runtime.block_on(read)?;
        let stored_to = levels.last().map(|level| level.level.first);
        let is_wanted = |level: &&TimedLevel| {
            (from_ns..=to_ns).contains(&level.time_ns)
                && stored_to.is_none_or(|stored| level.level.first > stored)
        };
        levels.extend(self.levels.iter().map(|(_, level)| level).filter(is_wanted).cloned());
        Ok(levels)
    }

    pub(super) fn bytes(&self) -> Result<u64, StoreError> {
        self.rows.runtime.block_on(self.rows.store.stream_bytes(self.stream))
    }

    pub(super) fn begin_cutting(&self, takes: bool) -> Result<bool, StoreError> {
        let SharedRows { store, runtime, clock, process } = &*self.rows;
        runtime.block_on(store.begin_cutting(self.stream, *process, takes, clock.now()))
    }

    pub(super) fn end_cutting(&self) -> Result<(), StoreError> {
        let SharedRows { store, runtime, process, .. } = &*self.rows;
        runtime.block_on(store.end_cutting(*process, Some(self.stream)))
    }
}
