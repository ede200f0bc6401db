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

use super::fold_states::StoredFoldState;
use super::wear_rows::WearRow;
use crate::asset::SegmentId;
use crate::store::database::rows::{get, get_time, lease_end, to_ns};
use crate::store::records::segments::new_segment_of;
use crate::store::transaction::Transaction;
use crate::store::{
    AlarmNotice, Analysed, AnalysisKeys, ChannelKeys, ChannelSummary, FoldedAlarms, NewSegment, RunResult,
    SegmentKey, Store, StoreError,
};

/// Length of the lease of the process that writes a generation, from its last renewal. Once it expires,
/// another process may take over.
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
        let mut transaction = self.begin().await?;
        let mut channel = transaction.lock_channel(channel).await?;
        let is_leased_elsewhere =
            channel.next_wear.is_some() && channel.writer_lease_until.is_some_and(|until| now < until);
        // A process that is alone on its store writes no other generation of the channel.
        if is_leased_elsewhere && self.is_shared() {
            return Ok(None);
        }
        channel.newest_generation += 1;
        // Until it is served, its rows count as leftovers.
        channel.leftovers = true;
        channel.next_wear = Some(channel.newest_generation);
        channel.writer_lease_until = Some(lease_end(now, LEASE));
        channel.changed_from = None;
        transaction.set_channel(&mut channel, false).await?;
        transaction.commit().await?;
        Ok(Some(WearGeneration(channel.newest_generation)))
    }

    /// Renews the lease of the process that writes a generation. To be called while records are analysed and
    /// folded: one batch can take longer than the lease.
    ///
    /// # Errors
    /// [`StoreError::Outdated`] if another process has taken over.
    pub async fn renew_generation(
        &self,
        channel: &ChannelSummary,
        wear: WearGeneration,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        let now = self.now(now).await?;
        let renewed = sqlx::query(
            "UPDATE channels SET maker_until_ns = $3 WHERE channel_no = $1 AND next_wear_generation = $2",
        )
        .bind(channel.channel_no)
        .bind(wear.0)
        .bind(to_ns(lease_end(now, LEASE))?)
        .execute(self.write()?)
        .await?;
        if renewed.rows_affected() > 0 { Ok(()) } else { Err(LEASE_LOST) }
    }

    /// Abandons a generation, so that another process need not wait. Its estimates become leftovers, and its
    /// analyses too unless they are kept for the next one.
    pub async fn abandon_generation(
        &self,
        channel: &ChannelSummary,
        wear: WearGeneration,
        keeps_analyses: bool,
    ) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        let mut channel = transaction.lock_channel(channel).await?;
        if channel.next_wear == Some(wear.0) {
            channel.next_wear = None;
            channel.writer_lease_until = None;
            channel.changed_from = None;
            if !keeps_analyses {
                channel.next_analysis = None;
            }
            transaction.set_channel(&mut channel, false).await?;
            transaction.commit().await?;
        }
        Ok(())
    }

    /// Takes the earliest place where a channel's history changed since the generation was started, or since
    /// the last call, and reads the channel.
    ///
    /// # Errors
    /// [`StoreError::Outdated`] if another process has taken over.
    pub async fn take_changes(
        &self,
        channel: &ChannelSummary,
        wear: WearGeneration,
    ) -> Result<(ChannelSummary, Option<SegmentKey>), StoreError> {
        let mut transaction = self.begin().await?;
        let mut channel = transaction.lock_leased_channel(channel, wear).await?;
        let changed_from = channel.changed_from.take();
        if changed_from.is_some() {
            transaction.set_channel(&mut channel, false).await?;
            transaction.commit().await?;
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
        let mut transaction = self.begin().await?;
        let mut channel = transaction.lock_leased_channel(channel, wear).await?;
        if let Some((generation, key)) = &channel.next_analysis
            && **key == *keys.analysis
        {
            return Ok(AnalysisGeneration(*generation));
        }
        channel.newest_generation += 1;
        channel.leftovers |= channel.next_analysis.is_some();
        let generation = channel.newest_generation;
        channel.next_analysis = Some((generation, keys.analysis.to_string()));
        transaction.set_channel(&mut channel, false).await?;
        transaction.commit().await?;
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
        let (after_ns, after_id) = SegmentKey::bound(after, i64::MIN)?;
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
        let layouts =
            self.layouts().load(&rows, &["indicator_values", "feature_values"], self.read()).await?;
        rows.iter().map(|row| new_segment_of(row, &layouts)).collect()
    }

    /// Adds analyses to a generation.
    ///
    /// # Errors
    /// [`StoreError::Outdated`] if another process has taken over.
    pub async fn add_analyses(
        &self,
        channel: &ChannelSummary,
        wear: WearGeneration,
        generation: AnalysisGeneration,
        analyses: &[(SegmentId, Analysed)],
    ) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        transaction.lock_leased_channel(channel, wear).await?;
        let analyses = analyses.iter().map(|(segment, analysed)| (generation.0, segment, analysed));
        transaction.insert_analyses(&analyses.collect::<Vec<_>>()).await?;
        transaction.commit().await
    }

    /// Adds estimates to a generation, with states of the fold after position `after`.
    ///
    /// # Errors
    /// [`StoreError::Outdated`] if another process has taken over.
    pub async fn add_wears(
        &self,
        channel: &ChannelSummary,
        generation: WearGeneration,
        wears: &[(SegmentKey, RunResult)],
        (after, states): (u64, &[StoredFoldState]),
    ) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        let channel = transaction.lock_leased_channel(channel, generation).await?;
        let wears = wears.iter().map(|(key, result)| WearRow {
            generation: generation.0,
            segment: &key.id,
            result,
            is_first: false,
        });
        transaction.set_wears(&wears.collect::<Vec<_>>()).await?;
        transaction.set_states(&[(channel.channel_no, generation.0, after, states)]).await?;
        transaction.commit().await
    }

    /// Makes these generations the served ones, with the alarms folded with them; both must have every
    /// segment of the channel. Returns the notices of changed alarms.
    ///
    /// # Errors
    /// [`StoreError::Outdated`] if another process has taken over, or if the inputs have changed.
    pub async fn serve(
        &self,
        channel: &ChannelSummary,
        from: GenerationInputs,
        (analyses, wear): (AnalysisGeneration, WearGeneration),
        keys: ChannelKeys,
        alarms: FoldedAlarms<'_>,
        now: Timestamp,
    ) -> Result<Vec<AlarmNotice>, StoreError> {
        let mut transaction = self.begin().await?;
        if transaction.asset(&channel.asset_id).await?.version() != from.asset {
            return Err(StoreError::Outdated("the asset's description"));
        }
        let mut channel = transaction.lock_leased_channel(channel, wear).await?;
        if channel.version() != from.channel {
            return Err(StoreError::Outdated("the channel"));
        }
        channel.next_wear = None;
        channel.writer_lease_until = None;
        channel.changed_from = None;
        channel.analysis_generation = analyses.0;
        channel.wear_generation = wear.0;
        if channel.next_analysis.as_ref().is_some_and(|(generation, _)| *generation == analyses.0) {
            channel.next_analysis = None;
        }
        channel.keys = keys;
        channel.must_fold = false;
        channel.leftovers = true;
        transaction.set_channel(&mut channel, true).await?;
        let notices = transaction.set_alarms(&channel, alarms, now).await?;
        transaction.commit().await?;
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
        let mut transaction = self.begin().await?;
        let mut channel = transaction.lock_channel(channel).await?;
        if self.is_shared()
            && channel.next_wear.is_some()
            && channel.writer_lease_until.is_some_and(|until| now < until)
        {
            return Ok(None);
        }
        // The lease of its writer has expired: should it still run, its next write fails.
        channel.next_wear = None;
        let (after_ns, after_id) = SegmentKey::bound(after, i64::MIN)?;
        let rows = sqlx::query(
            "SELECT id, start_time_ns FROM segments WHERE channel_no = $1 AND (start_time_ns, id) > ($2, $3)
             ORDER BY start_time_ns, id LIMIT $4",
        )
        .bind(channel.channel_no)
        .bind(after_ns)
        .bind(after_id)
        .bind(i64::from(limit))
        .fetch_all(&mut *transaction.inner)
        .await?;
        let being_made =
            channel.next_analysis.as_ref().map_or(channel.analysis_generation, |(generation, _)| *generation);
        let last = rows.last().map(|row| -> Result<SegmentKey, StoreError> {
            Ok(SegmentKey { start_time: get_time(row, "start_time_ns")?, id: SegmentId(get(row, "id")?) })
        });
        let last = last.transpose()?;
        let (last_ns, last_id) = SegmentKey::bound(last.as_ref(), i64::MIN)?;
        for (table, kept) in [
            ("analyses", [channel.analysis_generation, being_made]),
            ("wear_estimates", [channel.wear_generation; 2]),
            ("wear_posteriors", [channel.wear_generation; 2]),
        ] {
            let text = format!(
                "DELETE FROM {table} WHERE generation NOT IN ($1, $2) AND segment_id IN (
                    SELECT id FROM segments WHERE channel_no = $3
                        AND (start_time_ns, id) > ($4, $5) AND (start_time_ns, id) <= ($6, $7)
                 )"
            );
            sqlx::query(&text)
                .bind(kept[0])
                .bind(kept[1])
                .bind(channel.channel_no)
                .bind(after_ns)
                .bind(after_id)
                .bind(last_ns)
                .bind(last_id)
                .execute(&mut *transaction.inner)
                .await?;
        }
        let next = last.filter(|_| rows.len() as u64 >= u64::from(limit));
        if next.is_none() {
            sqlx::query("DELETE FROM fold_states WHERE channel_no = $1 AND generation <> $2")
                .bind(channel.channel_no)
                .bind(channel.wear_generation)
                .execute(&mut *transaction.inner)
                .await?;
            channel.leftovers = false;
        }
        transaction.set_channel(&mut channel, false).await?;
        transaction.commit().await?;
        Ok(next)
    }
}

