//! One stream on the disk: its journal, its state, and its pending records.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::Bytes;
use jiff::Timestamp;

use super::cutting::Cutting;
use super::recent::Recent;
use super::state::{Draft, Note, PendingCut, StreamState};
use super::tachometer::Pulses;
use crate::recording::RecordingError;
use crate::recording::stream::{Assembler, Chunk, Piece, StreamCut, StreamFormat};
use crate::service::error::ServiceError;
use crate::signal::OperatingPoint;
use crate::store::{Disk, JournalEntry, StoreError, StreamJournal, StreamLevels, TimedLevel};

/// Seconds by which chunks may arrive ahead of earlier ones.
const REORDER_S: f64 = 2.0;

/// A range of missing samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamGap {
    /// Index of the first missing sample.
    pub first: u64,
    /// Number of missing samples.
    pub samples: u64,
}

/// The progress of a stream after chunks are stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StreamProgress {
    /// Everything before this index is durable or a known gap; `None` before the first sample.
    pub next: Option<u64>,
    /// The new gaps.
    pub gaps: Vec<StreamGap>,
}

/// A stream that is open for writing.
#[derive(Debug)]
pub(crate) struct StoredStream {
    journal: StreamJournal,
    levels: StreamLevels,
    assembler: Assembler,
    state: StreamState,
    /// The latest samples, while there are viewers.
    recent: Option<Recent>,
}

impl StoredStream {
    /// Creates a stream that starts at the index `next`, or at that of the first chunk.
    pub(crate) fn create(
        disk: Arc<dyn Disk>,
        folder: &Path,
        asset_created_at: Timestamp,
        format: StreamFormat,
        next: Option<u64>,
    ) -> Result<Self, ServiceError> {
        Self::with_state(disk, folder, StreamState::new(asset_created_at, format, next))
    }

    /// Opens the stream in a folder, also after a crash; returns `None` if there is none.
    pub(crate) fn open(disk: Arc<dyn Disk>, folder: &Path) -> Result<Option<Self>, ServiceError> {
        let mut state: Option<StreamState> = None;
        let mut levels = Vec::new();
        StreamJournal::replay(&*disk, folder, |entry| match (&mut state, &entry) {
            (Some(state), entry) => state.apply(entry, &mut levels),
            (None, JournalEntry::Checkpoint(text)) => state = serde_json::from_slice(text).ok(),
            (None, _) => {}
        })?;
        let Some(state) = state else { return Ok(None) };
        let mut stream = Self::with_state(disk, folder, state)?;
        stream.levels.append(&levels)?;
        stream.journal.remove_before(stream.state.needed_from())?;
        Ok(Some(stream))
    }

    fn with_state(disk: Arc<dyn Disk>, folder: &Path, state: StreamState) -> Result<Self, ServiceError> {
        let format = &state.format;
        Ok(Self {
            journal: StreamJournal::open(disk, folder, format.frame_bytes(), state.checkpoint())?,
            levels: StreamLevels::open(folder, format.channels())?,
            assembler: Assembler::new(format, state.next, format.frames_in(REORDER_S)),
            state,
            recent: None,
        })
    }

    pub(crate) fn state(&self) -> &StreamState {
        &self.state
    }

    pub(crate) fn journal_bytes(&self) -> u64 {
        self.journal.bytes()
    }

    /// Drops chunks that wait for earlier samples: a new sender starts at the next index.
    pub(crate) fn drop_waiting_chunks(&mut self) {
        self.assembler.discard_pending();
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
        let progress = self.write(pieces, cutting)?;
        fault.map_or(Ok(progress), |fault| Err(fault.into()))
    }

    /// Declares that no more samples before an index will arrive.
    pub(crate) fn give_up_before(
        &mut self,
        index: u64,
        cutting: &Cutting,
    ) -> Result<StreamProgress, ServiceError> {
        let pieces = self.assembler.declare_lost_before(index)?;
        self.write(pieces, cutting)
    }

