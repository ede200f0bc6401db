//! Writing segments: one transaction for records, estimates and the state of the fold.

use jiff::Timestamp;
use sqlx::{Any, Transaction};

use super::assets::channel_of;
use super::rows::{doubles_to_bytes, finite, finite_or_none, get, get_json, get_time, to_json, to_ns};
use super::{ChannelSummary, NewSegment, SegmentKey, Store, StoreError};
use crate::asset::{AssetId, SegmentId};
use crate::estimate::WearEstimate;
use crate::signal::Features;

/// How far the wear estimate of a channel has been folded.
#[derive(Debug, Clone, PartialEq)]
pub struct FoldState {
    /// Identifies everything but the features that the estimate depends on; a state under another key is worth nothing.
    pub fold_key: String,
    /// The tracker's state as JSON.
    pub state: String,
    /// The last segment that went in.
    pub last: SegmentKey,
}

/// A transaction on one or more channels. Nothing is stored before [`finish`](Self::finish) returns; then all is, on the disk.
pub struct Commit {
    transaction: Transaction<'static, Any>,
}

impl Store {
    /// Begins a transaction; waits for the one before to end.
    pub async fn begin(&self) -> Result<Commit, StoreError> {
        Ok(Commit {
            transaction: self.write().begin().await?,
        })
    }

    /// How far a channel has been folded, as last stored; none for a channel without records.
    pub async fn fold_state(&self, asset: &AssetId, channel: &str) -> Result<Option<FoldState>, StoreError> {
        let row = sqlx::query(
            "SELECT t.* FROM tracker_states t JOIN channels c ON c.channel_no = t.channel_no WHERE c.asset_id = $1 AND c.name = $2",
        )
        .bind(asset.as_str())
        .bind(channel)
        .fetch_optional(self.read())
        .await?;
        let Some(row) = row else { return Ok(None) };
        Ok(Some(FoldState {
            fold_key: get(&row, "fold_key")?,
            state: get(&row, "state")?,
            last: SegmentKey {
                start_time: get_time(&row, "last_start_ns")?,
                id: SegmentId(get(&row, "last_segment_id")?),
            },
        }))
    }
}

impl Commit {
    /// The channel of that name, made where it is missing.
    ///
    /// Error: [`StoreError::AssetUnknown`] where the asset is gone.
    pub async fn channel(&mut self, asset: &AssetId, channel: &str) -> Result<ChannelSummary, StoreError> {
        let known = sqlx::query("SELECT id FROM assets WHERE id = $1")
            .bind(asset.as_str())
            .fetch_optional(&mut *self.transaction)
            .await?;
        if known.is_none() {
            return Err(StoreError::AssetUnknown(asset.clone()));
        }
        let find = "SELECT * FROM channels WHERE asset_id = $1 AND name = $2";
        let found = sqlx::query(find)
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
        sqlx::query(
            "INSERT INTO channels (channel_no, asset_id, name, segments, revision, rewritten_revision)
             SELECT value, $1, $2, 0, 0, 0 FROM counters WHERE name = 'channel_no'",
        )
        .bind(asset.as_str())
        .bind(channel)
        .execute(&mut *self.transaction)
        .await?;
        let row = sqlx::query(find)
            .bind(asset.as_str())
            .bind(channel)
            .fetch_one(&mut *self.transaction)
            .await?;
        channel_of(&row)
    }

