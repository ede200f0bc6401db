//! The state of a stream, derived from the entries of its journal.

use std::collections::VecDeque;

use bytes::Bytes;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::capture::{Campaign, Capture};
use super::cutting::{Cutting, Decision};
use super::steadiness::Steadiness;
use super::tachometer::{Pulses, StreamTachometer, lead};
use crate::recording::stream::{LevelMeter, StreamClock, StreamCut, StreamCutter, StreamFormat};
use crate::signal::{OperatingPoint, Tachometer};
use crate::store::{JournalEntry, TimedLevel};

/// Seconds of samples that stay in the journal after records are cut, and their maximum number of bytes.
const KEPT_S: f64 = 60.0;
const MAX_KEPT_BYTES: u64 = 256 << 20;

/// The state after all entries so far.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct StreamState {
    /// Distinguishes an asset from a later one of the same name.
    pub(crate) asset_created_at: Timestamp,
    pub(crate) format: StreamFormat,
    pub(crate) next: Option<u64>,
    pub(crate) clock: StreamClock,
    /// The latest time after a stored sample, by the sender's clock.
    #[serde(default)]
    pub(super) newest_ns: Option<i64>,
    pub(crate) pending: VecDeque<PendingCut>,
    pub(crate) gaps: u64,
    pub(crate) gap_samples: u64,
    pub(crate) records: u64,
    pub(crate) refused: u64,
    /// Why the last refused record was refused.
    #[serde(default)]
    pub(crate) last_refusal: Option<String>,
    pub(super) cutter: StreamCutter,
    meter: LevelMeter,
    operating_point: OperatingPoint,
    #[serde(default)]
    tachometer: StreamTachometer,
    #[serde(default)]
    pub(super) steadiness: Steadiness,
    #[serde(default)]
    pub(super) capture: Option<Capture>,
    /// Index after the last sample of the previous captures.
    #[serde(default)]
    captured_to: u64,
    #[serde(default)]
    pub(crate) campaign: Option<Campaign>,
    /// In a shared store: the connection that sends the stream, and the last alarm that began a capture.
    #[serde(default)]
    pub(super) sender: Option<u64>,
    #[serde(default)]
    alarm: Option<String>,
}

/// A record that is planned and not stored yet. It never changes, so that each attempt to store it gives the
/// same record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct PendingCut {
    pub(crate) cut: StreamCut,
    pub(crate) start_time: Timestamp,
    pub(crate) operating_point: OperatingPoint,
    /// Frames before it in which pulses of its tachometer's channel are found too.
    #[serde(default)]
    pub(crate) lead: u64,
}

/// An event in the journal other than samples and gaps.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum JournalEvent {
    Cut(PendingCut),
    /// A record of a steady machine; the next one of its operating bin starts no earlier than `next_from`.
    SteadyCut {
        pending: PendingCut,
        bin: String,
        next_from: u64,
    },
    Done {
        first: u64,
        is_refused: bool,
        #[serde(default)]
        refusal: Option<String>,
    },
    /// The operating point changed within the bounds of a steady machine.
    OperatingPoint(OperatingPoint),
    /// The operating point changed beyond these bounds.
    Moved(OperatingPoint),
    /// Tachometer pulses among future samples.
    Pulses(Pulses),
    /// A capture starts.
    Capture(Capture),
    /// A campaign starts, or the end of the running one changes.
    Campaign(Capture, Campaign),
    /// A record of the capture.
    Captured(PendingCut),
    /// The capture ends early.
    CaptureEnd,
    /// In a shared store: another connection sends the stream from now on.
    Sender(u64),
    /// In a shared store: no further record starts before this index.
    Skipped(u64),
    /// The alarm that begins the next capture.
    Alarm(String),
}

