//! Exclusion of stored records from their channel's history.

use super::removal::RecordRange;
use crate::asset::{AssetId, Segment, SegmentId};
use crate::store::database::rows::{from_ns, get, to_ns};
use crate::store::transaction::Transaction;
use crate::store::{ChannelSummary, SegmentKey, Store, StoreError};

impl Store {
    /// Excludes records of an asset from its histories, or includes them again; returns how many changed.
    /// Marks the histories for folding again.
    ///
    /// # Errors
    /// [`StoreError::AssetUnknown`].
    pub async fn set_excluded(
        &self,
        asset: &AssetId,
        range: &RecordRange,
        is_excluded: bool,
    ) -> Result<u64, StoreError> {
        let mut transaction = self.begin().await?;
        transaction.asset(asset).await?;
        let mut channels = self.channels(asset).await?;
        channels.retain(|channel| range.channel.as_ref().is_none_or(|name| *name == channel.channel));
        channels.sort_by(|a, b| a.channel.cmp(&b.channel));
        let mut changed = 0;
        for channel in &channels {
            let mut channel = transaction.lock_channel(channel).await?;
            let keys = transaction.mark_excluded(&channel, range, is_excluded).await?;
            let Some(first) = keys.iter().min().cloned() else {
                continue;
            };
            changed += keys.len() as u64;
            channel.must_fold = true;
            channel.mark_changed(first);
            transaction.set_channel(&mut channel, true).await?;
        }
        if changed > 0 {
            transaction.commit().await?;
        }
        Ok(changed)
    }

    /// The excluded records of an asset.
    pub async fn excluded(&self, asset: &AssetId) -> Result<Vec<SegmentId>, StoreError> {
        let rows = sqlx::query(
            "SELECT s.id FROM segments s JOIN channels c ON c.channel_no = s.channel_no
             WHERE c.asset_id = $1 AND s.excluded <> 0 ORDER BY s.id",
        )
        .bind(asset.as_str())
        .fetch_all(self.read())
        .await?;
        rows.iter().map(|row| Ok(SegmentId(get(row, "id")?))).collect()
    }

    /// The latest record of a channel that is not excluded, else the latest one; `None` for a channel without
    /// records.
    pub async fn latest_counted(&self, channel: &ChannelSummary) -> Result<Option<Segment>, StoreError> {
        let Some(last) = &channel.last_segment else {
            return Ok(None);
        };
        let latest = self.segment(last).await?;
        if latest.as_ref().is_none_or(|latest| !latest.excluded) {
            return Ok(latest);
        }
        let row =
            sqlx::query("SELECT id FROM segments WHERE channel_no = $1 AND excluded = 0 ORDER BY start_time_ns DESC, id DESC LIMIT 1")
                .bind(channel.channel_no)
                .fetch_optional(self.read())
                .await?;
        let Some(row) = row else { return Ok(latest) };
        self.segment(&SegmentId(get(&row, "id")?)).await
    }
}

impl Transaction {
    /// Marks records of a channel as excluded or not; returns the keys of those that changed.
    async fn mark_excluded(
        &mut self,
        channel: &ChannelSummary,
        range: &RecordRange,
        is_excluded: bool,
    ) -> Result<Vec<SegmentKey>, StoreError> {
        let rows = sqlx::query(
            "UPDATE segments SET excluded = $5
             WHERE channel_no = $1 AND start_time_ns >= $2 AND start_time_ns < $3 AND (raw_sha256 = $4 OR $4 = '') AND excluded <> $5
             RETURNING id, start_time_ns",
        )
        .bind(channel.channel_no)
        .bind(range.from.map_or(Ok(i64::MIN), to_ns)?)
        .bind(range.to.map_or(Ok(i64::MAX), to_ns)?)
        .bind(range.raw_sha256.as_deref().unwrap_or_default())
        .bind(i64::from(is_excluded))
        .fetch_all(&mut *self.inner)
        .await?;
        let keys = rows.iter().map(|row| {
            Ok(SegmentKey { start_time: from_ns(get(row, "start_time_ns")?), id: SegmentId(get(row, "id")?) })
        });
        keys.collect()
    }
}
