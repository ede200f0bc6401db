//! Creating, changing and deleting assets.

use std::sync::Arc;

use super::backfill::Backfill;
use super::clock::Clock;
use super::conflicts::retry_conflicts;
use super::error::ServiceError;
use super::events::{EventSender, LiveEvent};
use super::history::History;
use super::precondition::Precondition;
use super::raw::RawObjects;
use super::sensor_group::{check_sensor, ids_beside, ids_of_sensor};
use super::simulations::Simulations;
use super::streams::Streams;
use super::work_queue::Role;
use crate::asset::{AssetId, AssetSpec};
use crate::store::{Asset, RecordRange, Store, StoreError};

/// Maximum number of times that a description is checked again because another one changed in the meantime.
const MAX_RETRIES: u32 = 20;

/// What is retried, in the log.
const CHANGE: &str = "the change of a description";

/// Records of each channel removed in one transaction before an asset is deleted.
const REMOVAL_BATCH: u32 = 200;

/// Creates, changes and deletes assets.
pub struct Assets {
    pub(crate) store: Store,
    pub(crate) simulations: Arc<Simulations>,
    pub(crate) history: Arc<History>,
    pub(crate) backfill: Arc<Backfill>,
    pub(crate) raw: Arc<RawObjects>,
    pub(crate) streams: Arc<Streams>,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) events: EventSender,
    pub(crate) role: Role,
    /// Held while a description is changed, because assets of one sensor depend on each other.
    pub(crate) describing: tokio::sync::Mutex<()>,
}

impl Assets {
    /// Creates an asset and starts to simulate its library. Earlier records of a shared sensor are analysed
    /// for it in the background.
    ///
    /// # Errors
    /// The asset whose sensor it shares does not exist or itself shares a sensor.
    pub async fn create(&self, spec: &AssetSpec) -> Result<Asset, ServiceError> {
        let _guard = self.describing.lock().await;
        let asset = retry_conflicts(CHANGE, MAX_RETRIES, || self.insert_checked(spec)).await?;
        self.raw.update_asset_metadata(&spec.id).await;
        self.simulations.describe(spec);
        if let Role::ApiNode(queue) = &self.role {
            queue.notify_changed(&spec.id);
        }
        self.events.send(LiveEvent::AssetChanged(spec.id.clone()));
        if spec.sensor.of.is_some() {
            self.history.recompute_in_background(ids_of_sensor(&self.store, &spec.id).await?);
            self.backfill.in_background(vec![spec.id.clone()]);
        }
        Ok(asset)
    }

    async fn insert_checked(&self, spec: &AssetSpec) -> Result<Asset, ServiceError> {
        let store = &self.store;
        // An asset with a sensor of its own does not depend on others.
        let checked = match spec.sensor.of {
            Some(_) => Some(store.descriptions_mark().await?),
            None => None,
        };
        check_sensor(store, spec, None).await?;
        Ok(store.insert_asset(spec, checked, self.clock.now()).await?)
    }

    /// Replaces an asset's description. Its history is recomputed in the background if it depends on what
    /// changed.
    ///
    /// # Errors
    /// [`ServiceError::Precondition`].
    pub async fn update(&self, spec: &AssetSpec, precondition: &Precondition) -> Result<Asset, ServiceError> {
        let _guard = self.describing.lock().await;
        let beside = ids_of_sensor(&self.store, &spec.id).await?;
        let asset = retry_conflicts(CHANGE, MAX_RETRIES, || self.update_checked(spec, precondition)).await?;
        self.raw.update_asset_metadata(&spec.id).await;
        self.simulations.describe(spec);
        self.events.send(LiveEvent::AssetChanged(spec.id.clone()));
        self.history.recompute_in_background(beside);
        self.history.recompute_in_background(ids_of_sensor(&self.store, &spec.id).await?);
        if spec.sensor.of.is_some() {
            self.backfill.in_background(vec![spec.id.clone()]);
        }
        Ok(asset)
    }

