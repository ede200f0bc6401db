//! Making, changing and removing assets.

use std::time::Duration;

use super::{Announcement, Ingest, IngestError, Part};
use crate::asset::{AssetId, AssetSpec};
use crate::store::Asset;

/// How often a description is checked again because another one was changed meanwhile.
const CHECKED_AGAIN: u32 = 20;

/// Waits before it is; longer from time to time, so that many who do so come through.
const WAIT: Duration = Duration::from_millis(5);

/// How often a change of a description was checked in vain.
#[derive(Debug, Default)]
struct Tries(u32);

impl Tries {
    /// How long to wait before it is checked again, where another process was in the way: the assets of one sensor depend on each other.
    fn wait_after<T>(&mut self, changed: &Result<T, IngestError>) -> Option<Duration> {
        match changed {
            Err(IngestError::Store(error)) if error.is_conflict() && self.0 < CHECKED_AGAIN => {
                tracing::debug!(%error, tries = self.0, "description checked again");
                self.0 += 1;
                Some(WAIT * self.0)
            }
            _ => None,
        }
    }
}

impl Ingest {
    /// Makes an asset and starts its library; what came before through the sensor that it hears through is looked at in the background.
    ///
    /// Error: the asset that it is to hear through is not there or hears through another one.
    pub async fn create_asset(&self, spec: &AssetSpec) -> Result<Asset, IngestError> {
        let _turn = self.inner.describing.lock().await;
        let mut tries = Tries::default();
        let asset = loop {
            let inserted = self.insert_checked(spec).await;
            match tries.wait_after(&inserted) {
                Some(wait) => tokio::time::sleep(wait).await,
                None => break inserted?,
            }
        };
        self.inner.libraries.prepare(spec);
        if let Part::Entrance(crew) = &self.inner.part {
            crew.tell_of(&spec.id);
        }
        self.announce(Announcement::AssetChanged(spec.id.clone()));
        if spec.sensor.of.is_some() {
            self.recompute_in_background(self.ids_of_sensor(&spec.id).await?);
            self.catch_up_in_background(vec![spec.id.clone()]);
        }
        Ok(asset)
    }

    async fn insert_checked(&self, spec: &AssetSpec) -> Result<Asset, IngestError> {
        let store = &self.inner.store;
        // What stands by itself does not depend on others.
        let checked = match spec.sensor.of {
            Some(_) => Some(store.descriptions_mark().await?),
            None => None,
        };
        self.check_sensor(spec, None).await?;
        Ok(store.insert_asset(spec, checked, self.inner.clock.now()).await?)
    }

    /// Replaces an asset's description; its history is computed again in the background where it depends on what changed.
    pub async fn update_asset(&self, spec: &AssetSpec) -> Result<Asset, IngestError> {
        let _turn = self.inner.describing.lock().await;
        let beside = self.ids_of_sensor(&spec.id).await?;
        let mut tries = Tries::default();
        let asset = loop {
            let updated = self.update_checked(spec).await;
            match tries.wait_after(&updated) {
                Some(wait) => tokio::time::sleep(wait).await,
                None => break updated?,
            }
        };
        self.inner.libraries.prepare(spec);
        self.announce(Announcement::AssetChanged(spec.id.clone()));
        self.recompute_in_background(beside);
        self.recompute_in_background(self.ids_of_sensor(&spec.id).await?);
        if spec.sensor.of.is_some() {
            self.catch_up_in_background(vec![spec.id.clone()]);
        }
        Ok(asset)
    }

    async fn update_checked(&self, spec: &AssetSpec) -> Result<Asset, IngestError> {
        let store = &self.inner.store;
        let mark = store.descriptions_mark().await?;
        let before = store.asset(&spec.id).await?.spec;
        self.check_sensor(spec, Some(&before)).await?;
        let is_alone = spec.sensor.of.is_none() && before.sensor.of.is_none();
        let checked = (!is_alone).then_some(mark);
        Ok(store.update_asset(spec, checked, self.inner.clock.now()).await?)
    }

    /// Removes an asset, its rows, and the raw recordings that no other asset has.
    ///
    /// Error: [`IngestError::HeardByOthers`].
    pub async fn delete_asset(&self, id: &AssetId) -> Result<(), IngestError> {
        let _turn = self.inner.describing.lock().await;
        let _nobody_keeps = self.inner.keeping.write().await;
        let mut tries = Tries::default();
        let (beside, orphans) = loop {
            let deleted = self.delete_checked(id).await;
            match tries.wait_after(&deleted) {
                Some(wait) => tokio::time::sleep(wait).await,
                None => break deleted?,
            }
        };
        self.recompute_in_background(beside);
        self.inner.channels.forget(id);
        self.forget_recomputations(id);
        self.announce(Announcement::AssetRemoved(id.clone()));
        if let Some(crew) = self.crew() {
            crew.tell_of(id);
        }
        self.remove_objects(orphans).await
    }

    /// Returns the other assets of the sensor, and the objects that nothing refers to any more.
    async fn delete_checked(&self, id: &AssetId) -> Result<(Vec<AssetId>, Vec<String>), IngestError> {
        let mark = self.inner.store.descriptions_mark().await?;
        let beside = self.ids_beside(id).await?;
        Ok((beside, self.inner.store.delete_asset(id, mark).await?))
    }
}
