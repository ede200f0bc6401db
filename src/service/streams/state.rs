//! What follows from the entries of a stream's journal.

use std::collections::VecDeque;

use bytes::Bytes;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::cutting::{Cutting, Decision};
use super::steadiness::Steadiness;
use crate::recording::stream::{LevelMeter, StreamClock, StreamCut, StreamCutter, StreamFormat};
use crate::signal::OperatingPoint;
use crate::store::{JournalEntry, TimedLevel};

/// Seconds of samples that stay in the journal when records are cut, and the most bytes of them.
const KEPT_S: f64 = 60.0;
const MAX_KEPT_BYTES: u64 = 256 << 20;

/// What follows from everything that came so far.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct StreamState {
    /// Tells an asset from a later one of the same name.
    pub(crate) asset_created_at: Timestamp,
    pub(crate) format: StreamFormat,
    pub(crate) next: Option<u64>,
    pub(crate) clock: StreamClock,
    pub(crate) pending: VecDeque<PendingCut>,
    pub(crate) gaps: u64,
    pub(crate) gap_samples: u64,
    pub(crate) records: u64,
    pub(crate) refused: u64,
    pub(super) cutter: StreamCutter,
    meter: LevelMeter,
    operating_point: OperatingPoint,
    #[serde(default)]
    pub(super) steadiness: Steadiness,
}

/// A record that is decided on and is not stored yet. It stays as it is, so that it is the same record
/// however often it is begun again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct PendingCut {
    pub(crate) cut: StreamCut,
    pub(crate) start_time: Timestamp,
    pub(crate) operating_point: OperatingPoint,
}

/// What is remembered besides samples and gaps.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Note {
    Cut(PendingCut),
    /// A record of a steady machine; no other of its operating bin begins before `next_from`.
    SteadyCut {
        pending: PendingCut,
        bin: String,
        next_from: u64,
    },
    Done {
        first: u64,
        is_refused: bool,
    },
    /// The machine is as steady as before.
    OperatingPoint(OperatingPoint),
    /// The machine does something else from here on.
    Moved(OperatingPoint),
}

impl StreamState {
    pub(super) fn new(asset_created_at: Timestamp, format: StreamFormat, next: Option<u64>) -> Self {
        Self {
            asset_created_at,
            next,
            clock: StreamClock::new(format.sample_rate_hz()),
            format,
            pending: VecDeque::new(),
            gaps: 0,
            gap_samples: 0,
            records: 0,
            refused: 0,
            cutter: StreamCutter::default(),
            meter: LevelMeter::default(),
            operating_point: OperatingPoint::default(),
            steadiness: Steadiness::default(),
        }
    }

    pub(super) fn checkpoint(&self) -> Bytes {
        // Plain numbers, texts and lists: it always serialises.
        serde_json::to_vec(self).unwrap_or_default().into()
    }

    /// Takes an entry of the journal; adds the seconds that are over to `levels`.
    pub(super) fn apply(&mut self, entry: &JournalEntry, levels: &mut Vec<TimedLevel>) {
        match entry {
            JournalEntry::Checkpoint(text) => match serde_json::from_slice(text) {
                Ok(state) => *self = state,
                Err(error) => tracing::error!(%error, "failed to read a checkpoint of a stream"),
            },
            JournalEntry::Frames { first, time_ns, bytes } => {
                let frames = (bytes.len() / self.format.frame_bytes()) as u64;
                if let Some(time_ns) = time_ns {
                    self.clock.observe(*first, *time_ns);
                }
                self.cutter.extend(*first, frames);
                let mut over = Vec::new();
                self.meter.extend(&self.format, *first, bytes, &mut over);
                levels.extend(over.into_iter().map(|level| TimedLevel {
                    time_ns: self.clock.time_ns(level.first).unwrap_or_default(),
                    level,
                }));
                self.next = Some(first + frames);
            }
            JournalEntry::Gap { first, frames } => {
                self.gaps += 1;
                self.gap_samples += frames;
                self.next = Some(first + frames);
            }
            JournalEntry::Note(text) => match serde_json::from_slice(text) {
                Ok(note) => self.take_note(note),
                Err(error) => tracing::error!(%error, "failed to read a note of a stream"),
            },
        }
    }

