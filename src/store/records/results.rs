//! The results of each record of a channel, for evaluating a whole history.

use crate::asset::SegmentId;
use crate::estimate::WearEstimate;
use crate::signal::Indicators;
use crate::store::database::rows::{from_ns, get, get_json};
use crate::store::{ChannelSummary, SegmentKey, Store, StoreError};

/// The results of one record.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordResults {
    /// Its key in its channel.
    pub key: SegmentKey,
    /// Whether it is excluded.
    pub excluded: bool,
    /// The wear estimate, without its posterior.
    pub wear: WearEstimate,
    /// Indicators of the record alone, and those that depend on the earlier records.
    pub indicators: [Indicators; 2],
}

impl Store {
    /// Up to `limit` records of a channel after `after` with their served results, in the order of time.
    pub async fn record_results(
        &self,
        channel: &ChannelSummary,
        after: Option<&SegmentKey>,
        limit: u32,
    ) -> Result<Vec<RecordResults>, StoreError> {
        let (after_ns, after_id) = SegmentKey::bound(after, i64::MIN)?;
        let rows = sqlx::query(
            "SELECT s.id, s.start_time_ns, s.excluded, a.indicator_values, w.run_indicator_values, w.estimate
             FROM (
                SELECT * FROM segments WHERE channel_no = $1 AND (start_time_ns, id) > ($2, $3) ORDER BY start_time_ns, id LIMIT $4
             ) s
             JOIN channels c ON c.channel_no = s.channel_no
             JOIN analyses a ON a.segment_id = s.id AND a.generation = c.analysis_generation
             JOIN wear_estimates w ON w.segment_id = s.id AND w.generation = c.wear_generation
             ORDER BY s.start_time_ns, s.id",
        )
        .bind(channel.channel_no)
        .bind(after_ns)
        .bind(after_id)
        .bind(i64::from(limit))
        .fetch_all(self.read())
        .await?;
        let layouts =
            self.layouts().load(&rows, &["indicator_values", "run_indicator_values"], self.read()).await?;
        let results = rows.iter().map(|row| {
            let id: String = get(row, "id")?;
            Ok(RecordResults {
                excluded: get::<i64>(row, "excluded")? != 0,
                wear: get_json(row, "estimate", &id)?,
                indicators: [
                    layouts.read(row, "indicator_values", &id)?,
                    layouts.read_or_default(row, "run_indicator_values", &id)?,
                ],
                key: SegmentKey { start_time: from_ns(get(row, "start_time_ns")?), id: SegmentId(id) },
            })
        });
        results.collect()
    }
}