    /// Adds a segment, without its estimate, and brings the channel's summary up to date.
    pub async fn insert(&mut self, channel: &mut ChannelSummary, segment: &NewSegment) -> Result<(), StoreError> {
        let id = segment.id.0.as_str();
        for (name, value) in &segment.indicators.values {
            finite(&format!("indicator {name} of segment {id}"), *value)?;
        }
        for (name, value) in &segment.features.values {
            finite(&format!("feature {name} of segment {id}"), *value)?;
        }
        let start_ns = to_ns(segment.start_time)?;
        sqlx::query(
            "INSERT INTO segments (id, channel_no, start_time_ns, received_at_ns, sample_rate_hz, samples, unit, operating_point, shaft_speed,
                reference_wear_um, raw_sha256, raw_bytes, raw_media_type, raw_channel_index, indicators, features)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16)",
        )
        .bind(id)
        .bind(channel.channel_no)
        .bind(start_ns)
        .bind(to_ns(segment.received_at)?)
        .bind(finite("sample_rate_hz", segment.sample_rate_hz)?)
        .bind(i64::try_from(segment.samples).unwrap_or(i64::MAX))
        .bind(segment.unit.as_str())
        .bind(to_json(&segment.operating_point, "operating_point", id)?)
        .bind(segment.shaft_speed.as_ref().map(|speed| to_json(speed, "shaft_speed", id)).transpose()?)
        .bind(finite_or_none("reference_wear_um", segment.reference_wear_um)?)
        .bind(segment.raw.sha256.as_str())
        .bind(i64::try_from(segment.raw.bytes).unwrap_or(i64::MAX))
        .bind(segment.raw.media_type.as_str())
        .bind(i64::from(segment.raw.channel_index))
        .bind(to_json(&segment.indicators, "indicators", id)?)
        .bind(to_json(&segment.features, "features", id)?)
        .execute(&mut *self.transaction)
        .await?;
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

    /// Up to `limit` segments of a channel with their features, in the order of time, from the first one after `after`;
    /// those inserted in this transaction are among them.
    pub async fn features(
        &mut self,
        channel: &ChannelSummary,
        after: Option<&SegmentKey>,
        limit: u32,
    ) -> Result<Vec<(SegmentKey, Features)>, StoreError> {
        let (after_ns, after_id) = match after {
            Some(key) => (to_ns(key.start_time)?, key.id.0.as_str()),
            None => (i64::MIN, ""),
        };
        let rows = sqlx::query(
            "SELECT id, start_time_ns, features FROM segments WHERE channel_no = $1 AND (start_time_ns, id) > ($2, $3)
             ORDER BY start_time_ns, id LIMIT $4",
        )
        .bind(channel.channel_no)
        .bind(after_ns)
        .bind(after_id)
        .bind(i64::from(limit))
        .fetch_all(&mut *self.transaction)
        .await?;
        rows.iter()
            .map(|row| {
                let id: String = get(row, "id")?;
                let features = get_json(row, "features", &id)?;
                let key = SegmentKey {
                    start_time: get_time(row, "start_time_ns")?,
                    id: SegmentId(id),
                };
                Ok((key, features))
            })
            .collect()
    }

    /// Sets the estimate of a segment, the first one or a new one.
    pub async fn set_wear(&mut self, segment: &SegmentId, wear: &WearEstimate) -> Result<(), StoreError> {
        let id = segment.0.as_str();
        let without_posterior = WearEstimate {
            posterior: None,
            ..wear.clone()
        };
        let status = to_json(&wear.status, "status", id)?;
        sqlx::query(
            "INSERT INTO wear_estimates (segment_id, status, reason, median_um, mean_um, p05_um, p95_um, log_evidence, estimate)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)
             ON CONFLICT (segment_id) DO UPDATE SET status = excluded.status, reason = excluded.reason, median_um = excluded.median_um,
                mean_um = excluded.mean_um, p05_um = excluded.p05_um, p95_um = excluded.p95_um, log_evidence = excluded.log_evidence,
                estimate = excluded.estimate",
        )
        .bind(id)
        .bind(status.trim_matches('"'))
        .bind(wear.reason.as_str())
        .bind(finite_or_none("median_um", wear.median_um)?)
        .bind(finite_or_none("mean_um", wear.mean_um)?)
        .bind(finite_or_none("p05_um", wear.p05_um)?)
        .bind(finite_or_none("p95_um", wear.p95_um)?)
        .bind(finite_or_none("log_evidence", wear.log_evidence)?)
        .bind(to_json(&without_posterior, "estimate", id)?)
        .execute(&mut *self.transaction)
        .await?;
        match &wear.posterior {
            Some(posterior) => {
                sqlx::query(
                    "INSERT INTO wear_posteriors (segment_id, wear_um, probability) VALUES ($1, $2, $3)
                     ON CONFLICT (segment_id) DO UPDATE SET wear_um = excluded.wear_um, probability = excluded.probability",
                )
                .bind(id)
                .bind(doubles_to_bytes(&posterior.wear_um))
                .bind(doubles_to_bytes(&posterior.probability))
                .execute(&mut *self.transaction)
                .await?;
            }
            None => {
                sqlx::query("DELETE FROM wear_posteriors WHERE segment_id = $1")
                    .bind(id)
                    .execute(&mut *self.transaction)
                    .await?;
            }
        }
        Ok(())
    }

    /// Sets how far the channel has been folded and its summary; `rewritten` says that estimates of earlier segments changed.
    pub async fn set_fold(&mut self, channel: &ChannelSummary, fold: &FoldState, rewritten: bool) -> Result<(), StoreError> {
        let last_ns = to_ns(fold.last.start_time)?;
        sqlx::query(
            "INSERT INTO tracker_states (channel_no, fold_key, state, last_start_ns, last_segment_id) VALUES ($1, $2, $3, $4, $5)
             ON CONFLICT (channel_no) DO UPDATE SET fold_key = excluded.fold_key, state = excluded.state,
                last_start_ns = excluded.last_start_ns, last_segment_id = excluded.last_segment_id",
        )
        .bind(channel.channel_no)
        .bind(fold.fold_key.as_str())
        .bind(fold.state.as_str())
        .bind(last_ns)
        .bind(fold.last.id.0.as_str())
        .execute(&mut *self.transaction)
        .await?;
        let optional_ns = |time: Option<Timestamp>| time.map(to_ns).transpose();
        sqlx::query(
            "UPDATE channels SET segments = $2, first_start_ns = $3, last_start_ns = $4, last_segment_id = $5, revision = $6,
                rewritten_revision = $7 WHERE channel_no = $1",
        )
        .bind(channel.channel_no)
        .bind(i64::try_from(channel.segments).unwrap_or(i64::MAX))
        .bind(optional_ns(channel.first_start_time)?)
        .bind(optional_ns(channel.last_start_time)?)
        .bind(channel.last_segment.as_ref().map(|id| id.0.as_str()))
        .bind(channel.revision + 1)
        .bind(if rewritten {
            channel.revision + 1
        } else {
            channel.rewritten_revision
        })
        .execute(&mut *self.transaction)
        .await?;
        Ok(())
    }

    /// Makes everything of this transaction permanent.
    pub async fn finish(self) -> Result<(), StoreError> {
        Ok(self.transaction.commit().await?)
    }
}
