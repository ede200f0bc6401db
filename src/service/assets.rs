//! Making, changing and removing assets.

use std::sync::Arc;
use std::time::Duration;

use super::catch_up::CatchUp;
use super::clock::Clock;
use super::error::ServiceError;
use super::events::{Announcer, LiveEvent};
use super::history::History;
use super::precondition::Precondition;
use super::raw::RawObjects;
use super::sensor_group::{check_sensor, ids_beside, ids_of_sensor};
use super::simulations::Simulations;
use super::work_queue::Role;
use crate::asset::{AssetId, AssetSpec};
use crate::store::{Asset, Store, StoreError};

/// How often a description is checked again because another one was changed meanwhile.
const MAX_TRIES: u32 = 20;

/// Waits before it is; longer from time to time, so that many who do so come through.
const WAIT: Duration = Duration::from_millis(5);

/// How often a change of a description was checked in vain.
#[derive(Debug, Default)]
struct Tries(u32);

impl Tries {
    /// How long to wait before it is checked again, where another process was in the way: the assets of one
    /// sensor depend on each other.
    fn wait_after<T>(&mut self, changed: &Result<T, ServiceError>) -> Option<Duration> {
        match changed {
            Err(ServiceError::Store(error)) if error.is_conflict() && self.0 < MAX_TRIES => {
                tracing::debug!(%error, tries = self.0, "conflict with another process: checking the description again");
                self.0 += 1;
                Some(WAIT * self.0)
            }
            _ => None,
        }
    }
}

/// Makes, changes and removes assets.
pub struct Assets {
    pub(crate) store: Store,
    pub(crate) simulations: Arc<Simulations>,
    pub(crate) history: Arc<History>,
    pub(crate) catch_up: Arc<CatchUp>,
    pub(crate) raw: Arc<RawObjects>,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) events: Announcer,
    pub(crate) role: Role,
    /// Held while descriptions are changed, since assets of one sensor depend on each other.
    pub(crate) describing: tokio::sync::Mutex<()>,
}

impl Assets {
    /// Makes an asset and starts its library; earlier records of a shared sensor are analysed for it in the
    /// background.
    ///
    /// Error: the asset whose sensor it names is not there or names another one itself.
    pub async fn create(&self, spec: &AssetSpec) -> Result<Asset, ServiceError> {
        let _turn = self.describing.lock().await;
        let mut tries = Tries::default();
        let asset = loop {
            let inserted = self.insert_checked(spec).await;
            match tries.wait_after(&inserted) {
                Some(wait) => tokio::time::sleep(wait).await,
                None => break inserted?,
            }
        };
        self.raw.note_changed_asset(&spec.id).await;
        self.simulations.describe(spec);
        if let Role::ApiNode(queue) = &self.role {
            queue.notify_changed(&spec.id);
        }
        self.events.announce(LiveEvent::AssetChanged(spec.id.clone()));
        if spec.sensor.of.is_some() {
            self.history.recompute_in_background(ids_of_sensor(&self.store, &spec.id).await?);
            self.catch_up.in_background(vec![spec.id.clone()]);
        }
        Ok(asset)
    }

    async fn insert_checked(&self, spec: &AssetSpec) -> Result<Asset, ServiceError> {
        let store = &self.store;
        // What stands by itself does not depend on others.
        let checked = match spec.sensor.of {
            Some(_) => Some(store.descriptions_mark().await?),
            None => None,
        };
        check_sensor(store, spec, None).await?;
        Ok(store.insert_asset(spec, checked, self.clock.now()).await?)
    }

    /// Replaces an asset's description; its history is computed again in the background where it depends on
    /// what changed.
    ///
    /// Error: [`ServiceError::Precondition`].
    pub async fn update(&self, spec: &AssetSpec, precondition: &Precondition) -> Result<Asset, ServiceError> {
        let _turn = self.describing.lock().await;
        let beside = ids_of_sensor(&self.store, &spec.id).await?;
        let mut tries = Tries::default();
        let asset = loop {
            let updated = self.update_checked(spec, precondition).await;
            match tries.wait_after(&updated) {
                Some(wait) => tokio::time::sleep(wait).await,
                None => break updated?,
            }
        };
        self.raw.note_changed_asset(&spec.id).await;
        self.simulations.describe(spec);
        self.events.announce(LiveEvent::AssetChanged(spec.id.clone()));
        self.history.recompute_in_background(beside);
        self.history.recompute_in_background(ids_of_sensor(&self.store, &spec.id).await?);
        if spec.sensor.of.is_some() {
            self.catch_up.in_background(vec![spec.id.clone()]);
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

    /// Removes an asset and its rows; the raw recordings that no other asset has go into quarantine.
    ///
    /// Errors: [`ServiceError::SensorShared`]; [`ServiceError::Precondition`].
    pub async fn delete(&self, id: &AssetId, precondition: &Precondition) -> Result<(), ServiceError> {
        let _turn = self.describing.lock().await;
        let _exclusive = self.raw.exclusive().await;
        let mut tries = Tries::default();
        let (beside, orphans) = loop {
            let deleted = self.delete_checked(id, precondition).await;
            match tries.wait_after(&deleted) {
                Some(wait) => tokio::time::sleep(wait).await,
                None => break deleted?,
            }
        };
        self.raw.note_changed_asset(id).await;
        self.history.recompute_in_background(beside);
        self.history.forget(id);
        self.simulations.release(id);
        self.events.announce(LiveEvent::AssetRemoved(id.clone()));
        if let Some(queue) = self.role.queue() {
            queue.notify_changed(id);
        }
        self.raw.quarantine(orphans).await
    }

    /// Returns the other assets of the sensor, and the objects that nothing refers to any more.
    async fn delete_checked(
        &self,
        id: &AssetId,
        precondition: &Precondition,
    ) -> Result<(Vec<AssetId>, Vec<String>), ServiceError> {
        let mark = self.store.descriptions_mark().await?;
        precondition.check(&self.store.asset(id).await?)?;
        let beside = ids_beside(&self.store, id).await?;
        Ok((beside, self.store.delete_asset(id, mark).await?))
    }

    /// Brings an asset's history up to what is asked for now, and starts its library, in the background; for
    /// a worker that is notified of the asset.
    pub async fn refresh(&self, asset: &AssetId) -> Result<(), ServiceError> {
        match self.store.asset(asset).await {
            Ok(asset) => {
                self.simulations.describe(&asset.spec);
                if asset.spec.sensor.of.is_some() {
                    self.catch_up.in_background(vec![asset.spec.id.clone()]);
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
