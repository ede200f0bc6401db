//! Telling of maintenance, and taking it back.

use std::sync::Arc;

use super::{Announcement, Ingest, IngestError};
use crate::asset::AssetId;
use crate::estimate::MaintenanceEvent;
use crate::store::{StoreError, StoredEvent};

impl Ingest {
    /// Keeps an event, and has the histories that reach it estimated again in the background. The same event again is answered as the first
    /// time.
    pub async fn add_maintenance(&self, asset: &AssetId, event: MaintenanceEvent) -> Result<StoredEvent, IngestError> {
        if i64::try_from(event.time.as_nanosecond()).is_err() {
            return Err(StoreError::Time(event.time).into());
        }
        let stored = StoredEvent::new(event)?;
        self.change_maintenance(asset, &stored, false).await?;
        Ok(stored)
    }

    /// Takes an event back as if it had not been told of.
    ///
    /// Error: [`IngestError::MaintenanceUnknown`].
    pub async fn remove_maintenance(&self, asset: &AssetId, id: &str) -> Result<(), IngestError> {
        self.inner.store.asset(asset).await?;
        let unknown = || IngestError::MaintenanceUnknown(id.to_owned());
        let stored = self.inner.store.maintenance_event(asset, id).await?.ok_or_else(unknown)?;
        if self.change_maintenance(asset, &stored, true).await? {
            Ok(())
        } else {
            Err(unknown())
        }
    }

    async fn change_maintenance(&self, asset: &AssetId, stored: &StoredEvent, is_removed: bool) -> Result<bool, IngestError> {
        let store = &self.inner.store;
        let _turn = self.inner.commits.turn.lock().await;
        let mut commit = store.begin().await?;
        // No channel begins from here on, and nothing is folded.
        let is_new = if is_removed {
            commit.remove_maintenance(asset, &stored.id).await?
        } else {
            commit.add_maintenance(asset, stored).await?
        };
        if !is_new {
            return Ok(false);
        }
        let mut channels = store.channels(asset).await?;
        channels.sort_by(|a, b| a.channel.cmp(&b.channel));
        for channel in &channels {
            commit.fold_again_from(channel, stored.event.time).await?;
        }
        commit.finish().await?;
        self.announce(Announcement::MaintenanceChanged {
            asset: asset.clone(),
            event: Arc::new(stored.clone()),
            is_removed,
        });
        self.recompute_in_background(vec![asset.clone()]);
        Ok(true)
    }
}
