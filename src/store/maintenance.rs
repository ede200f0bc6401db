//! Maintenance events of assets.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use sqlx::any::AnyRow;
use sqlx::{Any, Executor};

use super::database::rows::{get, get_json, to_json, to_ns};
use super::transaction::Transaction;
use super::{ChannelSummary, SegmentKey, Store, StoreError};
use crate::asset::{AssetId, SegmentId};
use crate::estimate::MaintenanceEvent;

/// A stored maintenance event.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StoredEvent {
    /// Identifier within its asset: a hash of its content.
    pub id: String,
    /// The event.
    pub event: MaintenanceEvent,
}

impl StoredEvent {
    /// Derives the identifier of an event.
    pub fn new(event: MaintenanceEvent) -> Result<Self, StoreError> {
        let content = to_json(&event, "event", "maintenance")?;
        let id = hex::encode(&Sha256::digest(content)[..8]);
        Ok(Self { id, event })
    }
}

impl Store {
    /// All events of an asset in the order of time.
    pub async fn maintenance(&self, asset: &AssetId) -> Result<Vec<MaintenanceEvent>, StoreError> {
        events_of(asset, self.read()).await
    }

    /// Up to `limit` events of an asset, the latest first, that come after `after` in this order.
    pub async fn latest_maintenance(
        &self,
        asset: &AssetId,
        after: Option<&(Timestamp, String)>,
        limit: u32,
    ) -> Result<Vec<StoredEvent>, StoreError> {
        let (after_ns, after_id) = match after {
            Some((time, id)) => (to_ns(*time)?, id.as_str()),
            None => (i64::MAX, "~"),
        };
        let rows = sqlx::query(
            "SELECT * FROM maintenance_events WHERE asset_id = $1 AND (time_ns, id) < ($2, $3) ORDER BY time_ns DESC, id DESC LIMIT $4",
        )
        .bind(asset.as_str())
        .bind(after_ns)
        .bind(after_id)
        .bind(i64::from(limit))
        .fetch_all(self.read())
        .await?;
        rows.iter().map(event_of).collect()
    }

    /// An event of an asset; `None` if there is none with that identifier.
    pub async fn maintenance_event(
        &self,
        asset: &AssetId,
        id: &str,
    ) -> Result<Option<StoredEvent>, StoreError> {
        let row = sqlx::query("SELECT * FROM maintenance_events WHERE asset_id = $1 AND id = $2")
            .bind(asset.as_str())
            .bind(id)
            .fetch_optional(self.read())
            .await?;
        row.as_ref().map(event_of).transpose()
    }
}

impl Transaction {
    /// All events of an asset in the order of time.
    pub(super) async fn maintenance(&mut self, asset: &AssetId) -> Result<Vec<MaintenanceEvent>, StoreError> {
        events_of(asset, &mut *self.inner).await
    }

    /// Adds an event; returns whether it is new. No channel is added to the asset before the end of the
    /// transaction.
    ///
    /// # Errors
    /// [`StoreError::AssetUnknown`].
    pub async fn add_maintenance(
        &mut self,
        asset: &AssetId,
        stored: &StoredEvent,
    ) -> Result<bool, StoreError> {
        self.lock_asset(asset).await?;
        let added = sqlx::query(
            "INSERT INTO maintenance_events (asset_id, id, time_ns, event) VALUES ($1, $2, $3, $4) ON CONFLICT (asset_id, id) DO NOTHING",
        )
        .bind(asset.as_str())
        .bind(stored.id.as_str())
        .bind(to_ns(stored.event.time)?)
        .bind(to_json(&stored.event, "event", &stored.id)?)
        .execute(&mut *self.inner)
        .await?;
        Ok(added.rows_affected() > 0)
    }

    /// Removes an event; returns whether it existed. No channel is added to the asset before the end of the
    /// transaction.
    ///
    /// # Errors
    /// [`StoreError::AssetUnknown`].
    pub async fn remove_maintenance(&mut self, asset: &AssetId, id: &str) -> Result<bool, StoreError> {
        self.lock_asset(asset).await?;
        let removed = sqlx::query("DELETE FROM maintenance_events WHERE asset_id = $1 AND id = $2")
            .bind(asset.as_str())
            .bind(id)
            .execute(&mut *self.inner)
            .await?;
        Ok(removed.rows_affected() > 0)
    }

    /// Marks a channel's history for folding again if it reaches a time.
    pub async fn fold_again_from(
        &mut self,
        channel: &ChannelSummary,
        time: Timestamp,
    ) -> Result<(), StoreError> {
        let mut channel = self.lock_channel(channel).await?;
        channel.must_fold |= channel.last_start_time.is_some_and(|last| last >= time);
        channel.mark_changed(SegmentKey { start_time: time, id: SegmentId(String::new()) });
        self.set_channel(&mut channel, false).await
    }
}

async fn events_of<'c>(
    asset: &AssetId,
    executor: impl Executor<'c, Database = Any>,
) -> Result<Vec<MaintenanceEvent>, StoreError> {
    let rows = sqlx::query("SELECT * FROM maintenance_events WHERE asset_id = $1 ORDER BY time_ns, id")
        .bind(asset.as_str())
        .fetch_all(executor)
        .await?;
    rows.iter().map(|row| Ok(event_of(row)?.event)).collect()
}

fn event_of(row: &AnyRow) -> Result<StoredEvent, StoreError> {
    let id: String = get(row, "id")?;
    Ok(StoredEvent { event: get_json(row, "event", &id)?, id })
}
