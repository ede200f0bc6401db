//! Generations of a history: a recomputed history is written beside the served one and replaces it as a
//! whole.
//!
//! Analyses and estimates carry a generation number, and a channel says which of each is served. A new
//! generation is written in small transactions that are not visible to readers; a last transaction sets the
//! channel's numbers, and the rows of the old generation are removed later.
//!
//! Several processes may try to recompute the same history. A channel says which generation of estimates is
//! being written, and only that one can be added to and served: it acts as a fencing token, so that a process
//! whose lease has expired changes nothing.

use jiff::{SignedDuration, Timestamp};

use super::fold_states::FoldState;
use super::wear_rows::WearRow;
use crate::asset::SegmentId;
use crate::store::commit::Commit;
use crate::store::database::rows::{get, get_time, lease_end, to_ns};
use crate::store::records::segments::new_segment_of;
use crate::store::{
    AlarmNotice, Analysed, AnalysisKeys, ChannelKeys, ChannelSummary, FoldedAlarms, NewSegment, RunResult,
    SegmentKey, Store, StoreError,
};

/// Time after its last write for which the process that writes a generation counts as alive; then another one
/// may take over.
const LEASE: SignedDuration = SignedDuration::from_secs(60);

/// The error for a process that lost its generation to another one.
const LEASE_LOST: StoreError = StoreError::Outdated("the generation being written");

/// A generation of a channel's analyses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AnalysisGeneration(pub(in crate::store) i64);

/// A generation of a channel's estimates; its holder recomputes the channel's history.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WearGeneration(pub(in crate::store) i64);

/// The versions of the inputs of a history: it is served only if they are still current.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GenerationInputs {
    /// [`Asset::version`](crate::store::Asset::version).
    pub asset: i64,
    /// [`ChannelSummary::version`].
    pub channel: (i64, i64),
}

impl ChannelSummary {
    /// The served generation of analyses.
    pub fn served_analyses(&self) -> AnalysisGeneration {
        AnalysisGeneration(self.analysis_generation)
    }

    /// The served generation of estimates.
    pub fn served_wear(&self) -> WearGeneration {
        WearGeneration(self.wear_generation)
    }
}

impl Store {
    /// Starts a new generation of a channel's estimates; returns `None` if another process is writing one.
    pub async fn begin_generation(
        &self,
        channel: &ChannelSummary,
        now: Timestamp,
    ) -> Result<Option<WearGeneration>, StoreError> {
        let now = self.now(now).await?;
        let mut commit = self.begin().await?;
        let mut channel = commit.channel_again(channel).await?;
        let is_leased_elsewhere =
            channel.next_wear.is_some() && channel.maker_until.is_some_and(|until| now < until);
        // A process that is alone on its store writes no other generation of the channel.
        if is_leased_elsewhere && self.is_shared() {
            return Ok(None);
        }
        channel.newest_generation += 1;
        // Until it is served, its rows count as leftovers.
        channel.leftovers = true;
        channel.next_wear = Some(channel.newest_generation);
        channel.maker_until = Some(lease_end(now, LEASE));
        channel.changed_from = None;
        commit.set_channel(&mut channel, false).await?;
        commit.finish().await?;
        Ok(Some(WearGeneration(channel.newest_generation)))
    }

    /// Abandons a generation, so that another process need not wait. Its estimates become leftovers, and its
    /// analyses too unless they are kept for the next one.
    pub async fn abandon_generation(
        &self,
        channel: &ChannelSummary,
        wear: WearGeneration,
        keeps_analyses: bool,
    ) -> Result<(), StoreError> {
        let mut commit = self.begin().await?;
        let mut channel = commit.channel_again(channel).await?;
        if channel.next_wear == Some(wear.0) {
            channel.next_wear = None;
            channel.maker_until = None;
            channel.changed_from = None;
            if !keeps_analyses {
                channel.next_analysis = None;
            }
            commit.set_channel(&mut channel, false).await?;
            commit.finish().await?;
        }
        Ok(())
    }

    /// Takes the earliest place where a channel's history changed since the generation was started, or since
    /// the last call, and reads the channel.
    ///
    /// Error: [`StoreError::Outdated`] if another process has taken over.
    pub async fn take_changes(
        &self,
        channel: &ChannelSummary,
        wear: WearGeneration,
    ) -> Result<(ChannelSummary, Option<SegmentKey>), StoreError> {
        let mut commit = self.begin().await?;
        let mut channel = commit.leased_channel(channel, wear).await?;
        let changed_from = channel.changed_from.take();
        if changed_from.is_some() {
            commit.set_channel(&mut channel, false).await?;
            commit.finish().await?;
        }
        Ok((channel, changed_from))
    }

    /// The generation of analyses being written under `keys`, or a new one; a generation under other keys is
    /// dropped.
    pub async fn next_analyses(
        &self,
        channel: &ChannelSummary,
        wear: WearGeneration,
        keys: &AnalysisKeys,
    ) -> Result<AnalysisGeneration, StoreError> {
        let mut commit = self.begin().await?;
        let mut channel = commit.leased_channel(channel, wear).await?;
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

    /// Up to `limit` segments of a channel after `after` that have no analysis in a generation, in the order
    /// of time.
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
            "SELECT s.*, c.asset_id, c.name AS channel, a.analysis_key, a.feature_key, a.shaft_speed, a.basis, a.indicator_values, a.feature_values
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
        let layouts = self.layouts().of(&rows, &["indicator_values", "feature_values"], self.read()).await?;
        rows.iter().map(|row| new_segment_of(row, &layouts)).collect()
    }

