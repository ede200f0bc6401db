//! One stream on the disk or in rows: its journal, its state, and its pending records.

#[cfg(test)]
mod pulse_tests;
#[cfg(test)]
mod tests;

use std::path::Path;
use std::sync::Arc;

use bytes::Bytes;
use jiff::Timestamp;

use super::cutting::Cutting;
use super::journal::Journal;
use super::location::StreamLocation;
use super::recent::Recent;
use super::shared_journal::{RemoteChanges, SharedJournal};
use super::state::{Draft, JournalEvent, PendingCut, StreamState};
use super::tachometer::Pulses;
use crate::recording::RecordingError;
use crate::recording::stream::{Assembler, Chunk, Piece, StreamCut, StreamFormat};
use crate::service::error::ServiceError;
use crate::signal::OperatingPoint;
use crate::store::{Disk, JournalEntry, StreamJournal, StreamLevels, TimedLevel};

/// Seconds by which chunks may arrive ahead of earlier ones.
pub(super) const REORDER_S: f64 = 2.0;

/// Maximum number of bytes of samples in one entry of the journal, which are read back up to 9 MiB.
const ENTRY_BYTES: usize = 4 << 20;

/// Missing samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, utoipa::ToSchema)]
#[schema(as = GapView)]
pub struct StreamGap {
    /// Index of the first missing sample.
    pub first: u64,
    /// Number of missing samples per channel.
    pub samples: u64,
}

/// The result of sending samples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StreamProgress {
    /// Index of the next expected sample: all earlier ones are stored or known to be missing.
    pub next: Option<u64>,
    /// Gaps that were detected.
    pub gaps: Vec<StreamGap>,
}

/// Who changes a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Author {
    /// The connection that sends it, which another one may replace.
    Sender,
    /// Anyone else.
    Other,
}

/// A stream that is open for writing.
#[derive(Debug)]
pub(crate) struct StoredStream {
    journal: Journal,
    assembler: Assembler,
    state: StreamState,
    /// The latest samples, while there are viewers.
    recent: Option<Recent>,
}

impl StoredStream {
    /// Creates a stream that starts at the index `next`, or at that of the first chunk.
    ///
    /// # Errors
    /// Its asset is deleted, or has too many streams.
    pub(crate) fn create(
        location: &StreamLocation,
        asset_created_at: Timestamp,
        format: StreamFormat,
        next: Option<u64>,
    ) -> Result<Self, ServiceError> {
        let state = StreamState::new(asset_created_at, format, next);
        match location {
            StreamLocation::Folder { disk, folder } => {
                let levels = StreamLevels::open(folder, state.format.channels())?;
                Self::in_folder(disk, folder, levels, state)
            }
            StreamLocation::Shared { rows, asset, name } => {
                rows.create(asset, name, &state)?;
                let unknown = || ServiceError::StreamUnknown { asset: asset.clone(), name: name.clone() };
                Self::open(location)?.ok_or_else(unknown)
            }
        }
    }

    /// Opens the stream of a location, also after a crash; returns `None` if there is none.
    pub(crate) fn open(location: &StreamLocation) -> Result<Option<Self>, ServiceError> {
        let (disk, folder) = match location {
            StreamLocation::Folder { disk, folder } => (disk, folder),
            StreamLocation::Shared { rows, asset, name } => {
                let found = SharedJournal::open(Arc::clone(rows), asset, name)?;
                return Ok(found.map(|(journal, state)| Self::of(Journal::Shared(journal), state)));
            }
        };
        let mut state: Option<StreamState> = None;
        let mut levels = Vec::new();
        StreamJournal::replay(&**disk, folder, |entry| match (&mut state, &entry) {
            (Some(state), entry) => state.apply(entry, &mut levels),
            (None, JournalEntry::Checkpoint(text)) => state = serde_json::from_slice(text).ok(),
            (None, _) => {}
        })?;
        let Some(state) = state else { return Ok(None) };
        let mut stored = StreamLevels::open(folder, state.format.channels())?;
        stored.append(&levels)?;
        Self::in_folder(disk, folder, stored, state).map(Some)
    }

