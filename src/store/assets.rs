//! Assets and their channels.

use std::sync::Arc;

use jiff::Timestamp;
use sqlx::Row;
use sqlx::any::AnyRow;

use super::database::rows::{
    asset_id, from_ns, get, get_count, get_json, get_time, placeholders, to_json, to_ns,
};
use super::database::watched::WatchedTransaction;
use super::records::raw;
use super::{SegmentKey, Store, StoreError, shared_sensors};
use crate::asset::{AssetId, AssetSpec, SegmentId};

/// Maximum number of assets in one query.
const ASSETS_PER_QUERY: usize = 200;

/// A stored asset.
#[derive(Debug, Clone, PartialEq)]
pub struct Asset {
    /// The user's description.
    pub spec: AssetSpec,
    /// When it was created.
    pub created_at: Timestamp,
    /// When its description last changed.
    pub updated_at: Timestamp,
    pub(super) revision: i64,
}

impl Asset {
    /// A number that changes with the description and with every maintenance event of the asset, and is never
    /// reused for another asset.
    pub fn version(&self) -> i64 {
        self.revision
    }

    /// The default channel: the one named by the description, else the first one.
    pub fn default_channel<'a>(&self, channels: &'a [ChannelSummary]) -> Option<&'a ChannelSummary> {
        let named = |name: &str| channels.iter().find(|channel| channel.channel == name);
        self.spec.sensor.channel.as_deref().and_then(named).or(channels.first())
    }
}

/// The summary of one channel of an asset, available without reading its segments.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelSummary {
    /// The asset.
    pub asset_id: AssetId,
    /// The channel's name.
    pub channel: String,
    /// Number of segments.
    pub segments: u64,
    /// Start of the earliest segment.
    pub first_start_time: Option<Timestamp>,
    /// Start of the latest segment.
    pub last_start_time: Option<Timestamp>,
    /// The latest segment.
    pub last_segment: Option<SegmentId>,
    /// The keys under which the served history was computed.
    pub keys: ChannelKeys,
    /// Whether the history has to be folded again, for example because of late records.
    pub must_fold: bool,
    pub(super) channel_no: i64,
    pub(super) revision: i64,
    pub(super) rewritten_revision: i64,
    pub(super) analysis_generation: i64,
    pub(super) wear_generation: i64,
    /// The largest generation number assigned.
    pub(super) newest_generation: i64,
    /// Whether rows of generations that are not served still exist.
    pub leftovers: bool,
    /// The generation of analyses being written, and its key.
    pub(super) next_analysis: Option<(i64, String)>,
    /// The generation of estimates being written.
    pub(super) next_wear: Option<i64>,
    /// When the lease of its writer expires.
    pub(super) writer_lease_until: Option<Timestamp>,
    /// The earliest place where the history changed since this generation was started.
    pub(super) changed_from: Option<SegmentKey>,
}

/// Identifies everything that a record's analysis depends on besides its raw bytes.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct AnalysisKeys {
    /// Key of the whole analysis: under another one it is repeated.
    pub analysis: Arc<str>,
    /// Key of the features alone: features under different keys cannot be compared.
    pub feature: Arc<str>,
}

/// Identifies everything that a channel's history depends on besides its raw records.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ChannelKeys {
    /// Keys of the analyses.
    pub analysed: AnalysisKeys,
    /// Key of the fold.
    pub fold: String,
}

impl ChannelSummary {
    /// A pair of numbers that changes with every record and estimate of the channel, and is never reused for
    /// another channel.
    pub fn version(&self) -> (i64, i64) {
        (self.channel_no, self.revision)
    }

    /// Increments the revision; `rewritten` says that estimates of earlier records changed.
    pub(super) fn count_change(&mut self, rewritten: bool) {
        self.revision += 1;
        if rewritten {
            self.rewritten_revision = self.revision;
        }
    }

    /// Marks the place of a record or event that a running recomputation may have passed already.
    pub fn mark_changed(&mut self, place: SegmentKey) {
        if self.next_wear.is_some() && self.changed_from.as_ref().is_none_or(|earliest| place < *earliest) {
            self.changed_from = Some(place);
        }
    }
}

/// The revision of all descriptions at which something was checked against them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DescriptionsMark(i64);

impl DescriptionsMark {
    /// Returns an error if another transaction has changed a description since the mark. To be called after a
    /// change in this transaction, which blocks other changes until its end.
    async fn check(self, transaction: &mut WatchedTransaction) -> Result<(), StoreError> {
        let row = sqlx::query("SELECT value FROM counters WHERE name = 'asset_revision'")
            .fetch_one(&mut **transaction)
            .await?;
        if get::<i64>(&row, "value")? == self.0 + 1 {
            Ok(())
        } else {
            Err(StoreError::Outdated("the description of another asset"))
        }
    }
}

impl Store {
    /// The current mark of all descriptions, for a check that must still hold when its result is stored.
    pub async fn descriptions_mark(&self) -> Result<DescriptionsMark, StoreError> {
        let row = sqlx::query("SELECT value FROM counters WHERE name = 'asset_revision'")
            .fetch_one(self.read())
            .await?;
        Ok(DescriptionsMark(get(&row, "value")?))
    }