impl StreamState {
    pub(super) fn new(asset_created_at: Timestamp, format: StreamFormat, next: Option<u64>) -> Self {
        Self {
            asset_created_at,
            next,
            clock: StreamClock::new(format.sample_rate_hz()),
            newest_ns: None,
            format,
            pending: VecDeque::new(),
            gaps: 0,
            gap_samples: 0,
            records: 0,
            refused: 0,
            last_refusal: None,
            cutter: StreamCutter::default(),
            meter: LevelMeter::default(),
            operating_point: OperatingPoint::default(),
            tachometer: StreamTachometer::default(),
            steadiness: Steadiness::default(),
            capture: None,
            captured_to: 0,
            campaign: None,
            sender: None,
            alarm: None,
        }
    }

    pub(super) fn checkpoint(&self) -> Bytes {
        // Plain numbers, texts and lists always serialise.
        serde_json::to_vec(self).unwrap_or_default().into()
    }

    /// Applies an entry of the journal; appends the levels of completed seconds to `levels`.
    pub(super) fn apply(&mut self, entry: &JournalEntry, levels: &mut Vec<TimedLevel>) {
        match entry {
            JournalEntry::Checkpoint(text) => match serde_json::from_slice(text) {
                Ok(state) => *self = state,
                Err(error) => tracing::error!(%error, "failed to decode a checkpoint of a stream journal"),
            },
            JournalEntry::Frames { first, time_ns, bytes } => {
                let frames = (bytes.len() / self.format.frame_bytes()) as u64;
                if let Some(time_ns) = time_ns {
                    self.clock.observe(*first, *time_ns);
                }
                let length_ns = (self.format.seconds(frames) * 1e9) as i64;
                self.newest_ns = match time_ns {
                    Some(time_ns) => self.newest_ns.max(Some(time_ns.saturating_add(length_ns))),
                    None => self.newest_ns.map(|newest_ns| newest_ns.saturating_add(length_ns)),
                };
                self.cutter.extend(*first, frames);
                let mut over = Vec::new();
                self.meter.extend(&self.format, *first, bytes, &mut over);
                levels.extend(over.into_iter().map(|level| TimedLevel {
                    time_ns: self.clock.time_ns(level.first).unwrap_or_default(),
                    level,
                }));
                self.next = Some(first + frames);
                self.tachometer.forget_before(self.needed_from(), self.format.sample_rate_hz());
            }
            JournalEntry::Gap { first, frames } => {
                self.gaps += 1;
                self.gap_samples += frames;
                self.next = Some(first + frames);
                self.captured(first + frames);
            }
            JournalEntry::Event(text) => match serde_json::from_slice(text) {
                Ok(event) => self.apply_event(event),
                Err(error) => tracing::error!(%error, "failed to decode an event of a stream journal"),
            },
        }
    }

    fn apply_event(&mut self, event: JournalEvent) {
        match event {
            JournalEvent::Cut(pending) => self.take_cut(pending),
            JournalEvent::SteadyCut { pending, bin, next_from } => {
                self.steadiness.add_cut(bin, next_from);
                self.take_cut(pending);
            }
            JournalEvent::Done { first, is_refused, refusal } => {
                // Another record may start with the same sample; they are stored in order.
                if let Some(done) = self.pending.iter().position(|pending| pending.cut.first == first) {
                    self.pending.remove(done);
                }
                self.records += u64::from(!is_refused);
                self.refused += u64::from(is_refused);
                self.last_refusal = refusal.or(self.last_refusal.take());
            }
            JournalEvent::OperatingPoint(point) => self.operating_point = point,
            JournalEvent::Moved(point) => {
                self.operating_point = point;
                self.steadiness.begin(point, self.next.unwrap_or(0));
            }
            JournalEvent::Pulses(pulses) => self.tachometer.extend(pulses),
            JournalEvent::Capture(capture) => self.capture = Some(capture),
            JournalEvent::Campaign(capture, campaign) => {
                self.capture = Some(capture);
                self.campaign = Some(campaign);
            }
            JournalEvent::Captured(pending) => {
                let (end, start_time) = (pending.cut.end(), pending.start_time);
                self.take_cut(pending);
                if let Some(campaign) = self.campaign_that_runs() {
                    if campaign.records == 0 {
                        // The time of its first record: the clock may be known better than at the start.
                        campaign.start_time = start_time;
                    }
                    campaign.records += 1;
                }
                self.captured(end);
            }
            JournalEvent::CaptureEnd => {
                if let Some(capture) = &mut self.capture {
                    capture.until = capture.from;
                }
                self.captured(0);
            }
            JournalEvent::Sender(sender) => self.sender = Some(sender),
            JournalEvent::Skipped(index) => self.cutter.skip_before(index),
            JournalEvent::Alarm(alarm) => self.alarm = Some(alarm),
        }
    }

