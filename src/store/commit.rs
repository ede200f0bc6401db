//! Writing: one transaction for segments, analyses, estimates and the states of the fold.

use jiff::Timestamp;
use sqlx::{Any, AssertSqlSafe, Transaction};

use super::assets::{asset_of, channel_of};
use super::fold_states::FoldState;
use super::rows::{doubles_to_bytes, finite, finite_or_none, to_json, to_ns};
use super::schema::Dialect;
use super::{Analysed, Asset, ChannelSummary, NewSegment, RunResult, SegmentKey, Store, StoreError};
use crate::asset::{AssetId, SegmentId};
use crate::estimate::WearEstimate;

/// Rows written by one statement, where there are many.
const ROWS_AT_ONCE: usize = 32;

/// A transaction on any number of channels. Nothing is stored before [`finish`](Self::finish) returns; then all is, on the disk.
///
/// Where other processes write as well, rows are locked in this order, so that transactions do not wait for each other in a ring: assets by
/// name, then channels by asset and name, then what hangs on them.
pub struct Commit {
    pub(super) transaction: Transaction<'static, Any>,
    pub(super) dialect: Dialect,
}

impl Store {
    /// Begins a transaction; waits for a connection that writes.
    pub async fn begin(&self) -> Result<Commit, StoreError> {
        Ok(Commit {
            transaction: self.write().begin().await?,
            dialect: self.dialect(),
        })
    }
}

impl Commit {
    /// An asset whose description and events stay as they are until the transaction's end.
    ///
    /// Error: [`StoreError::AssetUnknown`] where it is gone.
    pub async fn asset(&mut self, id: &AssetId) -> Result<Asset, StoreError> {
        let text = format!("SELECT * FROM assets WHERE id = $1{}", self.dialect.to_rest_on());
        self.one_asset(id, text).await
    }

    /// An asset that nobody else changes, and that no channel is added to, before the transaction's end; it counts as changed.
    ///
    /// Error: [`StoreError::AssetUnknown`] where it is gone.
    pub(super) async fn asset_to_change(&mut self, id: &AssetId) -> Result<Asset, StoreError> {
        // Before the asset: so do all that change assets, and those that change several do not wait for each other in a ring.
        sqlx::query("UPDATE counters SET value = value + 1 WHERE name = 'asset_revision'")
            .execute(&mut *self.transaction)
            .await?;
        let text = format!("SELECT * FROM assets WHERE id = $1{}", self.dialect.to_change());
        let asset = self.one_asset(id, text).await?;
        sqlx::query("UPDATE assets SET revision = (SELECT value FROM counters WHERE name = 'asset_revision') WHERE id = $1")
            .bind(id.as_str())
            .execute(&mut *self.transaction)
            .await?;
        Ok(asset)
    }

    async fn one_asset(&mut self, id: &AssetId, text: String) -> Result<Asset, StoreError> {
        let row = sqlx::query(AssertSqlSafe(text))
            .bind(id.as_str())
            .fetch_optional(&mut *self.transaction)
            .await?;
        let row = row.ok_or_else(|| StoreError::AssetUnknown(id.clone()))?;
        asset_of(&row)
    }

    /// The channel of that name of an asset that is there, made where it is missing. Nobody else changes it before the transaction's end.
    pub async fn channel(&mut self, asset: &AssetId, channel: &str) -> Result<ChannelSummary, StoreError> {
        let find = format!(
            "SELECT * FROM channels WHERE asset_id = $1 AND name = $2{}",
            self.dialect.to_change()
        );
        let found = sqlx::query(AssertSqlSafe(find.clone()))
            .bind(asset.as_str())
            .bind(channel)
            .fetch_optional(&mut *self.transaction)
            .await?;
        if let Some(row) = found {
            return channel_of(&row);
        }
        sqlx::query("UPDATE counters SET value = value + 1 WHERE name = 'channel_no'")
            .execute(&mut *self.transaction)
            .await?;
        // Where another process has made it meanwhile, it is that one.
        sqlx::query(
            "INSERT INTO channels (channel_no, asset_id, name, segments, revision, rewritten_revision)
             SELECT value, $1, $2, 0, 0, 0 FROM counters WHERE name = 'channel_no'
             ON CONFLICT (asset_id, name) DO NOTHING",
        )
        .bind(asset.as_str())
        .bind(channel)
        .execute(&mut *self.transaction)
        .await?;
        let row = sqlx::query(AssertSqlSafe(find))
            .bind(asset.as_str())
            .bind(channel)
            .fetch_one(&mut *self.transaction)
            .await?;
        channel_of(&row)
    }