    fn in_folder(
        disk: &Arc<dyn Disk>,
        folder: &Path,
        levels: StreamLevels,
        state: StreamState,
    ) -> Result<Self, ServiceError> {
        let frame_bytes = state.format.frame_bytes();
        let mut journal = StreamJournal::open(Arc::clone(disk), folder, frame_bytes, state.checkpoint())?;
        journal.remove_before(state.needed_from())?;
        Ok(Self::of(Journal::Folder(journal, levels), state))
    }

    fn of(journal: Journal, state: StreamState) -> Self {
        Self { journal, assembler: assembler(&state), state, recent: None }
    }

    /// The chunks that wait for earlier ones.
    pub(crate) fn into_assembler(self) -> Assembler {
        self.assembler
    }

    /// Continues with the chunks that waited before the stream was read again, unless they were partly taken.
    pub(crate) fn continue_with(&mut self, assembler: Assembler) {
        if assembler.next() == self.state.next {
            self.assembler = assembler;
        }
    }

    /// Whether the time of its samples is known.
    pub(crate) fn is_timed(&self) -> bool {
        self.state.clock.time_ns(0).is_some()
    }

    pub(crate) fn state(&self) -> &StreamState {
        &self.state
    }

    pub(crate) fn journal_bytes(&self) -> Result<u64, ServiceError> {
        self.journal.bytes()
    }

    /// Brings the state up to date with what other processes appended; returns false if the stream is
    /// removed.
    pub(crate) fn refresh(&mut self) -> Result<bool, ServiceError> {
        match self.journal.refresh(&mut self.state)? {
            RemoteChanges::Removed => return Ok(false),
            RemoteChanges::Restarted => self.recent = None,
            RemoteChanges::Frames(frames) => {
                if let Some(recent) = &mut self.recent {
                    frames.iter().for_each(|(first, bytes)| recent.push(*first, bytes));
                }
            }
        }
        Ok(true)
    }

    /// Makes another connection the sender, whose chunks start at the next index.
    pub(crate) fn begin_sending(&mut self, sender: u64) -> Result<(), ServiceError> {
        self.change(Author::Other, |draft| draft.add_event(&JournalEvent::Sender(sender)))?;
        // This process stores the records from now on.
        self.journal.begin_cutting(true)?;
        Ok(())
    }

    /// Acquires or renews the right to store the pending records; returns false if another process has it.
    pub(crate) fn begin_cutting(&self) -> Result<bool, ServiceError> {
        self.journal.begin_cutting(false)
    }

    /// Releases this right.
    pub(crate) fn end_cutting(&self) -> Result<(), ServiceError> {
        self.journal.end_cutting()
    }

    /// Drops chunks that wait for earlier samples: a new sender starts at the next index.
    pub(crate) fn drop_waiting_chunks(&mut self) {
        if self.state.next.is_some() && self.assembler.next() != self.state.next {
            // Another process has received samples in the meantime.
            self.assembler = assembler(&self.state);
        } else {
            self.assembler.discard_pending();
        }
    }

    /// Stores chunks durably. If one is invalid, those before it are stored.
    pub(crate) fn take(
        &mut self,
        chunks: Vec<Chunk>,
        cutting: &Cutting,
    ) -> Result<StreamProgress, ServiceError> {
        let mut pieces = Vec::new();
        let mut fault: Option<RecordingError> = None;
        for chunk in chunks {
            match self.assembler.push(chunk) {
                Ok(more) => pieces.extend(more),
                Err(error) => {
                    fault = Some(error);
                    break;
                }
            }
        }
        let progress = self.write(&pieces, cutting)?;
        fault.map_or(Ok(progress), |fault| Err(fault.into()))
    }

    /// Declares that no more samples before an index will arrive.
    pub(crate) fn declare_lost_before(
        &mut self,
        index: u64,
        cutting: &Cutting,
    ) -> Result<StreamProgress, ServiceError> {
        let pieces = self.assembler.declare_lost_before(index)?;
        self.write(&pieces, cutting)
    }

    /// Sets the operating point of the machine from now on.
    pub(crate) fn set_operating_point(
        &mut self,
        point: OperatingPoint,
        cutting: &Cutting,
    ) -> Result<(), ServiceError> {
        self.change(Author::Sender, |draft| {
            let is_steady = cutting.is_steady(&draft.state, &point);
            draft.add_event(&if is_steady {
                JournalEvent::OperatingPoint(point)
            } else {
                JournalEvent::Moved(point)
            });
        })
    }