    /// Advances the capture to an index, and ends it if it is complete.
    fn captured(&mut self, index: u64) {
        let Some(capture) = &mut self.capture else { return };
        capture.from = capture.from.max(index);
        let Capture { from, until, .. } = *capture;
        if from < until {
            return;
        }
        let end_time = self.time(until);
        if let Some(campaign) = self.campaign_that_runs() {
            campaign.until = until;
            campaign.end_time = end_time;
        }
        self.captured_to = until;
        self.capture = None;
    }

    fn campaign_that_runs(&mut self) -> Option<&mut Campaign> {
        self.campaign.as_mut().filter(|_| self.capture.is_some_and(|capture| capture.is_campaign))
    }

    fn take_cut(&mut self, pending: PendingCut) {
        self.cutter.mark_cut(pending.cut);
        self.pending.push_back(pending);
    }

    fn pending(&self, cut: StreamCut) -> PendingCut {
        let start_time = self.time(cut.first).unwrap_or(self.asset_created_at);
        let lead = self.lead().min(cut.first.saturating_sub(self.cutter.run_first()));
        PendingCut { cut, start_time, operating_point: self.operating_point, lead }
    }

    /// Frames before a record that are needed for its pulses.
    fn lead(&self) -> u64 {
        self.format.tachometer().map_or(0, |_| lead(self.format.sample_rate_hz()))
    }

    /// The time of a sample; `None` before the first one.
    pub(crate) fn time(&self, index: u64) -> Option<Timestamp> {
        Timestamp::from_nanosecond(self.clock.time_ns(index)?.into()).ok()
    }

    /// The pulses of a planned record, which never change.
    pub(super) fn tachometer_of(&self, cut: StreamCut) -> Option<Tachometer> {
        self.tachometer.of(cut, self.format.sample_rate_hz())
    }

    /// The last operating point given by the sender.
    pub(super) fn operating_point(&self) -> OperatingPoint {
        self.operating_point
    }

    /// The first sample that is still needed.
    pub(super) fn needed_from(&self) -> u64 {
        let kept_from = self.next.unwrap_or(0).saturating_sub(self.kept_frames());
        let pending = self.pending.iter().map(|pending| pending.cut.first).min();
        let captured = self.capture.map(|capture| capture.from);
        let needed = pending.into_iter().chain(captured).min().unwrap_or(u64::MAX);
        kept_from.min(self.cutter.needs_from()).min(needed).saturating_sub(self.lead())
    }

    /// Whether this alarm began the last capture around an alarm.
    pub(super) fn is_captured(&self, alarm: &str) -> bool {
        self.alarm.as_deref() == Some(alarm)
    }

    /// The number of latest frames that stay in the journal.
    fn kept_frames(&self) -> u64 {
        self.format.frames_in(KEPT_S).min(MAX_KEPT_BYTES / self.format.frame_bytes() as u64)
    }

    /// The capture for an alarm that is raised now; `None` if there are no samples, or if a capture is
    /// running.
    pub(super) fn around_alarm(&self, cutting: &Cutting) -> Option<Capture> {
        let (next, (before, after)) = (self.next?, cutting.around_alarm()?);
        if self.capture.is_some() {
            return None;
        }
        // Right after a gap there are no samples before the alarm.
        let before = if next == self.cutter.end() { before.min(self.kept_frames()) } else { 0 };
        let from = next.saturating_sub(before).max(self.captured_to);
        let from = if before > 0 { from.max(self.cutter.run_first()) } else { from };
        let (until, record_frames) = (next + after, cutting.captured_frames());
        let capture = Capture { from, until, record_frames, is_campaign: false, alarm_until: until };
        (from < until).then_some(capture)
    }