    /// A channel that was there a moment ago, as it is now. Nobody else changes it before the transaction's end.
    ///
    /// Error: [`StoreError::AssetUnknown`] where it is gone with its asset.
    pub async fn channel_again(&mut self, channel: &ChannelSummary) -> Result<ChannelSummary, StoreError> {
        let text = format!("SELECT * FROM channels WHERE channel_no = $1{}", self.dialect.to_change());
        let row = sqlx::query(AssertSqlSafe(text))
            .bind(channel.channel_no)
            .fetch_optional(&mut *self.transaction)
            .await?;
        let gone = || StoreError::AssetUnknown(channel.asset_id.clone());
        channel_of(&row.ok_or_else(gone)?)
    }

    /// Adds a segment with its analysis, without its estimate, and brings the channel's summary up to date.
    pub async fn insert(&mut self, channel: &mut ChannelSummary, segment: &NewSegment) -> Result<(), StoreError> {
        let id = segment.id.0.as_str();
        let start_ns = to_ns(segment.start_time)?;
        let raw_bytes = i64::try_from(segment.raw.bytes).unwrap_or(i64::MAX);
        sqlx::query(
            "INSERT INTO segments (id, channel_no, start_time_ns, received_at_ns, sample_rate_hz, samples, unit, operating_point,
                reference_wear_um, raw_sha256, raw_bytes, raw_media_type, raw_channel_index)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13)",
        )
        .bind(id)
        .bind(channel.channel_no)
        .bind(start_ns)
        .bind(to_ns(segment.received_at)?)
        .bind(finite("sample_rate_hz", segment.sample_rate_hz)?)
        .bind(i64::try_from(segment.samples).unwrap_or(i64::MAX))
        .bind(segment.unit.as_str())
        .bind(to_json(&segment.operating_point, "operating_point", id)?)
        .bind(finite_or_none("reference_wear_um", segment.reference_wear_um)?)
        .bind(segment.raw.sha256.as_str())
        .bind(raw_bytes)
        .bind(segment.raw.media_type.as_str())
        .bind(i64::from(segment.raw.channel_index))
        .persistent(self.dialect.keeps_optional_doubles())
        .execute(&mut *self.transaction)
        .await?;
        self.insert_analysis(channel.analysis_generation, &segment.id, &segment.analysed)
            .await?;
        let counted = sqlx::query(
            "INSERT INTO raw_objects (sha256, asset_id, bytes, start_time_ns) VALUES ($1, $2, $3, $4)
             ON CONFLICT (sha256, asset_id) DO NOTHING",
        )
        .bind(segment.raw.sha256.as_str())
        .bind(segment.asset_id.as_str())
        .bind(raw_bytes)
        .bind(start_ns)
        .execute(&mut *self.transaction)
        .await?;
        if counted.rows_affected() > 0 {
            sqlx::query(
                "INSERT INTO raw_volumes (asset_id, bytes) VALUES ($1, $2)
                 ON CONFLICT (asset_id) DO UPDATE SET bytes = raw_volumes.bytes + excluded.bytes",
            )
            .bind(segment.asset_id.as_str())
            .bind(raw_bytes)
            .execute(&mut *self.transaction)
            .await?;
        }
        channel.note_change(segment.key());
        channel.segments += 1;
        if channel.first_start_time.is_none_or(|first| segment.start_time < first) {
            channel.first_start_time = Some(segment.start_time);
        }
        let last = channel.last_start_time.zip(channel.last_segment.as_ref());
        if last.is_none_or(|last| last < (segment.start_time, &segment.id)) {
            channel.last_start_time = Some(segment.start_time);
            channel.last_segment = Some(segment.id.clone());
        }
        Ok(())
    }

    /// Adds what a segment says by itself, under a generation.
    pub(super) async fn insert_analysis(&mut self, generation: i64, segment: &SegmentId, analysed: &Analysed) -> Result<(), StoreError> {
        let id = segment.0.as_str();
        for (name, value) in &analysed.indicators.values {
            finite(&format!("indicator {name} of segment {id}"), *value)?;
        }
        for (name, value) in &analysed.features.values {
            finite(&format!("feature {name} of segment {id}"), *value)?;
        }
        let shaft_speed = analysed.shaft_speed.as_ref();
        sqlx::query(
            "INSERT INTO analyses (segment_id, generation, analysis_key, feature_key, shaft_speed, basis, indicators, features)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8) ON CONFLICT (segment_id, generation) DO NOTHING",
        )
        .bind(id)
        .bind(generation)
        .bind(&*analysed.keys.analysis)
        .bind(&*analysed.keys.feature)
        .bind(shaft_speed.map(|speed| to_json(speed, "shaft_speed", id)).transpose()?)
        .bind(to_json(&analysed.basis, "basis", id)?)
        .bind(to_json(&analysed.indicators, "indicators", id)?)
        .bind(to_json(&analysed.features, "features", id)?)
        .execute(&mut *self.transaction)
        .await?;
        Ok(())
    }

    /// Sets the estimates of segments, the first ones or new ones, in the generation that is served.
    pub async fn set_wears(&mut self, channel: &ChannelSummary, wears: &[(SegmentKey, RunResult)]) -> Result<(), StoreError> {
        self.set_wears_in(channel.wear_generation, wears).await
    }

    /// Sets the estimates of segments in a generation.
    pub(super) async fn set_wears_in(&mut self, generation: i64, wears: &[(SegmentKey, RunResult)]) -> Result<(), StoreError> {
        for chunk in wears.chunks(ROWS_AT_ONCE) {
            self.set_estimates(generation, chunk).await?;
            let with: Vec<_> = chunk
                .iter()
                .filter_map(|(key, result)| result.wear.posterior.as_ref().map(|posterior| (key, posterior)))
                .collect();
            if !with.is_empty() {
                let text = format!(
                    "INSERT INTO wear_posteriors (segment_id, generation, wear_um, probability) VALUES {}
                     ON CONFLICT (segment_id, generation) DO UPDATE SET wear_um = excluded.wear_um, probability = excluded.probability",
                    rows_of_placeholders(with.len(), 4)
                );
                let mut query = sqlx::query(AssertSqlSafe(text));
                for (key, posterior) in with {
                    query = query
                        .bind(key.id.0.as_str())
                        .bind(generation)
                        .bind(doubles_to_bytes(&posterior.wear_um))
                        .bind(doubles_to_bytes(&posterior.probability));
                }
                query.execute(&mut *self.transaction).await?;
            }
            for (key, _) in chunk.iter().filter(|(_, result)| result.wear.posterior.is_none()) {
                sqlx::query("DELETE FROM wear_posteriors WHERE segment_id = $1 AND generation = $2")
                    .bind(key.id.0.as_str())
                    .bind(generation)
                    .execute(&mut *self.transaction)
                    .await?;
            }
        }
        Ok(())
    }

    async fn set_estimates(&mut self, generation: i64, wears: &[(SegmentKey, RunResult)]) -> Result<(), StoreError> {
        let text = format!(
            "INSERT INTO wear_estimates (segment_id, generation, status, reason, median_um, mean_um, p05_um, p25_um, p75_um, p95_um, log_evidence,
                estimate, run_indicators)
             VALUES {}
             ON CONFLICT (segment_id, generation) DO UPDATE SET status = excluded.status, reason = excluded.reason,
                median_um = excluded.median_um, mean_um = excluded.mean_um, p05_um = excluded.p05_um, p25_um = excluded.p25_um,
                p75_um = excluded.p75_um, p95_um = excluded.p95_um, log_evidence = excluded.log_evidence, estimate = excluded.estimate, run_indicators = excluded.run_indicators",
            rows_of_placeholders(wears.len(), 13)
        );
        let mut query = sqlx::query(AssertSqlSafe(text));
        for (key, RunResult { indicators, wear }) in wears {
            let id = key.id.0.as_str();
            for (name, value) in &indicators.values {
                finite(&format!("indicator {name} of segment {id}"), *value)?;
            }
            let without_posterior = WearEstimate {
                posterior: None,
                ..wear.clone()
            };
            let status = to_json(&wear.status, "status", id)?;
            query = query
                .bind(id)
                .bind(generation)
                .bind(status.trim_matches('"').to_owned())
                .bind(wear.reason.as_str())
                .bind(finite_or_none("median_um", wear.median_um)?)
                .bind(finite_or_none("mean_um", wear.mean_um)?)
                .bind(finite_or_none("p05_um", wear.p05_um)?)
                .bind(finite_or_none("p25_um", wear.p25_um)?)
                .bind(finite_or_none("p75_um", wear.p75_um)?)
                .bind(finite_or_none("p95_um", wear.p95_um)?)
                .bind(finite_or_none("log_evidence", wear.log_evidence)?)
                .bind(to_json(&without_posterior, "estimate", id)?)
                .bind(to_json(indicators, "run_indicators", id)?);
        }
        query
            .persistent(self.dialect.keeps_optional_doubles())
            .execute(&mut *self.transaction)
            .await?;
        Ok(())
    }

    /// Sets states of the fold in the generation that is served: those after position `after` are replaced by `states`, in rising
    /// order, the newest last.
    pub async fn set_states(&mut self, channel: &ChannelSummary, after: u64, states: &[FoldState]) -> Result<(), StoreError> {
        self.set_states_in(channel, channel.wear_generation, after, states).await
    }

    /// Sets a channel's summary; `rewritten` says that estimates of earlier segments changed.
    pub async fn set_channel(&mut self, channel: &mut ChannelSummary, rewritten: bool) -> Result<(), StoreError> {
        channel.revision += 1;
        if rewritten {
            channel.rewritten_revision = channel.revision;
        }
        let optional_ns = |time: Option<Timestamp>| time.map(to_ns).transpose();
        sqlx::query(
            "UPDATE channels SET segments = $2, first_start_ns = $3, last_start_ns = $4, last_segment_id = $5, revision = $6,
                rewritten_revision = $7, analysis_generation = $8, wear_generation = $9, newest_generation = $10, analysis_key = $11,
                feature_key = $12, fold_key = $13, must_fold = $14, leftovers = $15, next_analysis_generation = $16,
                next_analysis_key = $17, next_wear_generation = $18, maker_until_ns = $19, changed_from_ns = $20, changed_from_id = $21
             WHERE channel_no = $1",
        )
        .bind(channel.channel_no)
        .bind(i64::try_from(channel.segments).unwrap_or(i64::MAX))
        .bind(optional_ns(channel.first_start_time)?)
        .bind(optional_ns(channel.last_start_time)?)
        .bind(channel.last_segment.as_ref().map(|id| id.0.as_str()))
        .bind(channel.revision)
        .bind(channel.rewritten_revision)
        .bind(channel.analysis_generation)
        .bind(channel.wear_generation)
        .bind(channel.newest_generation)
        .bind(&*channel.keys.analysed.analysis)
        .bind(&*channel.keys.analysed.feature)
        .bind(channel.keys.fold.as_str())
        .bind(i64::from(channel.must_fold))
        .bind(i64::from(channel.leftovers))
        .bind(channel.next_analysis.as_ref().map(|(generation, _)| *generation))
        .bind(channel.next_analysis.as_ref().map(|(_, key)| key.as_str()))
        .bind(channel.next_wear)
        .bind(optional_ns(channel.maker_until)?)
        .bind(optional_ns(channel.changed_from.as_ref().map(|key| key.start_time))?)
        .bind(channel.changed_from.as_ref().map(|key| key.id.0.as_str()))
        .execute(&mut *self.transaction)
        .await?;
        Ok(())
    }

    /// Makes everything of this transaction permanent.
    pub async fn finish(self) -> Result<(), StoreError> {
        Ok(self.transaction.commit().await?)
    }
}

/// `($1, $2), ($3, $4), …`: `rows` rows of `columns` values.
fn rows_of_placeholders(rows: usize, columns: usize) -> String {
    let row = |n: usize| format!("({})", super::rows::placeholders(n * columns + 1, columns));
    (0..rows).map(row).collect::<Vec<_>>().join(", ")
}