    /// Sets the operating point of the machine from now on.
    pub(crate) fn set_operating_point(
        &mut self,
        point: OperatingPoint,
        cutting: &Cutting,
    ) -> Result<(), ServiceError> {
        let mut draft = self.draft()?;
        let is_steady = cutting.is_steady(&draft.state, &point);
        draft.note(&if is_steady { Note::OperatingPoint(point) } else { Note::Moved(point) });
        self.persist(draft)
    }

    /// Stores tachometer pulses among future samples.
    pub(crate) fn take_pulses(&mut self, pulses: Pulses) -> Result<(), ServiceError> {
        let pulses = pulses.beginning_at(self.state.next.unwrap_or(0));
        if pulses.is_empty() {
            return Ok(());
        }
        let mut draft = self.draft()?;
        draft.note(&Note::Pulses(pulses));
        self.persist(draft)
    }

    /// Plans a record of the last `frames` frames, or of fewer if there is a gap; returns `None` without
    /// samples.
    pub(crate) fn keep_last(&mut self, frames: u64) -> Result<Option<PendingCut>, ServiceError> {
        let end = self.state.cutter.end();
        let first = end.saturating_sub(frames).max(self.state.cutter.run_first());
        if first >= end {
            return Ok(None);
        }
        let mut draft = self.draft()?;
        // This record does not affect the cut policy.
        draft.cut(StreamCut { first, frames: end - first, next_from: 0 });
        self.persist(draft)?;
        Ok(self.state.pending.back().cloned())
    }

    /// Starts a capture around an alarm that is raised now; returns false if there is nothing to capture.
    pub(crate) fn capture_around_alarm(&mut self, cutting: &Cutting) -> Result<bool, ServiceError> {
        let Some(capture) = self.state.around_alarm(cutting) else { return Ok(false) };
        self.begin_capture(&Note::Capture(capture), cutting).map(|()| true)
    }

    /// Starts a campaign of `frames` frames from now on, or extends the running one; returns false before the
    /// first sample.
    pub(crate) fn begin_campaign(&mut self, frames: u64, cutting: &Cutting) -> Result<bool, ServiceError> {
        let Some((capture, campaign)) = self.state.campaign_of(frames, cutting) else { return Ok(false) };
        self.begin_capture(&Note::Campaign(capture, campaign), cutting).map(|()| true)
    }

    fn begin_capture(&mut self, note: &Note, cutting: &Cutting) -> Result<(), ServiceError> {
        let mut draft = self.draft()?;
        draft.note(note);
        draft.cut_whole(cutting);
        self.persist(draft)
    }

    /// Ends the running campaign; its last record ends with the last sample received.
    pub(crate) fn end_campaign(&mut self, cutting: &Cutting) -> Result<(), ServiceError> {
        if !self.state.capture.is_some_and(|capture| capture.is_campaign) {
            return Ok(());
        }
        let mut draft = self.draft()?;
        draft.cut_rest(cutting);
        draft.note(&Note::CaptureEnd);
        self.persist(draft)
    }

    /// Marks a pending record as stored or refused.
    pub(crate) fn finish_record(&mut self, first: u64, is_refused: bool) -> Result<(), ServiceError> {
        let mut draft = self.draft()?;
        draft.note(&Note::Done { first, is_refused });
        self.persist(draft)
    }

    /// Plans the records that were complete when the previous process ended.
    pub(crate) fn plan_records(&mut self, cutting: &Cutting) -> Result<(), ServiceError> {
        self.write(Vec::new(), cutting).map(|_| ())
    }

    /// The bytes of a record; `None` if they are missing.
    pub(crate) fn bytes_of(&self, cut: StreamCut) -> Result<Option<Bytes>, ServiceError> {
        Ok(self.journal.frames(cut.first, cut.frames)?)
    }