    /// Adds analyses to a generation.
    ///
    /// Error: [`StoreError::Outdated`] if another process has taken over.
    pub async fn add_analyses(
        &self,
        channel: &ChannelSummary,
        wear: WearGeneration,
        generation: AnalysisGeneration,
        analyses: &[(SegmentId, Analysed)],
        now: Timestamp,
    ) -> Result<(), StoreError> {
        let now = self.now(now).await?;
        let mut commit = self.begin().await?;
        let channel = commit.leased_channel(channel, wear).await?;
        let analyses = analyses.iter().map(|(segment, analysed)| (generation.0, segment, analysed));
        commit.insert_analyses(&analyses.collect::<Vec<_>>()).await?;
        commit.renew_lease(&channel, now).await?;
        commit.finish().await
    }

    /// Adds estimates to a generation, with states of the fold after position `after`.
    ///
    /// Error: [`StoreError::Outdated`] if another process has taken over.
    pub async fn add_wears(
        &self,
        channel: &ChannelSummary,
        generation: WearGeneration,
        wears: &[(SegmentKey, RunResult)],
        (after, states): (u64, &[FoldState]),
        now: Timestamp,
    ) -> Result<(), StoreError> {
        let now = self.now(now).await?;
        let mut commit = self.begin().await?;
        let channel = commit.leased_channel(channel, generation).await?;
        let wears = wears.iter().map(|(key, result)| WearRow {
            generation: generation.0,
            segment: &key.id,
            result,
            is_first: false,
        });
        commit.set_wears(&wears.collect::<Vec<_>>()).await?;
        commit.set_states(&[(channel.channel_no, generation.0, after, states)]).await?;
        commit.renew_lease(&channel, now).await?;
        commit.finish().await
    }

    /// Makes these generations the served ones, with the alarms folded with them; both must have every
    /// segment of the channel. Returns the notices of changed alarms.
    ///
    /// Error: [`StoreError::Outdated`] if another process has taken over, or if the inputs have changed.
    pub async fn serve(
        &self,
        channel: &ChannelSummary,
        from: GenerationInputs,
        (analyses, wear): (AnalysisGeneration, WearGeneration),
        keys: ChannelKeys,
        alarms: FoldedAlarms<'_>,
        now: Timestamp,
    ) -> Result<Vec<AlarmNotice>, StoreError> {
        let mut commit = self.begin().await?;
        if commit.asset(&channel.asset_id).await?.version() != from.asset {
            return Err(StoreError::Outdated("the asset's description"));
        }
        let mut channel = commit.leased_channel(channel, wear).await?;
        if channel.version() != from.channel {
            return Err(StoreError::Outdated("the channel"));
        }
        channel.next_wear = None;
        channel.maker_until = None;
        channel.changed_from = None;
        channel.analysis_generation = analyses.0;
        channel.wear_generation = wear.0;
        if channel.next_analysis.as_ref().is_some_and(|(generation, _)| *generation == analyses.0) {
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

    /// Removes the rows of generations that are neither served nor being written, of up to `limit` segments
    /// after `after`. Returns where to continue; `None` at the end, or if another process is writing a
    /// generation.
    pub async fn remove_leftovers(
        &self,
        channel: &ChannelSummary,
        after: Option<&SegmentKey>,
        limit: u32,
        now: Timestamp,
    ) -> Result<Option<SegmentKey>, StoreError> {
        let now = self.now(now).await?;
        let mut commit = self.begin().await?;
        let mut channel = commit.channel_again(channel).await?;
        if self.is_shared()
            && channel.next_wear.is_some()
            && channel.maker_until.is_some_and(|until| now < until)
        {
            return Ok(None);
        }
        // The lease of its writer has expired: should it still run, its next write fails.
        channel.next_wear = None;
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
        let being_made =
            channel.next_analysis.as_ref().map_or(channel.analysis_generation, |(generation, _)| *generation);
        for row in &rows {
            let id: String = get(row, "id")?;
            sqlx::query(
                "DELETE FROM analyses WHERE segment_id = $1 AND generation <> $2 AND generation <> $3",
            )
            .bind(id.as_str())
            .bind(channel.analysis_generation)
            .bind(being_made)
            .execute(&mut *commit.transaction)
            .await?;
            for table in ["wear_estimates", "wear_posteriors"] {
                let text = format!("DELETE FROM {table} WHERE segment_id = $1 AND generation <> $2");
                sqlx::query(&text)
                    .bind(id.as_str())
                    .bind(channel.wear_generation)
                    .execute(&mut *commit.transaction)
                    .await?;
            }
        }
        let next = match rows.last() {
            Some(row) if rows.len() as u64 >= u64::from(limit) => {
                commit.set_channel(&mut channel, false).await?;
                Some(SegmentKey {
                    start_time: get_time(row, "start_time_ns")?,
                    id: SegmentId(get(row, "id")?),
                })
            }
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

impl Commit {
    /// Reads and locks a channel; returns an error if this generation is not the one being written.
    async fn leased_channel(
        &mut self,
        channel: &ChannelSummary,
        wear: WearGeneration,
    ) -> Result<ChannelSummary, StoreError> {
        let channel = self.channel_again(channel).await?;
        if channel.next_wear == Some(wear.0) { Ok(channel) } else { Err(LEASE_LOST) }
    }

    /// Renews the lease of the process that writes a generation of a channel.
    async fn renew_lease(&mut self, channel: &ChannelSummary, now: Timestamp) -> Result<(), StoreError> {
        sqlx::query("UPDATE channels SET maker_until_ns = $2 WHERE channel_no = $1")
            .bind(channel.channel_no)
            .bind(to_ns(lease_end(now, LEASE))?)
            .execute(&mut *self.transaction)
            .await?;
        Ok(())
    }
}
