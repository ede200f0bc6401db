//! Retrospective estimates of the records before a channel's last inspection.

use super::History;
use super::fold::FoldInput;
use crate::estimate::{HistoryStep, MaintenanceEvent, WearEstimate};
use crate::service::error::ServiceError;
use crate::service::sensor_group::described;
use crate::store::{ChannelSummary, SegmentKey};

/// Maximum number of records: each takes some milliseconds, and its features are in memory during the
/// computation.
const MAX_RECORDS: usize = 5000;

/// Records read from the store in one query.
const RECORDS_PER_QUERY: u32 = 500;

impl History {
    /// Returns the estimates of a channel's records before its last inspection, given that inspection, in the
    /// order of time; empty without an inspection. They are computed on demand; the stored estimates stay as
    /// they are.
    ///
    /// # Errors
    /// [`ServiceError::TooManyRecords`].
    pub async fn in_hindsight(
        &self,
        channel: &ChannelSummary,
    ) -> Result<Vec<(SegmentKey, WearEstimate)>, ServiceError> {
        let store = &self.folding.store;
        let asset = described(store, &channel.asset_id).await?;
        let events = store.maintenance(&channel.asset_id).await?;
        let inspected = events.iter().filter(|event| event.inspection.is_some());
        let Some(last) = inspected.map(|event| event.time).max() else {
            return Ok(Vec::new());
        };
        let estimator = self.simulations.estimator(&asset.spec);
        // Recomputations forget those of earlier descriptions, but an API node has none.
        let served = store.channels(&channel.asset_id).await?.into_iter().map(|channel| channel.keys.fold);
        self.simulations.keep_estimators(&asset.spec, served);
        let mut inputs: Vec<FoldInput> = Vec::new();
        loop {
            let after = inputs.last().map(|input| &input.key);
            let read = store.features(channel, channel.served_analyses(), after, RECORDS_PER_QUERY).await?;
            let is_last = read.len() < RECORDS_PER_QUERY as usize;
            let before = read.into_iter().take_while(|stored| stored.key.start_time < last);
            let count = inputs.len();
            inputs.extend(before.map(|stored| FoldInput::of(stored, &estimator.feature_key)));
            if inputs.len() > MAX_RECORDS {
                return Err(ServiceError::TooManyRecords(MAX_RECORDS));
            }
            if is_last || inputs.len() - count < RECORDS_PER_QUERY as usize {
                break;
            }
        }
        let look_back = move || {
            let steps = steps(&inputs, &events);
            let (keys, steps): (Vec<_>, Vec<_>) = steps.into_iter().unzip();
            let estimates = estimator.estimator.in_hindsight(&steps);
            let keyed = keys.into_iter().zip(estimates);
            keyed.filter_map(|(key, estimate)| Some((key?.clone(), estimate?))).collect()
        };
        self.folding.workers.run("compute estimates in hindsight", look_back).await
    }
}

/// Records with their keys, and events, in the order of time; an event comes before the records of the same
/// time. Excluded records are skipped.
fn steps<'a>(
    inputs: &'a [FoldInput],
    events: &'a [MaintenanceEvent],
) -> Vec<(Option<&'a SegmentKey>, HistoryStep<'a>)> {
    let records = inputs.iter().filter(|input| !input.excluded);
    let records = records.map(|input| {
        let step = HistoryStep::Record(input.key.start_time, &input.features);
        (input.key.start_time, (Some(&input.key), step))
    });
    let events = events.iter().map(|event| (event.time, (None, HistoryStep::Event(event))));
    let mut all: Vec<_> = events.chain(records).collect();
    // Stable: events stay before records of the same time.
    all.sort_by_key(|(time, _)| *time);
    all.into_iter().map(|(_, step)| step).collect()
}
