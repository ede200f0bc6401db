//! Removal of an asset's records.

use std::collections::{BTreeSet, HashSet};

use jiff::{SignedDuration, Timestamp};

use super::raw::kept_among;
use crate::asset::{AssetId, Segment, SegmentId};
use crate::store::database::rows::{from_ns, get, placeholders, to_ns};
use crate::store::transaction::{ROWS_PER_STATEMENT, Transaction};
use crate::store::{ChannelSummary, SegmentKey, Store, StoreError};

/// Selects records of an asset.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RecordRange {
    /// Only those of this channel.
    pub channel: Option<String>,
    /// Only those that start at this time or later.
    pub from: Option<Timestamp>,
    /// Only those that start before this time.
    pub to: Option<Timestamp>,
    /// Only those with these raw bytes.
    pub raw_sha256: Option<String>,
}

impl RecordRange {
    /// Selects one record.
    pub fn of(segment: &Segment) -> Self {
        let next = segment.start_time.saturating_add(SignedDuration::from_nanos(1));
        Self {
            channel: Some(segment.channel.clone()),
            from: Some(segment.start_time),
            to: next.ok(),
            raw_sha256: Some(segment.raw.sha256.clone()),
        }
    }
}

/// The records removed by one call.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RemovedRecords {
    /// Their segments.
    pub segments: Vec<SegmentId>,
    /// Names of the raw objects that are no longer referenced.
    pub orphans: Vec<String>,
}

/// A record to be removed.
struct RemovableRecord {
    key: SegmentKey,
    raw_sha256: String,
}

impl Store {
    /// Up to `limit` records of each channel of an asset, the earliest first.
    pub async fn records_in(
        &self,
        asset: &AssetId,
        range: &RecordRange,
        limit: u32,
    ) -> Result<Vec<SegmentId>, StoreError> {
        let mut channels = self.channels(asset).await?;
        channels.retain(|channel| range.channel.as_ref().is_none_or(|name| *name == channel.channel));
        let mut found = Vec::new();
        for channel in &channels {
            // Read through the write connection, because a replica may still have removed records.
            let rows = sqlx::query(
                "SELECT id FROM segments
                 WHERE channel_no = $1 AND start_time_ns >= $2 AND start_time_ns < $3 AND (raw_sha256 = $4 OR $4 = '')
                 ORDER BY start_time_ns, id LIMIT $5",
            )
            .bind(channel.channel_no)
            .bind(range.from.map_or(Ok(i64::MIN), to_ns)?)
            .bind(range.to.map_or(Ok(i64::MAX), to_ns)?)
            .bind(range.raw_sha256.as_deref().unwrap_or_default())
            .bind(i64::from(limit))
            .fetch_all(self.write()?)
            .await?;
            for row in &rows {
                found.push(SegmentId(get(row, "id")?));
            }
        }
        Ok(found)
    }

    /// Removes those of these records that an asset has, with all their results. Marks the histories that
    /// contained them for folding again.
    ///
    /// # Errors
    /// [`StoreError::AssetUnknown`].
    pub async fn remove_records(
        &self,
        asset: &AssetId,
        ids: &[SegmentId],
    ) -> Result<RemovedRecords, StoreError> {
        let mut transaction = self.begin().await?;
        transaction.asset(asset).await?;
        let mut channels = self.channels(asset).await?;
        channels.sort_by(|a, b| a.channel.cmp(&b.channel));
        let mut removed = RemovedRecords::default();
        let mut names = BTreeSet::new();
        for channel in &channels {
            let channel = transaction.lock_channel(channel).await?;
            let records = transaction.records_among(&channel, ids).await?;
            let Some(first) = records.iter().map(|record| &record.key).min().cloned() else {
                continue;
            };
            transaction.delete_segments(records.iter().map(|record| &record.key.id)).await?;
            transaction.update_after_removal(channel, first, records.len() as u64).await?;
            names.extend(records.iter().map(|record| record.raw_sha256.clone()));
            removed.segments.extend(records.into_iter().map(|record| record.key.id));
        }
        removed.orphans = transaction.count_raw_gone(asset, names.into_iter().collect()).await?;
        transaction.commit().await?;
        for channel in channels {
            self.inner.trends.remove(channel.channel_no);
        }
        Ok(removed)
    }
}