    async fn update_checked(
        &self,
        spec: &AssetSpec,
        precondition: &Precondition,
    ) -> Result<Asset, ServiceError> {
        let store = &self.store;
        let mark = store.descriptions_mark().await?;
        let before = store.asset(&spec.id).await?;
        precondition.check(&before)?;
        let before = before.spec;
        check_sensor(store, spec, Some(&before)).await?;
        let is_alone = spec.sensor.of.is_none() && before.sensor.of.is_none() && precondition.is_none();
        let checked = (!is_alone).then_some(mark);
        Ok(store.update_asset(spec, checked, self.clock.now()).await?)
    }

    /// Deletes an asset, its rows and its streams; many records are removed some at a time. Raw recordings
    /// that no other asset has are moved into quarantine. After an error, a repeat completes what is left.
    ///
    /// # Errors
    /// [`ServiceError::SensorShared`]; [`ServiceError::Precondition`].
    pub async fn delete(&self, id: &AssetId, precondition: &Precondition) -> Result<(), ServiceError> {
        let _guard = self.describing.lock().await;
        precondition.check(&self.store.asset(id).await?)?;
        ids_beside(&self.store, id).await?;
        let removed = self.remove_records(id).await?;
        // The deletion has begun: a description that another process changes meanwhile does not end it.
        let precondition = removed.is_none().then_some(precondition);
        let (beside, mut orphans) =
            retry_conflicts(CHANGE, MAX_RETRIES, || self.delete_checked(id, precondition)).await?;
        self.raw.update_asset_metadata(id).await;
        self.history.recompute_in_background(beside);
        self.history.forget(id);
        self.simulations.release(id);
        self.events.send(LiveEvent::AssetRemoved(id.clone()));
        if let Some(queue) = self.role.queue() {
            queue.notify_changed(id);
        }
        // Before another asset can get the name, and with it the folder of the streams.
        let streams = self.streams.remove(id).await;
        orphans.extend(removed.into_iter().flatten());
        self.raw.quarantine(orphans).await?;
        streams
    }

    /// Removes the records of an asset that is going to be deleted, but for the last few, in short
    /// transactions. Returns the names of the objects that are no longer referenced; `None` if there are only
    /// a few records.
    async fn remove_records(&self, id: &AssetId) -> Result<Option<Vec<String>>, ServiceError> {
        let mut orphans = None;
        loop {
            let records = self.store.records_in(id, &RecordRange::default(), REMOVAL_BATCH).await?;
            if records.len() < REMOVAL_BATCH as usize {
                return Ok(orphans);
            }
            let removed = self.store.remove_records(id, &records).await?;
            orphans.get_or_insert_with(Vec::new).extend(removed.orphans);
        }
    }

    /// Returns the other assets of the sensor, and the names of the objects that are no longer referenced.
    async fn delete_checked(
        &self,
        id: &AssetId,
        precondition: Option<&Precondition>,
    ) -> Result<(Vec<AssetId>, Vec<String>), ServiceError> {
        let mark = self.store.descriptions_mark().await?;
        let asset = self.store.asset(id).await?;
        precondition.map_or(Ok(()), |precondition| precondition.check(&asset))?;
        let beside = ids_beside(&self.store, id).await?;
        Ok((beside, self.store.delete_asset(id, mark).await?))
    }

    /// Starts to simulate an asset's library and to bring its history up to date, in the background. For a
    /// worker that is notified of a change of the asset.
    pub async fn refresh(&self, asset: &AssetId) -> Result<(), ServiceError> {
        match self.store.asset(asset).await {
            Ok(asset) => {
                self.simulations.describe(&asset.spec);
                if asset.spec.sensor.of.is_some() {
                    self.backfill.in_background(vec![asset.spec.id.clone()]);
                }
                self.history.recompute_in_background(vec![asset.spec.id]);
                Ok(())
            }
            Err(StoreError::AssetUnknown(asset)) => {
                self.history.forget(&asset);
                self.simulations.release(&asset);
                Ok(())
            }
            Err(error) => Err(error.into()),
        }
    }
}