    /// Stores a new asset, provided that no description has changed since it was `checked`.
    ///
    /// # Errors
    /// [`StoreError::AssetExists`]; [`StoreError::Outdated`].
    pub async fn insert_asset(
        &self,
        spec: &AssetSpec,
        checked: Option<DescriptionsMark>,
        now: Timestamp,
    ) -> Result<Asset, StoreError> {
        let id = spec.id.as_str();
        let mut transaction = self.write()?.begin().await?;
        sqlx::query("UPDATE counters SET value = value + 1 WHERE name = 'asset_revision'")
            .execute(&mut *transaction)
            .await?;
        if let Some(mark) = checked {
            mark.check(&mut transaction).await?;
        }
        let inserted = sqlx::query(
            "INSERT INTO assets (id, spec, created_at_ns, updated_at_ns, revision)
             SELECT $1, $2, $3, $3, value FROM counters WHERE name = 'asset_revision' ON CONFLICT (id) DO NOTHING",
        )
        .bind(id)
        .bind(to_json(spec, "spec", id)?)
        .bind(to_ns(now)?)
        .execute(&mut *transaction)
        .await?;
        if inserted.rows_affected() == 0 {
            return Err(StoreError::AssetExists(spec.id.clone()));
        }
        shared_sensors::set(&mut transaction, spec).await?;
        transaction.commit().await?;
        self.asset(&spec.id).await
    }

    /// Replaces an asset's description, provided that no description has changed since it was `checked`.
    ///
    /// # Errors
    /// [`StoreError::AssetUnknown`]; [`StoreError::Outdated`].
    pub async fn update_asset(
        &self,
        spec: &AssetSpec,
        checked: Option<DescriptionsMark>,
        now: Timestamp,
    ) -> Result<Asset, StoreError> {
        let id = spec.id.as_str();
        let mut transaction = self.begin().await?;
        transaction.lock_asset(&spec.id).await?;
        if let Some(mark) = checked {
            mark.check(&mut transaction.inner).await?;
        }
        sqlx::query("UPDATE assets SET spec = $2, updated_at_ns = $3 WHERE id = $1")
            .bind(id)
            .bind(to_json(spec, "spec", id)?)
            .bind(to_ns(now)?)
            .execute(&mut *transaction.inner)
            .await?;
        shared_sensors::set(&mut transaction.inner, spec).await?;
        transaction.commit().await?;
        self.asset(&spec.id).await
    }

    /// Reads an asset.
    ///
    /// # Errors
    /// [`StoreError::AssetUnknown`].
    pub async fn asset(&self, id: &AssetId) -> Result<Asset, StoreError> {
        let row = sqlx::query("SELECT * FROM assets WHERE id = $1")
            .bind(id.as_str())
            .fetch_optional(self.read())
            .await?;
        row.as_ref().map(asset_of).transpose()?.ok_or_else(|| StoreError::AssetUnknown(id.clone()))
    }

    /// Up to `limit` assets in the order of their names, from the first one after `after`.
    pub async fn assets(&self, after: Option<&str>, limit: u32) -> Result<Vec<Asset>, StoreError> {
        let rows = sqlx::query("SELECT * FROM assets WHERE id > $1 ORDER BY id LIMIT $2")
            .bind(after.unwrap_or(""))
            .bind(i64::from(limit))
            .fetch_all(self.read())
            .await?;
        rows.iter().map(asset_of).collect()
    }

    /// Deletes an asset with all its rows, provided that no description has changed since this was `checked`.
    /// Returns the names of the raw objects that are no longer referenced.
    ///
    /// # Errors
    /// [`StoreError::AssetUnknown`]; [`StoreError::Outdated`].
    pub async fn delete_asset(
        &self,
        id: &AssetId,
        checked: DescriptionsMark,
    ) -> Result<Vec<String>, StoreError> {
        let mut transaction = self.begin().await?;
        // From here on no channel is created, and nothing is added.
        transaction.lock_asset(id).await?;
        checked.check(&mut transaction.inner).await?;
        let channels = self.channels(id).await?;
        let inner = &mut transaction.inner;
        shared_sensors::change_others(inner, id).await?;
        let mine = "SELECT sha256 FROM raw_objects WHERE asset_id = $1";
        let objects = sqlx::query(mine).bind(id.as_str()).fetch_all(&mut **inner).await?;
        let objects: Vec<String> = objects.iter().map(|row| get(row, "sha256")).collect::<Result<_, _>>()?;
        sqlx::query("DELETE FROM assets WHERE id = $1").bind(id.as_str()).execute(&mut **inner).await?;
        let kept = raw::kept_among(inner, &objects).await?;
        let orphans = objects.into_iter().filter(|name| !kept.contains(name)).collect();
        transaction.commit().await?;
        for channel in channels {
            self.inner.trends.remove(channel.channel_no);
        }
        Ok(orphans)
    }