impl Transaction {
    async fn records_among(
        &mut self,
        channel: &ChannelSummary,
        ids: &[SegmentId],
    ) -> Result<Vec<RemovableRecord>, StoreError> {
        let mut records = Vec::new();
        for chunk in ids.chunks(500) {
            let text = format!(
                "SELECT id, start_time_ns, raw_sha256 FROM segments WHERE channel_no = $1 AND id IN ({})",
                placeholders(2, chunk.len())
            );
            let query = sqlx::query(&text).bind(channel.channel_no);
            let query = chunk.iter().fold(query, |query, id| query.bind(id.0.as_str()));
            for row in query.fetch_all(&mut *self.inner).await? {
                let start_time = from_ns(get(&row, "start_time_ns")?);
                records.push(RemovableRecord {
                    key: SegmentKey { start_time, id: SegmentId(get(&row, "id")?) },
                    raw_sha256: get(&row, "raw_sha256")?,
                });
            }
        }
        Ok(records)
    }

    /// Deletes segments with all their results.
    pub(super) async fn delete_segments(
        &mut self,
        ids: impl Iterator<Item = &SegmentId>,
    ) -> Result<(), StoreError> {
        for chunk in ids.collect::<Vec<_>>().chunks(ROWS_PER_STATEMENT) {
            let text = format!("DELETE FROM segments WHERE id IN ({})", placeholders(1, chunk.len()));
            let query = sqlx::query(&text).persistent(self.dialect.caches_statement(chunk.len()));
            let query = chunk.iter().fold(query, |query, id| query.bind(id.0.as_str()));
            query.execute(&mut *self.inner).await?;
        }
        Ok(())
    }

    /// Updates a channel after the removal of `count` records, the earliest of which was at `first`. A
    /// channel without records is deleted with its alarms.
    async fn update_after_removal(
        &mut self,
        mut channel: ChannelSummary,
        first: SegmentKey,
        count: u64,
    ) -> Result<(), StoreError> {
        channel.segments = channel.segments.saturating_sub(count);
        for direction in ["ASC", "DESC"] {
            let text = format!(
                "SELECT id, start_time_ns FROM segments WHERE channel_no = $1 ORDER BY start_time_ns {direction}, id {direction} LIMIT 1"
            );
            let query = sqlx::query(&text).bind(channel.channel_no);
            let Some(row) = query.fetch_optional(&mut *self.inner).await? else {
                sqlx::query("DELETE FROM channels WHERE channel_no = $1")
                    .bind(channel.channel_no)
                    .execute(&mut *self.inner)
                    .await?;
                return Ok(());
            };
            let start_time = Some(from_ns(get(&row, "start_time_ns")?));
            if direction == "ASC" {
                channel.first_start_time = start_time;
            } else {
                channel.last_start_time = start_time;
                channel.last_segment = Some(SegmentId(get(&row, "id")?));
            }
        }
        channel.must_fold = true;
        channel.mark_changed(first);
        self.set_channel(&mut channel, true).await
    }

    /// Subtracts raw objects for which an asset has no record any more from its volume; returns those that no
    /// asset references any more.
    async fn count_raw_gone(
        &mut self,
        asset: &AssetId,
        names: Vec<String>,
    ) -> Result<Vec<String>, StoreError> {
        let mut gone = Vec::new();
        for chunk in names.chunks(500) {
            let text = format!(
                "SELECT DISTINCT s.raw_sha256 FROM segments s JOIN channels c ON c.channel_no = s.channel_no
                 WHERE c.asset_id = $1 AND s.raw_sha256 IN ({})",
                placeholders(2, chunk.len())
            );
            let query = sqlx::query(&text).bind(asset.as_str());
            let query = chunk.iter().fold(query, |query, name| query.bind(name.as_str()));
            let rows = query.fetch_all(&mut *self.inner).await?;
            let used = rows.iter().map(|row| get(row, "raw_sha256"));
            let used: HashSet<String> = used.collect::<Result<_, StoreError>>()?;
            gone.extend(chunk.iter().filter(|name| !used.contains(*name)).cloned());
        }
        let mut bytes = 0;
        for chunk in gone.chunks(500) {
            let text = format!(
                "DELETE FROM raw_objects WHERE asset_id = $1 AND sha256 IN ({}) RETURNING bytes",
                placeholders(2, chunk.len())
            );
            let query = sqlx::query(&text).bind(asset.as_str());
            let query = chunk.iter().fold(query, |query, name| query.bind(name.as_str()));
            for row in query.fetch_all(&mut *self.inner).await? {
                bytes += get::<i64>(&row, "bytes")?;
            }
        }
        sqlx::query("UPDATE raw_volumes SET bytes = bytes - $2 WHERE asset_id = $1")
            .bind(asset.as_str())
            .bind(bytes)
            .execute(&mut *self.inner)
            .await?;
        let kept = kept_among(&mut self.inner, &gone).await?;
        gone.retain(|name| !kept.contains(name));
        Ok(gone)
    }
}