    /// Stores tachometer pulses among future samples.
    ///
    /// # Errors
    /// A channel of the stream is its tachometer.
    pub(crate) fn take_pulses(&mut self, pulses: Pulses) -> Result<(), ServiceError> {
        if self.state.format.tachometer().is_some() {
            let expected = "no pulses: a channel of the stream is its tachometer".into();
            return Err(ServiceError::Field { field: "tachometer", value: "given".to_owned(), expected });
        }
        let pulses = pulses.beginning_at(self.state.next.unwrap_or(0));
        if pulses.is_empty() {
            return Ok(());
        }
        let event = JournalEvent::Pulses(pulses);
        self.change(Author::Sender, |draft| draft.add_event(&event))
    }

    /// Plans a record of the last `frames` frames, or of fewer if there is a gap; returns `None` without
    /// samples.
    pub(crate) fn keep_last(&mut self, frames: u64) -> Result<Option<PendingCut>, ServiceError> {
        self.change(Author::Other, |draft| {
            let end = draft.state.cutter.end();
            let first = end.saturating_sub(frames).max(draft.state.cutter.run_first());
            if first >= end {
                return None;
            }
            // This record does not affect the cut policy.
            draft.cut(StreamCut { first, frames: end - first, next_from: 0 });
            draft.state.pending.back().cloned()
        })
    }

    /// Starts a capture around an alarm that is raised now; returns false if there is nothing to capture, or
    /// if another process has done so.
    pub(crate) fn capture_around_alarm(
        &mut self,
        alarm: &str,
        cutting: &Cutting,
    ) -> Result<bool, ServiceError> {
        self.change(Author::Other, |draft| {
            if draft.state.is_captured(alarm) {
                return false;
            }
            let Some(capture) = draft.state.around_alarm(cutting) else { return false };
            draft.add_event(&JournalEvent::Alarm(alarm.to_owned()));
            draft.add_event(&JournalEvent::Capture(capture));
            draft.cut_whole(cutting);
            true
        })
    }

    /// Starts a campaign of `frames` frames from now on, or extends the running one; returns false before the
    /// first sample.
    pub(crate) fn begin_campaign(&mut self, frames: u64, cutting: &Cutting) -> Result<bool, ServiceError> {
        self.change(Author::Other, |draft| {
            let Some((capture, campaign)) = draft.state.campaign_of(frames, cutting) else { return false };
            draft.add_event(&JournalEvent::Campaign(capture, campaign));
            draft.cut_whole(cutting);
            true
        })
    }

    /// Ends the running campaign; its last record ends with the last sample received, or with the last one
    /// for an alarm.
    pub(crate) fn end_campaign(&mut self, cutting: &Cutting) -> Result<(), ServiceError> {
        self.change(Author::Other, |draft| {
            if !draft.state.capture.is_some_and(|capture| capture.is_campaign) {
                return;
            }
            match draft.state.campaign_of(0, cutting) {
                Some((capture, campaign)) if draft.state.next < Some(capture.until) => {
                    draft.add_event(&JournalEvent::Campaign(capture, campaign));
                }
                _ => {
                    draft.cut_rest(cutting);
                    draft.add_event(&JournalEvent::CaptureEnd);
                }
            }
        })
    }

    /// Marks a pending record as stored, or as refused for a reason, unless another process has.
    pub(crate) fn finish_record(
        &mut self,
        pending: &PendingCut,
        refusal: Option<String>,
    ) -> Result<(), ServiceError> {
        let event = JournalEvent::Done { first: pending.cut.first, is_refused: refusal.is_some(), refusal };
        self.change(Author::Other, |draft| {
            if draft.state.pending.contains(pending) {
                draft.add_event(&event);
            }
        })
    }

    /// Plans the records that were complete when the previous process ended.
    pub(crate) fn plan_records(&mut self, cutting: &Cutting) -> Result<(), ServiceError> {
        self.write(&[], cutting).map(|_| ())
    }

    /// The bytes of a record and of the `lead` frames before it; `None` if any are missing.
    pub(crate) fn bytes_of(&self, cut: StreamCut, lead: u64) -> Result<Option<Bytes>, ServiceError> {
        let first = cut.first.saturating_sub(lead);
        self.journal.frames(first, cut.frames + lead, self.state.format.frame_bytes())
    }