impl Transaction {
    /// Reads and locks a channel; returns an error if this generation is not the one being written.
    async fn lock_leased_channel(
        &mut self,
        channel: &ChannelSummary,
        wear: WearGeneration,
    ) -> Result<ChannelSummary, StoreError> {
        let channel = self.lock_channel(channel).await?;
        if channel.next_wear == Some(wear.0) { Ok(channel) } else { Err(LEASE_LOST) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::AssetId;

    /// A store with a channel of five segments that has rows of four generations, of which 1 is served.
    async fn with_leftovers(folder: &std::path::Path) -> (Store, ChannelSummary) {
        let store = Store::open(&folder.into()).await.unwrap();
        let write = store.write().unwrap();
        for text in [
            r#"INSERT INTO assets (id, spec, created_at_ns, updated_at_ns) VALUES ('pump', '{"id":"pump"}', 0, 0)"#,
            "INSERT INTO channels (channel_no, asset_id, name, segments, revision, rewritten_revision,
                analysis_generation, wear_generation, next_analysis_generation, next_analysis_key, leftovers)
             VALUES (1, 'pump', 'a', 5, 1, 1, 1, 1, 3, 'k', 1)",
        ] {
            sqlx::query(text).execute(write).await.unwrap();
        }
        for n in 0..5 {
            let text = format!(
                "INSERT INTO segments VALUES ('s{n}', 1, {n}, {n}, 20000.0, 4, 'g', '{{}}', NULL, 'h{n}', 8, 'audio/wav', 0, 0)"
            );
            sqlx::query(&text).execute(write).await.unwrap();
            for generation in 0..4 {
                for text in [
                    "INSERT INTO analyses VALUES ($1, $2, '', '', NULL, NULL, x'', x'')",
                    "INSERT INTO wear_estimates (segment_id, generation, status, reason, estimate) VALUES ($1, $2, '', '', '{}')",
                ] {
                    let query = sqlx::query(text).bind(format!("s{n}")).bind(i64::from(generation));
                    query.execute(write).await.unwrap();
                }
            }
        }
        let channel = store.channels(&AssetId::new("pump").unwrap()).await.unwrap().remove(0);
        (store, channel)
    }

    #[tokio::test]
    async fn leftovers_are_removed_in_batches() {
        let folder = tempfile::tempdir().unwrap();
        let (store, channel) = with_leftovers(folder.path()).await;
        let generations = async |table: &str| {
            let text = format!("SELECT segment_id, generation FROM {table} ORDER BY segment_id, generation");
            let rows = sqlx::query(&text).fetch_all(store.write().unwrap()).await.unwrap();
            let row =
                |row| (get::<String>(row, "segment_id").unwrap(), get::<i64>(row, "generation").unwrap());
            rows.iter().map(row).map(|(id, generation)| format!("{id}:{generation}")).collect::<Vec<_>>()
        };
        let now = Timestamp::UNIX_EPOCH;
        let after = store.remove_leftovers(&channel, None, 2, now).await.unwrap();
        assert_eq!(after.as_ref().unwrap().id.0, "s1");
        assert_eq!(generations("analyses").await.len(), 2 * 2 + 3 * 4);
        let after = store.remove_leftovers(&channel, after.as_ref(), 2, now).await.unwrap();
        assert_eq!(store.remove_leftovers(&channel, after.as_ref(), 2, now).await.unwrap(), None);
        let kept = |generations: &[i64]| -> Vec<String> {
            (0..5).flat_map(|n| generations.iter().map(move |of| format!("s{n}:{of}"))).collect()
        };
        assert_eq!(generations("analyses").await, kept(&[1, 3]));
        assert_eq!(generations("wear_estimates").await, kept(&[1]));
        assert!(!store.channels(&channel.asset_id).await.unwrap()[0].leftovers);
    }

    #[tokio::test]
    async fn only_the_process_that_writes_a_generation_renews_its_lease() {
        let folder = tempfile::tempdir().unwrap();
        let (store, channel) = with_leftovers(folder.path()).await;
        let start = Timestamp::UNIX_EPOCH;
        let first = store.begin_generation(&channel, start).await.unwrap().unwrap();
        store.renew_generation(&channel, first, start + LEASE).await.unwrap();
        let until = store.channels(&channel.asset_id).await.unwrap()[0].writer_lease_until;
        assert_eq!(until, Some(start + LEASE + LEASE));
        store.begin_generation(&channel, start + LEASE).await.unwrap().unwrap();
        let lost = store.renew_generation(&channel, first, start + LEASE).await.unwrap_err();
        assert!(lost.is_conflict(), "{lost}");
    }
}
