//! Histories computed again beside the one that is served, and swapped in whole.
//!
//! Analyses and estimates carry a generation number; a channel says which of each is served. A new generation is written in small
//! transactions that nobody sees, then one sets the channel's numbers, and the rows of the old generation are removed at leisure.

use super::fold_states::FoldState;
use super::rows::{get, to_ns};
use super::segments::new_segment_of;
use jiff::Timestamp;

use super::{
    AlarmNotice, Analysed, AnalysisKeys, ChannelKeys, ChannelSummary, FoldedAlarms, NewSegment, RunResult, SegmentKey, Store, StoreError,
    StoredFeatures,
};
use crate::asset::SegmentId;

/// A generation of a channel's analyses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AnalysisGeneration(i64);

/// A generation of a channel's estimates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WearGeneration(i64);

impl ChannelSummary {
    /// The generation of analyses that is served.
    pub fn served_analyses(&self) -> AnalysisGeneration {
        AnalysisGeneration(self.analysis_generation)
    }
}

impl Store {
    /// The generation of analyses under `key` that is being made, or a new one; one under another key is dropped.
    pub async fn next_analyses(&self, channel: &ChannelSummary, keys: &AnalysisKeys) -> Result<AnalysisGeneration, StoreError> {
        let mut commit = self.begin().await?;
        let mut channel = commit.channel_again(channel).await?;
        if let Some((generation, key)) = &channel.next_analysis
            && **key == *keys.analysis
        {
            return Ok(AnalysisGeneration(*generation));
        }
        channel.newest_generation += 1;
        channel.leftovers |= channel.next_analysis.is_some();
        let generation = channel.newest_generation;
        channel.next_analysis = Some((generation, keys.analysis.to_string()));
        commit.set_channel(&mut channel, false).await?;
        commit.finish().await?;
        Ok(AnalysisGeneration(generation))
    }

    /// A new generation of estimates.
    pub async fn next_wear(&self, channel: &ChannelSummary) -> Result<WearGeneration, StoreError> {
        let mut commit = self.begin().await?;
        let mut channel = commit.channel_again(channel).await?;
        channel.newest_generation += 1;
        // Until it is served its rows are left over, whatever happens.
        channel.leftovers = true;
        commit.set_channel(&mut channel, false).await?;
        commit.finish().await?;
        Ok(WearGeneration(channel.newest_generation))
    }

    /// Up to `limit` segments of a channel that have no analysis in a generation, in the order of time, after `after`.
    pub async fn not_analysed(
        &self,
        channel: &ChannelSummary,
        generation: AnalysisGeneration,
        after: Option<&SegmentKey>,
        limit: u32,
    ) -> Result<Vec<NewSegment>, StoreError> {
        let (after_ns, after_id) = match after {
            Some(key) => (to_ns(key.start_time)?, key.id.0.as_str()),
            None => (i64::MIN, ""),
        };
        let rows = sqlx::query(
            "SELECT s.*, c.asset_id, c.name AS channel, a.analysis_key, a.feature_key, a.shaft_speed, a.basis, a.indicators, a.features
             FROM segments s
             JOIN channels c ON c.channel_no = s.channel_no
             JOIN analyses a ON a.segment_id = s.id AND a.generation = c.analysis_generation
             WHERE s.channel_no = $1 AND (s.start_time_ns, s.id) > ($2, $3)
                AND NOT EXISTS (SELECT 1 FROM analyses b WHERE b.segment_id = s.id AND b.generation = $4)
             ORDER BY s.start_time_ns, s.id LIMIT $5",
        )
        .bind(channel.channel_no)
        .bind(after_ns)
        .bind(after_id)
        .bind(generation.0)
        .bind(i64::from(limit))
        .fetch_all(self.read())
        .await?;
        rows.iter().map(new_segment_of).collect()
    }

    /// Adds analyses to a generation.
    pub async fn add_analyses(&self, generation: AnalysisGeneration, analyses: &[(SegmentId, Analysed)]) -> Result<(), StoreError> {
        let mut commit = self.begin().await?;
        for (segment, analysed) in analyses {
            commit.insert_analysis(generation.0, segment, analysed).await?;
        }
        commit.finish().await
    }

    /// Up to `limit` segments of a channel with their features in a generation, in the order of time, after `after`.
    pub async fn features_of_generation(
        &self,
        channel: &ChannelSummary,
        generation: AnalysisGeneration,
        after: Option<&SegmentKey>,
        limit: u32,
    ) -> Result<Vec<StoredFeatures>, StoreError> {
        self.features_in(channel, generation.0, after, limit).await
    }