    fn take_note(&mut self, note: Note) {
        match note {
            Note::Cut(pending) => self.take_cut(pending),
            Note::SteadyCut { pending, bin, next_from } => {
                self.steadiness.taken(bin, next_from);
                self.take_cut(pending);
            }
            Note::Done { first, is_refused } => {
                // Another record may begin with the same sample; they are stored in this order.
                if let Some(done) = self.pending.iter().position(|pending| pending.cut.first == first) {
                    self.pending.remove(done);
                }
                self.records += u64::from(!is_refused);
                self.refused += u64::from(is_refused);
            }
            Note::OperatingPoint(point) => self.operating_point = point,
            Note::Moved(point) => {
                self.operating_point = point;
                self.steadiness.begin(point, self.next.unwrap_or(0));
            }
        }
    }

    fn take_cut(&mut self, pending: PendingCut) {
        self.cutter.taken(pending.cut);
        self.pending.push_back(pending);
    }

    fn pending(&self, cut: StreamCut) -> PendingCut {
        let start_time = self.time(cut.first).unwrap_or(self.asset_created_at);
        PendingCut { cut, start_time, operating_point: self.operating_point }
    }

    /// The time of a sample; none before the first one.
    pub(crate) fn time(&self, index: u64) -> Option<Timestamp> {
        Timestamp::from_nanosecond(self.clock.time_ns(index)?.into()).ok()
    }

    /// What the machine does, as the sender said it last.
    pub(super) fn operating_point(&self) -> OperatingPoint {
        self.operating_point
    }

    /// The first sample that is still needed.
    pub(super) fn needed_from(&self) -> u64 {
        let kept = self.format.frames_in(KEPT_S).min(MAX_KEPT_BYTES / self.format.frame_bytes() as u64);
        let kept_from = self.next.unwrap_or(0).saturating_sub(kept);
        let pending = self.pending.iter().map(|pending| pending.cut.first).min();
        kept_from.min(self.cutter.needs_from()).min(pending.unwrap_or(u64::MAX))
    }
}

/// Entries that are not written yet, and the state that follows from them.
pub(super) struct Draft {
    pub(super) state: StreamState,
    pub(super) entries: Vec<JournalEntry>,
    pub(super) levels: Vec<TimedLevel>,
}

impl Draft {
    pub(super) fn new(state: StreamState) -> Self {
        Self { state, entries: Vec::new(), levels: Vec::new() }
    }

    pub(super) fn add(&mut self, entry: JournalEntry) {
        self.state.apply(&entry, &mut self.levels);
        self.entries.push(entry);
    }

    pub(super) fn note(&mut self, note: &Note) {
        self.add(JournalEntry::Note(serde_json::to_vec(note).unwrap_or_default().into()));
    }

    pub(super) fn cut(&mut self, cut: StreamCut) {
        self.note(&Note::Cut(self.state.pending(cut)));
    }

    /// Decides on the records that are whole.
    pub(super) fn cut_whole(&mut self, cutting: &Cutting) {
        while let Some(decision) = cutting.next_cut(&self.state) {
            match decision {
                Decision::Clocked(cut) => self.cut(cut),
                Decision::Steady { cut, bin, next_from } => {
                    let pending = self.state.pending(cut);
                    self.note(&Note::SteadyCut { pending, bin, next_from });
                }
            }
        }
        cutting.pass_over(&mut self.state.cutter);
    }

    /// Decides on what is left before a gap.
    pub(super) fn cut_rest(&mut self, cutting: &Cutting) {
        if let Some(cut) = cutting.last_cut(&self.state) {
            self.cut(cut);
        }
    }
}