    /// The last contiguous frames, at most `most`, with the index of the first. They stay in memory from then
    /// on.
    pub(crate) fn recent(&mut self, most: u64) -> Result<(u64, Bytes), ServiceError> {
        if let Some(recent) = &self.recent {
            return Ok(recent.frames());
        }
        let end = self.state.next.unwrap_or(0);
        let first = end.saturating_sub(most).max(self.state.cutter.run_first()).min(end);
        let mut recent = Recent::new(self.state.format.frame_bytes(), most);
        if first < end {
            // Those of a stream restored from a backup may be missing.
            recent.push(first, &self.journal.frames(first, end - first)?.unwrap_or_default());
        }
        Ok(self.recent.insert(recent).frames())
    }

    /// Releases the samples in memory.
    pub(crate) fn forget_recent(&mut self) {
        self.recent = None;
    }

    /// The levels of each second from one time to another.
    pub(crate) fn levels(&self, from_ns: i64, to_ns: i64) -> Result<Vec<TimedLevel>, ServiceError> {
        Ok(self.levels.read(from_ns, to_ns)?)
    }

    fn write(&mut self, pieces: Vec<Piece>, cutting: &Cutting) -> Result<StreamProgress, ServiceError> {
        let mut draft = self.draft()?;
        let mut gaps = Vec::new();
        for piece in pieces {
            match piece {
                Piece::Gap { first, frames } => {
                    draft.cut_rest(cutting);
                    draft.add(JournalEntry::Gap { first, frames });
                    gaps.push(StreamGap { first, samples: frames });
                }
                Piece::Frames(Chunk { first, time_ns, bytes }) => {
                    draft.add(JournalEntry::Frames { first, time_ns, bytes });
                    draft.cut_whole(cutting);
                }
            }
        }
        draft.cut_whole(cutting);
        self.persist(draft)?;
        Ok(StreamProgress { next: self.state.next, gaps })
    }

    /// Starts a draft from the current state; first starts a new journal file if the last one is full.
    fn draft(&mut self) -> Result<Draft, StoreError> {
        if self.journal.is_file_full() {
            self.journal.rotate(self.state.checkpoint())?;
        }
        Ok(Draft::new(self.state.clone()))
    }

    fn persist(&mut self, draft: Draft) -> Result<(), ServiceError> {
        if draft.entries.is_empty() {
            return Ok(());
        }
        self.journal.append(&draft.entries)?;
        self.state = draft.state;
        if let Some(recent) = &mut self.recent {
            for entry in &draft.entries {
                if let JournalEntry::Frames { first, bytes, .. } = entry {
                    recent.push(*first, bytes);
                }
            }
        }
        // If this fails, they are computed again from the journal.
        if let Err(error) = self.levels.append(&draft.levels) {
            tracing::warn!(%error, "failed to write the levels of a stream");
        }
        Ok(self.journal.remove_before(self.state.needed_from())?)
    }
}

