//! Adding and removing maintenance events.

use std::sync::Arc;

use super::error::ServiceError;
use super::events::{EventSender, LiveEvent};
use super::history::History;
use super::pipeline::Committer;
use super::raw::RawObjects;
use crate::asset::AssetId;
use crate::estimate::MaintenanceEvent;
use crate::store::{Store, StoreError, StoredEvent};

/// Adds and removes maintenance events.
pub struct Maintenance {
    pub(crate) store: Store,
    pub(crate) history: Arc<History>,
    pub(crate) committer: Arc<Committer>,
    pub(crate) raw: Arc<RawObjects>,
    pub(crate) events: EventSender,
}

impl Maintenance {
    /// Stores an event; histories that contain its time are recomputed in the background. Adding the same
    /// event again changes nothing and returns the same result.
    pub async fn add(&self, asset: &AssetId, event: MaintenanceEvent) -> Result<StoredEvent, ServiceError> {
        if i64::try_from(event.time.as_nanosecond()).is_err() {
            return Err(StoreError::Time(event.time).into());
        }
        let stored = StoredEvent::new(event)?;
        self.change(asset, &stored, false).await?;
        Ok(stored)
    }

    /// Removes an event as if it had never been added.
    ///
    /// # Errors
    /// [`ServiceError::MaintenanceUnknown`].
    pub async fn remove(&self, asset: &AssetId, id: &str) -> Result<(), ServiceError> {
        self.store.asset(asset).await?;
        let unknown = || ServiceError::MaintenanceUnknown(id.to_owned());
        let stored = self.store.maintenance_event(asset, id).await?.ok_or_else(unknown)?;
        if self.change(asset, &stored, true).await? { Ok(()) } else { Err(unknown()) }
    }

    async fn change(
        &self,
        asset: &AssetId,
        stored: &StoredEvent,
        is_removed: bool,
    ) -> Result<bool, ServiceError> {
        let store = &self.store;
        let _pause = self.committer.pause().await;
        let mut transaction = store.begin().await?;
        // From here on no channel is created, and nothing is folded.
        let is_new = if is_removed {
            transaction.remove_maintenance(asset, &stored.id).await?
        } else {
            transaction.add_maintenance(asset, stored).await?
        };
        if !is_new {
            return Ok(false);
        }
        let mut channels = store.channels(asset).await?;
        channels.sort_by(|a, b| a.channel.cmp(&b.channel));
        for channel in &channels {
            transaction.fold_again_from(channel, stored.event.time).await?;
        }
        transaction.commit().await?;
        self.raw.update_asset_metadata(asset).await;
        self.events.send(LiveEvent::MaintenanceChanged {
            asset: asset.clone(),
            event: stored.clone(),
            is_removed,
        });
        self.history.recompute_in_background(vec![asset.clone()]);
        Ok(true)
    }
}