    /// The last contiguous frames, at most `max_frames`, with the index of the first. They stay in memory
    /// from then on.
    pub(crate) fn recent(&mut self, max_frames: u64) -> Result<(u64, Bytes), ServiceError> {
        if let Some(recent) = &self.recent {
            return Ok(recent.frames());
        }
        let end = self.state.next.unwrap_or(0);
        let first = end.saturating_sub(max_frames).max(self.state.cutter.run_first()).min(end);
        let frame_bytes = self.state.format.frame_bytes();
        let mut recent = Recent::new(frame_bytes, max_frames);
        if first < end {
            // Those of a stream restored from a backup may be missing.
            let frames = self.journal.frames(first, end - first, frame_bytes)?;
            recent.push(first, &frames.unwrap_or_default());
        }
        Ok(self.recent.insert(recent).frames())
    }

    /// Releases the samples in memory.
    pub(crate) fn forget_recent(&mut self) {
        self.recent = None;
    }

    /// The levels of each second from one time to another.
    pub(crate) fn levels(&self, from_ns: i64, to_ns: i64) -> Result<Vec<TimedLevel>, ServiceError> {
        self.journal.levels(self.state.format.channels(), from_ns, to_ns)
    }

    fn write(&mut self, pieces: &[Piece], cutting: &Cutting) -> Result<StreamProgress, ServiceError> {
        let frame_bytes = self.state.format.frame_bytes();
        let gaps = self.change(Author::Sender, |draft| {
            let mut gaps = Vec::new();
            for piece in pieces {
                match piece.clone() {
                    Piece::Gap { first, frames } => {
                        draft.cut_rest(cutting);
                        draft.add(JournalEntry::Gap { first, frames });
                        gaps.push(StreamGap { first, samples: frames });
                    }
                    Piece::Frames(chunk) => {
                        for Chunk { first, time_ns, bytes } in parts(chunk, frame_bytes) {
                            draft.add(JournalEntry::Frames { first, time_ns, bytes });
                            draft.cut_whole(cutting);
                        }
                    }
                }
            }
            draft.cut_whole(cutting);
            gaps
        })?;
        Ok(StreamProgress { next: self.state.next, gaps })
    }

    /// Appends what `make` adds to a draft of the current state. If another process has appended entries, it
    /// is made again from the state after them.
    ///
    /// # Errors
    /// The author is a sender and has been replaced; the stream is removed.
    fn change<T>(&mut self, author: Author, make: impl Fn(&mut Draft) -> T) -> Result<T, ServiceError> {
        loop {
            let mut draft = Draft::new(self.state.clone());
            let made = make(&mut draft);
            if matches!(self.journal, Journal::Shared(_)) {
                draft.add_skipped();
            }
            if draft.entries.is_empty() {
                return Ok(made);
            }
            if self.journal.append(&self.state, &draft)? {
                self.take_draft(draft);
                return Ok(made);
            }
            let sender = self.state.sender;
            let is_replaced = |state: &StreamState| author == Author::Sender && state.sender != sender;
            if !self.refresh()? || is_replaced(&self.state) {
                return Err(ServiceError::StreamTaken);
            }
        }
    }

    /// Takes the state of a draft whose entries are stored.
    fn take_draft(&mut self, draft: Draft) {
        self.state = draft.state;
        if let Some(recent) = &mut self.recent {
            for entry in &draft.entries {
                if let JournalEntry::Frames { first, bytes, .. } = entry {
                    recent.push(*first, bytes);
                }
            }
        }
    }
}

/// The parts of a chunk, each of which fits into an entry of the journal. The first one has the time.
fn parts(chunk: Chunk, frame_bytes: usize) -> impl Iterator<Item = Chunk> {
    let step = (ENTRY_BYTES / frame_bytes).max(1) * frame_bytes;
    (0..chunk.bytes.len()).step_by(step).map(move |at| Chunk {
        first: chunk.first + (at / frame_bytes) as u64,
        time_ns: chunk.time_ns.filter(|_| at == 0),
        bytes: chunk.bytes.slice(at..chunk.bytes.len().min(at + step)),
    })
}

fn assembler(state: &StreamState) -> Assembler {
    Assembler::new(&state.format, state.next, state.format.frames_in(REORDER_S))
}