/// The folder of a stream.
pub(crate) fn folder_of(streams: &Path, asset: &str, name: &str) -> PathBuf {
    streams.join(asset).join(name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::RawSample;
    use crate::recording::stream::CutPolicy;
    use crate::store::SystemDisk;

    const RATE_HZ: f64 = 100.0;

    fn format() -> StreamFormat {
        StreamFormat::new(RawSample::I16, RATE_HZ, 1, None).unwrap()
    }

    fn policy() -> Cutting {
        CutPolicy::new(2.0, 10.0, RATE_HZ).unwrap().into()
    }

    fn chunk(first: u64, frames: u64) -> Chunk {
        let bytes = (first..first + frames).flat_map(|k| (k as i16).to_le_bytes()).collect();
        Chunk { first, time_ns: Some(1_760_000_000_000_000_000 + first as i64 * 10_000_000), bytes }
    }

    fn stream(folder: &Path) -> StoredStream {
        StoredStream::create(Arc::new(SystemDisk), folder, Timestamp::UNIX_EPOCH, format(), Some(0)).unwrap()
    }

    #[test]
    fn a_killed_stream_resumes_with_the_same_records() {
        let chunks: Vec<Chunk> = (0..60).filter(|k| *k != 22).map(|k| chunk(k * 50, 50)).collect();
        let folder = tempfile::tempdir().unwrap();
        let mut whole = stream(folder.path());
        for chunk in &chunks {
            whole.take(vec![chunk.clone()], &policy()).unwrap();
        }
        let firsts: Vec<u64> = whole.state.pending.iter().map(|pending| pending.cut.first).collect();
        assert_eq!(firsts, [0, 1150, 2000]);
        assert_eq!((whole.state.gaps, whole.state.gap_samples, whole.state.next), (1, 50, Some(3000)));
        let levels = whole.levels(i64::MIN, i64::MAX).unwrap();
        assert_eq!((levels.len(), levels[11].level.frames), (30, 50));

        let folder = tempfile::tempdir().unwrap();
        let mut killed = stream(folder.path());
        for (n, chunk) in chunks.iter().enumerate() {
            killed.take(vec![chunk.clone()], &policy()).unwrap();
            drop(killed);
            if n % 3 == 0 {
                // An entry that was being written.
                let newest = std::fs::read_dir(folder.path()).unwrap().flatten().map(|entry| entry.path());
                let newest = newest.filter(|path| path.extension().is_some()).max().unwrap();
                let mut bytes = std::fs::read(&newest).unwrap();
                bytes.extend_from_slice(&[120, 0, 0, 0, 1, 2, 3, 4, 2, 9]);
                std::fs::write(&newest, bytes).unwrap();
            }
            killed = StoredStream::open(Arc::new(SystemDisk), folder.path()).unwrap().unwrap();
            // Chunks that waited for earlier ones are sent again.
            let next = killed.state.next.unwrap_or(0);
            let again: Vec<Chunk> =
                chunks[..=n].iter().filter(|chunk| chunk.first >= next).cloned().collect();
            killed.take(again, &policy()).unwrap();
        }
        assert_eq!(killed.state.pending, whole.state.pending);
        assert_eq!(killed.levels(i64::MIN, i64::MAX).unwrap(), levels);
        for pending in &whole.state.pending {
            let bytes = killed.bytes_of(pending.cut).unwrap().unwrap();
            assert_eq!(bytes, chunk(pending.cut.first, pending.cut.frames).bytes);
        }
    }

    #[test]
    fn only_samples_needed_by_records_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let format = StreamFormat::new(RawSample::F32, 10_000.0, 4, None).unwrap();
        let policy = Cutting::from(CutPolicy::new(1.0, 30.0, 10_000.0).unwrap());
        let mut stream =
            StoredStream::create(Arc::new(SystemDisk), folder.path(), Timestamp::UNIX_EPOCH, format, Some(0))
                .unwrap();
        let second = |k: u64| Chunk {
            first: k * 10_000,
            time_ns: Some(k as i64 * 1_000_000_000),
            bytes: vec![k as u8; 160_000].into(),
        };
        let mut most = 0;
        for k in 0..300 {
            stream.take(vec![second(k)], &policy).unwrap();
            if k >= 60 {
                while let Some(pending) = stream.state.pending.front().cloned() {
                    assert!(stream.bytes_of(pending.cut).unwrap().is_some());
                    stream.finish_record(pending.cut.first, false).unwrap();
                }
                most = most.max(stream.journal_bytes());
            }
        }
        assert_eq!((stream.state.records, stream.state.pending.len()), (10, 0));
        // A minute is 9.6 MB; files are removed as a whole.
        assert!(most < 20 << 20, "{most}");
        let kept = stream.keep_last(5 * 10_000).unwrap().unwrap();
        assert_eq!((kept.cut.first, kept.cut.frames), (295 * 10_000, 50_000));
    }
}
