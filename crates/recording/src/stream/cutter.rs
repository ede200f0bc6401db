//! Selection of the samples of a stream that become records.

use serde::{Deserialize, Serialize};

use super::super::RecordingError;
use flankwatch_signal::MAX_RECORD_SAMPLES;

/// How records are cut: one per interval, continuously, or none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CutPolicy {
    record_frames: u64,
    /// 0 if no record is cut.
    interval_frames: u64,
}

impl CutPolicy {
    /// Creates a policy with records of `record_s` seconds, one every `interval_s` seconds. If both are
    /// equal, all samples become records; if the interval is 0, none do.
    ///
    /// # Errors
    /// A record length out of range, or an interval above 0 that is shorter than it.
    pub fn new(record_s: f64, interval_s: f64, sample_rate_hz: f64) -> Result<Self, RecordingError> {
        let frames = (record_s * sample_rate_hz).round();
        if !(1.0..=MAX_RECORD_SAMPLES as f64).contains(&frames) {
            let expected = "a length of 1 to 16777216 samples";
            return Err(RecordingError::field("record_s", record_s, expected));
        }
        let interval = (interval_s * sample_rate_hz).round();
        if interval != 0.0 && !(frames..=super::MAX_INDEX as f64).contains(&interval) {
            let expected = "0, or at least the length of a record";
            return Err(RecordingError::field("interval_s", interval_s, expected));
        }
        Ok(Self { record_frames: frames as u64, interval_frames: interval as u64 })
    }

    /// Returns the length of a record in frames.
    pub fn record_frames(&self) -> u64 {
        self.record_frames
    }

    /// Returns whether no record is cut.
    pub fn is_disabled(&self) -> bool {
        self.interval_frames == 0
    }

    /// Returns whether all samples become records.
    pub fn is_continuous(&self) -> bool {
        self.record_frames == self.interval_frames
    }

    /// Returns the earliest start of the next record after `cut`.
    pub fn after(&self, cut: StreamCut) -> u64 {
        if self.is_continuous() || self.is_disabled() {
            return cut.end();
        }
        let next_interval = (cut.first / self.interval_frames + 1) * self.interval_frames;
        next_interval.max(cut.end())
    }
}

/// Samples that become one record.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct StreamCut {
    /// Index of the first sample.
    pub first: u64,
    /// Number of frames.
    pub frames: u64,
    /// Where the next record begins at the earliest.
    pub next_from: u64,
}

impl StreamCut {
    /// Returns the index after the last sample.
    pub fn end(&self) -> u64 {
        self.first + self.frames
    }
}

/// Finds records in samples without a gap. The result depends on indices only, not on how the samples
/// arrived.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StreamCutter {
    /// Index since which there is no gap.
    run_first: u64,
    end: u64,
    /// Where the next record begins at the earliest.
    from: u64,
}

impl StreamCutter {
    /// Adds samples, which continue the previous ones or start after a gap.
    pub fn extend(&mut self, first: u64, frames: u64) {
        if first != self.end {
            self.run_first = first;
        }
        self.end = first + frames;
    }

    /// Returns the next complete record, which must be [marked as cut](Self::mark_cut).
    pub fn next_cut(&self, policy: &CutPolicy) -> Option<StreamCut> {
        if policy.is_disabled() {
            return None;
        }
        let first = self.earliest();
        let end = first.checked_add(policy.record_frames)?;
        (end <= self.end).then(|| self.cut(first, policy.record_frames, policy))
    }

    /// Returns the remainder before a gap if all samples become records and it is at least half a record
    /// long.
    pub fn last_cut(&self, policy: &CutPolicy) -> Option<StreamCut> {
        let first = self.earliest();
        let frames = self.end.saturating_sub(first);
        (policy.is_continuous() && 2 * frames >= policy.record_frames && frames > 0)
            .then(|| self.cut(first, frames, policy))
    }

    /// Marks a record as cut.
    pub fn mark_cut(&mut self, cut: StreamCut) {
        self.from = self.from.max(cut.next_from);
    }

    /// Excludes all samples so far from records.
    pub fn skip(&mut self) {
        self.skip_before(self.end);
    }

    /// Excludes records that start before this index.
    pub fn skip_before(&mut self, index: u64) {
        self.from = self.from.max(index);
    }

    /// Returns where the next record begins at the earliest.
    pub fn earliest(&self) -> u64 {
        self.run_first.max(self.from)
    }

    /// Returns the index after the last sample.
    pub fn end(&self) -> u64 {
        self.end
    }

    /// Returns the index since which there is no gap.
    pub fn run_first(&self) -> u64 {
        self.run_first
    }

