//! Telling of maintenance, and taking it back.

use std::sync::Arc;

use super::{Announcement, Ingest, IngestError};
use crate::asset::{AssetId, SegmentId};
use crate::estimate::MaintenanceEvent;
use crate::store::{SegmentKey, StoreError, StoredEvent};

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
        // No channel begins meanwhile.
        let _turn = self.inner.commits.turn.lock().await;
        store.asset(asset).await?;
        let mut channels = store.channels(asset).await?;
        channels.sort_by(|a, b| a.channel.cmp(&b.channel));
        let mut slots = Vec::with_capacity(channels.len());
        for channel in &channels {
            slots.push(self.inner.channels.lock(asset, &channel.channel).await);
        }
        let mut commit = store.begin().await?;
        let is_new = if is_removed {
            commit.remove_maintenance(asset, &stored.id).await?
        } else {
            commit.add_maintenance(asset, stored).await?
        };
        if !is_new {
            return Ok(false);
        }
        for channel in &channels {
            commit.fold_again_from(channel, stored.event.time).await?;
        }
        commit.finish().await?;
        let place = SegmentKey {
            start_time: stored.event.time,
            id: SegmentId(String::new()),
        };
        for slot in &mut slots {
            slot.occurrences = None;
            slot.note_new(&place);
        }
        drop(slots);
        self.announce(Announcement::MaintenanceChanged {
            asset: asset.clone(),
            event: Arc::new(stored.clone()),
            is_removed,
        });
        self.recompute_in_background(vec![asset.clone()]);
        Ok(true)
    }
}
