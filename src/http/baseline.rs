//! The records of a channel's healthy baseline.

use jiff::Timestamp;

use crate::asset::{AssetId, BaselineSpec};
use crate::estimate::{MaintenanceKind, WearStatus};
use crate::store::{Store, StoreError, Trend};

/// The time from one maintenance event that starts a new baseline to the next.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct BaselinePeriod {
    /// Time of the event; none before the first one.
    from: Option<Timestamp>,
    /// Time of the next event.
    to: Option<Timestamp>,
    /// End of the baseline (exclusive) if it was chosen.
    chosen_until: Option<Timestamp>,
}

impl BaselinePeriod {
    /// The period of an asset at a time; by default the latest one.
    pub(super) async fn at(
        store: &Store,
        asset: &AssetId,
        time: Option<Timestamp>,
    ) -> Result<Self, StoreError> {
        let mut period = Self::default();
        for event in store.maintenance(asset).await? {
            if event.kind == MaintenanceKind::Inspected {
                continue;
            }
            if time.is_some_and(|time| time < event.time) {
                period.to = Some(event.time);
                break;
            }
            period = Self { from: Some(event.time), to: None, chosen_until: event.until };
        }
        Ok(period)
    }

    /// Positions of the records of the baseline.
    pub(super) fn positions(&self, trend: &Trend) -> Vec<usize> {
        let is_baseline = |n: &usize| trend.wear[*n].status == WearStatus::CollectingBaseline;
        trend.range(self.from, self.to).filter(is_baseline).collect()
    }

    /// Whether the baseline of these positions is complete, if `need` records make one that is not chosen.
    pub(super) fn is_complete(&self, trend: &Trend, positions: &[usize], need: u32) -> bool {
        let ends_before = |until: &Timestamp| positions.last().is_some_and(|n| trend.start_time[*n] < *until);
        match self.chosen_until.filter(ends_before) {
            Some(until) => {
                let is_over = !trend.range(Some(until), self.to).is_empty();
                is_over && positions.len() >= BaselineSpec::MIN_RECORDS as usize
            }
            // Too few chosen records are followed by others until there are enough.
            None => positions.len() >= need as usize,
        }
    }
}

/// Number of records in a time range that a baseline can have: that of the channel with the most.
pub(super) async fn records_between(
    store: &Store,
    asset: &AssetId,
    from: Timestamp,
    to: Timestamp,
) -> Result<usize, StoreError> {
    let mut most = 0;
    for channel in store.channels(asset).await? {
        let trend = store.trend(&channel).await?;
        let is_counted = |n: &usize| trend.wear[*n].status != WearStatus::Excluded;
        most = most.max(trend.range(Some(from), Some(to)).filter(is_counted).count());
    }
    Ok(most)
}

#[cfg(test)]
mod tests {
    use WearStatus::{CollectingBaseline, Excluded, NoLibrary, NotComparable};

    use super::*;
    use crate::asset::SegmentId;
    use crate::store::WearPoint;

    fn second(n: i64) -> Timestamp {
        Timestamp::from_second(n).unwrap()
    }

    /// One record a second with these statuses.
    fn trend(statuses: &[(WearStatus, usize)]) -> Trend {
        let mut trend = Trend::default();
        for (status, records) in statuses {
            for _ in 0..*records {
                let n = trend.len();
                trend.start_time.push(second(n as i64));
                trend.segment_id.push(SegmentId(n.to_string()));
                trend.wear.push(WearPoint {
                    status: *status,
                    reason: "".into(),
                    median_um: None,
                    mean_um: None,
                    low_um: None,
                    p25_um: None,
                    p75_um: None,
                    high_um: None,
                    reference_wear_um: None,
                    log_evidence: None,
                });
            }
        }
        trend
    }

    #[test]
    fn a_baseline_has_only_the_records_collected_for_it() {
        let trend =
            trend(&[(Excluded, 1), (CollectingBaseline, 5), (NotComparable, 2), (CollectingBaseline, 3)]);
        let period = BaselinePeriod::default();
        let positions = period.positions(&trend);
        assert_eq!(positions, [1, 2, 3, 4, 5, 8, 9, 10]);
        assert_eq!([8, 9].map(|need| period.is_complete(&trend, &positions, need)), [true, false]);
        let later = BaselinePeriod { from: Some(second(4)), to: Some(second(9)), ..period };
        assert_eq!(later.positions(&trend), [4, 5, 8]);
    }

    #[test]
    fn a_baseline_of_more_than_a_thousand_records_is_complete() {
        let trend = trend(&[(CollectingBaseline, 1500), (NoLibrary, 1)]);
        let period = BaselinePeriod::default();
        assert!(period.is_complete(&trend, &period.positions(&trend), 1500));
    }

    #[test]
    fn a_chosen_baseline_is_complete_after_its_end_and_with_enough_records() {
        let is_complete = |statuses: &[(WearStatus, usize)]| {
            let period = BaselinePeriod { chosen_until: Some(second(10)), ..BaselinePeriod::default() };
            let trend = trend(statuses);
            period.is_complete(&trend, &period.positions(&trend), 9)
        };
        assert!(!is_complete(&[(CollectingBaseline, 10)]), "more may come");
        assert!(is_complete(&[(CollectingBaseline, 10), (NoLibrary, 1)]));
        assert!(is_complete(&[(Excluded, 2), (CollectingBaseline, 8), (NoLibrary, 1)]), "8 of 9 suffice");
        assert!(!is_complete(&[(Excluded, 3), (CollectingBaseline, 7), (Excluded, 1)]));
        // Too few were chosen, so later ones are collected too.
        assert!(!is_complete(&[(Excluded, 5), (CollectingBaseline, 8)]));
        assert!(is_complete(&[(Excluded, 5), (CollectingBaseline, 9)]));
    }
}