    /// Returns the index of the first sample that a later record may need.
    pub fn needs_from(&self) -> u64 {
        self.earliest().min(self.end)
    }

    fn cut(&self, first: u64, frames: u64, policy: &CutPolicy) -> StreamCut {
        let cut = StreamCut { first, frames, next_from: 0 };
        StreamCut { next_from: policy.after(cut), ..cut }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// First samples and lengths of the records in stretches of samples.
    fn cuts(policy: &CutPolicy, stretches: &[(u64, u64)]) -> Vec<(u64, u64)> {
        let mut cutter = StreamCutter::default();
        let mut found = Vec::new();
        let mut take = |cutter: &mut StreamCutter, cut: StreamCut| {
            cutter.mark_cut(cut);
            found.push((cut.first, cut.frames));
        };
        for &(first, frames) in stretches {
            if first != cutter.end
                && let Some(cut) = cutter.last_cut(policy)
            {
                take(&mut cutter, cut);
            }
            cutter.extend(first, frames);
            while let Some(cut) = cutter.next_cut(policy) {
                take(&mut cutter, cut);
            }
        }
        found
    }

    #[test]
    fn one_record_is_cut_in_every_interval() {
        let policy = CutPolicy::new(1.0, 6.0, 10.0).unwrap();
        assert_eq!(cuts(&policy, &[(7, 200)]), [(7, 10), (60, 10), (120, 10), (180, 10)]);
        // No record reaches over a gap: it is cut later in its interval.
        assert_eq!(cuts(&policy, &[(0, 65), (70, 60)]), [(0, 10), (70, 10), (120, 10)]);
        assert_eq!(cuts(&policy, &[(0, 65), (125, 60)]), [(0, 10), (125, 10)]);
        // A late record of one interval does not overlap that of the next one.
        let policy = CutPolicy::new(4.0, 6.0, 10.0).unwrap();
        assert_eq!(cuts(&policy, &[(50, 200)]), [(50, 40), (90, 40), (130, 40), (180, 40)]);
    }

    #[test]
    fn all_samples_become_records_where_the_interval_is_their_length() {
        let policy = CutPolicy::new(1.0, 1.0, 10.0).unwrap();
        assert_eq!(cuts(&policy, &[(3, 24)]), [(3, 10), (13, 10)]);
        // Before a gap also half a record is one, and less than that is none.
        let with_rest = [(3, 10), (13, 10), (23, 5), (40, 10)];
        assert_eq!(cuts(&policy, &[(3, 25), (40, 10)]), with_rest);
        assert_eq!(cuts(&policy, &[(3, 24), (40, 10)]), [(3, 10), (13, 10), (40, 10)]);
    }

    #[test]
    fn an_interval_of_0_makes_no_records_and_needs_no_samples() {
        let policy = CutPolicy::new(1.0, 0.0, 10.0).unwrap();
        assert_eq!(cuts(&policy, &[(0, 100), (120, 100)]), []);
        let mut cutter = StreamCutter::default();
        cutter.extend(0, 100);
        cutter.skip();
        assert_eq!(cutter.needs_from(), 100);
        // Records begin where it is changed.
        cutter.extend(100, 30);
        let policy = CutPolicy::new(1.0, 1.0, 10.0).unwrap();
        assert_eq!(cutter.next_cut(&policy).map(|cut| cut.first), Some(100));
    }

    #[test]
    fn invalid_record_lengths_are_rejected() {
        for (record_s, interval_s) in
            [(0.0, 1.0), (2.0, 1.0), (f64::NAN, 1.0), (1e9, 1e9), (1.0, f64::INFINITY)]
        {
            assert!(CutPolicy::new(record_s, interval_s, 1000.0).is_err(), "{record_s} {interval_s}");
        }
    }

    proptest! {
        #[test]
        fn records_do_not_depend_on_the_chunks(
            edges in prop::collection::btree_set(1_u64..1000, 0..50),
            record in 1_u64..80,
            more in 0_u64..80,
        ) {
            let policy = CutPolicy { record_frames: record, interval_frames: record + more };
            let edges: Vec<u64> = std::iter::once(0).chain(edges).chain([1000]).collect();
            let stretches: Vec<(u64, u64)> = edges.windows(2).map(|edge| (edge[0], edge[1] - edge[0])).collect();
            let found = cuts(&policy, &stretches);
            prop_assert_eq!(&found, &cuts(&policy, &[(0, 1000)]));
            for pair in found.windows(2) {
                prop_assert!(pair[0].0 + pair[0].1 <= pair[1].0);
            }
        }
    }
}