    /// The channels of an asset, in the order of their first records.
    pub async fn channels(&self, asset: &AssetId) -> Result<Vec<ChannelSummary>, StoreError> {
        let rows = sqlx::query("SELECT * FROM channels WHERE asset_id = $1 ORDER BY channel_no")
            .bind(asset.as_str())
            .fetch_all(self.read())
            .await?;
        rows.iter().map(channel_of).collect()
    }

    /// The assets with more than one channel, each with the sum of its channels' revisions.
    pub async fn revisions_with_joint_novelty(&self) -> Result<Vec<(AssetId, i64)>, StoreError> {
        let text = "SELECT c.asset_id, CAST(SUM(c.revision) AS BIGINT) AS revision FROM channels c
             GROUP BY c.asset_id HAVING COUNT(*) > 1 OR EXISTS (
                SELECT 1 FROM alarms l JOIN channels of_alarm ON of_alarm.channel_no = l.channel_no
                WHERE of_alarm.asset_id = c.asset_id AND l.quantity = 'joint_novelty' AND l.severity IS NOT NULL
             ) ORDER BY c.asset_id";
        let rows = sqlx::query(text).fetch_all(self.read()).await?;
        rows.iter().map(|row| Ok((asset_id(get(row, "asset_id")?)?, get(row, "revision")?))).collect()
    }

    /// Runs a query on these assets in chunks; `text` returns the SQL for a list of placeholders.
    pub(super) async fn rows_of_assets(
        &self,
        assets: &[&AssetId],
        text: impl Fn(&str) -> String,
    ) -> Result<Vec<AnyRow>, StoreError> {
        let mut found = Vec::new();
        for chunk in assets.chunks(ASSETS_PER_QUERY) {
            let text = text(&placeholders(1, chunk.len()));
            let query = sqlx::query(&text).persistent(self.dialect().caches_statement(chunk.len()));
            let query = chunk.iter().fold(query, |query, asset| query.bind(asset.as_str()));
            found.extend(query.fetch_all(self.read()).await?);
        }
        Ok(found)
    }

    /// A channel of an asset; `None` before its first record.
    pub async fn channel(&self, asset: &AssetId, name: &str) -> Result<Option<ChannelSummary>, StoreError> {
        let row = sqlx::query("SELECT * FROM channels WHERE asset_id = $1 AND name = $2")
            .bind(asset.as_str())
            .bind(name)
            .fetch_optional(self.read())
            .await?;
        row.as_ref().map(channel_of).transpose()
    }

    /// Number of segments of all assets.
    pub async fn segment_count(&self) -> Result<u64, StoreError> {
        let row = sqlx::query("SELECT CAST(COALESCE(SUM(segments), 0) AS BIGINT) FROM channels")
            .fetch_one(self.read())
            .await?;
        Ok(u64::try_from(row.try_get::<i64, _>(0)?).unwrap_or(0))
    }
}

pub(super) fn asset_of(row: &AnyRow) -> Result<Asset, StoreError> {
    let id: String = get(row, "id")?;
    Ok(Asset {
        spec: get_json(row, "spec", &id)?,
        created_at: get_time(row, "created_at_ns")?,
        updated_at: get_time(row, "updated_at_ns")?,
        revision: get(row, "revision")?,
    })
}

pub(super) fn channel_of(row: &AnyRow) -> Result<ChannelSummary, StoreError> {
    let asset: String = get(row, "asset_id")?;
    Ok(ChannelSummary {
        asset_id: asset_id(asset)?,
        channel: get(row, "name")?,
        segments: get_count(row, "segments")?,
        first_start_time: get::<Option<i64>>(row, "first_start_ns")?.map(from_ns),
        last_start_time: get::<Option<i64>>(row, "last_start_ns")?.map(from_ns),
        last_segment: get::<Option<String>>(row, "last_segment_id")?.map(SegmentId),
        channel_no: get(row, "channel_no")?,
        revision: get(row, "revision")?,
        rewritten_revision: get(row, "rewritten_revision")?,
        keys: ChannelKeys {
            analysed: AnalysisKeys {
                analysis: get::<String>(row, "analysis_key")?.into(),
                feature: get::<String>(row, "feature_key")?.into(),
            },
            fold: get(row, "fold_key")?,
        },
        must_fold: get::<i64>(row, "must_fold")? != 0,
        analysis_generation: get(row, "analysis_generation")?,
        wear_generation: get(row, "wear_generation")?,
        newest_generation: get(row, "newest_generation")?,
        leftovers: get::<i64>(row, "leftovers")? != 0,
        next_analysis: get::<Option<i64>>(row, "next_analysis_generation")?
            .zip(get(row, "next_analysis_key")?),
        next_wear: get(row, "next_wear_generation")?,
        writer_lease_until: get::<Option<i64>>(row, "maker_until_ns")?.map(from_ns),
        changed_from: get::<Option<i64>>(row, "changed_from_ns")?
            .zip(get::<Option<String>>(row, "changed_from_id")?)
            .map(|(start_ns, id)| SegmentKey { start_time: from_ns(start_ns), id: SegmentId(id) }),
    })
}