    /// Adds estimates to a generation, with states of the fold after position `after`.
    pub async fn add_wears(
        &self,
        channel: &ChannelSummary,
        generation: WearGeneration,
        wears: &[(SegmentKey, RunResult)],
        after: u64,
        states: &[FoldState],
    ) -> Result<(), StoreError> {
        let mut commit = self.begin().await?;
        commit.set_wears_in(generation.0, wears).await?;
        commit.set_states_in(channel, generation.0, after, states).await?;
        commit.finish().await
    }

    /// The latest kept state of a generation in which neither `key` nor any later record is.
    pub async fn state_of_generation(
        &self,
        channel: &ChannelSummary,
        generation: WearGeneration,
        key: &SegmentKey,
    ) -> Result<Option<FoldState>, StoreError> {
        self.state_before_in(channel, generation.0, key).await
    }

    /// Serves these generations from now on, with the alarms that were folded with them; both must have every segment of the channel.
    /// Returns what is new of the alarms.
    pub async fn serve(
        &self,
        channel: &ChannelSummary,
        analyses: AnalysisGeneration,
        wear: WearGeneration,
        keys: ChannelKeys,
        alarms: FoldedAlarms<'_>,
        now: Timestamp,
    ) -> Result<Vec<AlarmNotice>, StoreError> {
        let mut commit = self.begin().await?;
        let mut channel = commit.channel_again(channel).await?;
        channel.analysis_generation = analyses.0;
        channel.wear_generation = wear.0;
        if channel
            .next_analysis
            .as_ref()
            .is_some_and(|(generation, _)| *generation == analyses.0)
        {
            channel.next_analysis = None;
        }
        channel.keys = keys;
        channel.must_fold = false;
        channel.leftovers = true;
        commit.set_channel(&mut channel, true).await?;
        let notices = commit.set_alarms(&channel, alarms, now).await?;
        commit.finish().await?;
        Ok(notices)
    }

    /// Removes the rows of generations that are neither served nor being made, of up to `limit` segments after `after`. Returns where
    /// to go on; none at the end.
    pub async fn remove_leftovers(
        &self,
        channel: &ChannelSummary,
        after: Option<&SegmentKey>,
        limit: u32,
    ) -> Result<Option<SegmentKey>, StoreError> {
        let mut commit = self.begin().await?;
        let mut channel = commit.channel_again(channel).await?;
        let (after_ns, after_id) = match after {
            Some(key) => (to_ns(key.start_time)?, key.id.0.as_str()),
            None => (i64::MIN, ""),
        };
        let rows = sqlx::query(
            "SELECT id, start_time_ns FROM segments WHERE channel_no = $1 AND (start_time_ns, id) > ($2, $3)
             ORDER BY start_time_ns, id LIMIT $4",
        )
        .bind(channel.channel_no)
        .bind(after_ns)
        .bind(after_id)
        .bind(i64::from(limit))
        .fetch_all(&mut *commit.transaction)
        .await?;
        let being_made = channel
            .next_analysis
            .as_ref()
            .map_or(channel.analysis_generation, |(generation, _)| *generation);
        for row in &rows {
            let id: String = get(row, "id")?;
            sqlx::query("DELETE FROM analyses WHERE segment_id = $1 AND generation <> $2 AND generation <> $3")
                .bind(id.as_str())
                .bind(channel.analysis_generation)
                .bind(being_made)
                .execute(&mut *commit.transaction)
                .await?;
            for table in ["wear_estimates", "wear_posteriors"] {
                let text = format!("DELETE FROM {table} WHERE segment_id = $1 AND generation <> $2");
                sqlx::query(sqlx::AssertSqlSafe(text))
                    .bind(id.as_str())
                    .bind(channel.wear_generation)
                    .execute(&mut *commit.transaction)
                    .await?;
            }
        }
        let next = match rows.last() {
            Some(row) if rows.len() as u64 >= u64::from(limit) => Some(SegmentKey {
                start_time: super::rows::get_time(row, "start_time_ns")?,
                id: SegmentId(get(row, "id")?),
            }),
            _ => {
                sqlx::query("DELETE FROM fold_states WHERE channel_no = $1 AND generation <> $2")
                    .bind(channel.channel_no)
                    .bind(channel.wear_generation)
                    .execute(&mut *commit.transaction)
                    .await?;
                channel.leftovers = false;
                commit.set_channel(&mut channel, false).await?;
                None
            }
        };
        commit.finish().await?;
        Ok(next)
    }
}