    /// A campaign of `frames` frames from now on, or the running one with its new end; longer if the samples
    /// for an alarm are. `None` before the first sample.
    pub(super) fn campaign_of(&self, frames: u64, cutting: &Cutting) -> Option<(Capture, Campaign)> {
        let next = self.next?;
        let is_whole = next == self.cutter.end();
        let from = match &self.capture {
            Some(capture) => capture.from,
            // Samples that are not in a record yet would otherwise be in none.
            None if cutting.is_continuous() && is_whole => self.cutter.earliest().min(next),
            None => next,
        };
        let alarm_until = self.capture.map_or(0, |capture| capture.alarm_until);
        let (until, record_frames) = ((next + frames).max(alarm_until), cutting.captured_frames());
        let capture = Capture { from, until, record_frames, is_campaign: true, alarm_until };
        let is_running = self.capture.is_some_and(|capture| capture.is_campaign);
        let campaign = match &self.campaign {
            Some(campaign) if is_running => Campaign { until, ..campaign.clone() },
            _ => Campaign { first: from, start_time: self.time(from)?, until, end_time: None, records: 0 },
        };
        Some((capture, campaign))
    }
}

/// Entries that are not written yet, and the state after them.
pub(super) struct Draft {
    pub(super) state: StreamState,
    pub(super) entries: Vec<JournalEntry>,
    pub(super) levels: Vec<TimedLevel>,
    /// Index before which no further record starts, if that does not follow from the entries.
    skipped: Option<u64>,
}

impl Draft {
    pub(super) fn new(state: StreamState) -> Self {
        Self { state, entries: Vec::new(), levels: Vec::new(), skipped: None }
    }

    /// Adds what other processes cannot know from the entries; they may have another description of the asset
    /// when they go on.
    pub(super) fn add_skipped(&mut self) {
        if let Some(index) = self.skipped.take().filter(|_| !self.entries.is_empty()) {
            self.add_event(&JournalEvent::Skipped(index));
        }
    }

    pub(super) fn add(&mut self, entry: JournalEntry) {
        self.state.apply(&entry, &mut self.levels);
        self.entries.push(entry);
    }

    pub(super) fn add_event(&mut self, event: &JournalEvent) {
        self.add(JournalEntry::Event(serde_json::to_vec(event).unwrap_or_default().into()));
    }

    pub(super) fn cut(&mut self, cut: StreamCut) {
        self.add_event(&JournalEvent::Cut(self.state.pending(cut)));
    }

    /// Plans the records that are complete.
    pub(super) fn cut_whole(&mut self, cutting: &Cutting) {
        while let Some(cut) = self.state.capture.and_then(|capture| capture.next_cut(&self.state.cutter)) {
            self.captured(cut, cutting);
        }
        while let Some(decision) = cutting.next_cut(&self.state) {
            match decision {
                Decision::Clocked(cut) => self.cut(cut),
                Decision::Steady { cut, bin, next_from } => {
                    let pending = self.state.pending(cut);
                    self.add_event(&JournalEvent::SteadyCut { pending, bin, next_from });
                }
            }
        }
        let earliest = self.state.cutter.earliest();
        cutting.pass_over(&mut self.state.cutter);
        if self.state.cutter.earliest() > earliest {
            self.skipped = Some(self.state.cutter.earliest());
        }
    }

    /// Plans a record of the remaining samples before a gap.
    pub(super) fn cut_rest(&mut self, cutting: &Cutting) {
        if let Some(capture) = self.state.capture {
            if let Some(cut) = capture.rest(&self.state.cutter) {
                self.captured(cut, cutting);
            }
        } else if let Some(cut) = cutting.last_cut(&self.state) {
            self.cut(cut);
        }
    }

    fn captured(&mut self, cut: StreamCut, cutting: &Cutting) {
        let cut = StreamCut { next_from: cutting.after(cut), ..cut };
        self.add_event(&JournalEvent::Captured(self.state.pending(cut)));
    }
}
