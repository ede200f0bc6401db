//! Sensors shared by several meshes: each mesh is an asset, and the records that come for one of them are
//! analysed for all.
//!
//! An asset whose `sensor.of` names another one has records, analyses, estimates and alarms of its own; raw
//! bytes are stored once, and counted for each.

use super::error::ServiceError;
use crate::asset::{AssetId, AssetSpec, MAX_ON_ONE_SENSOR};
use crate::store::{Asset, Store, StoreError};

/// The assets that get the records of one sensor.
pub(crate) struct SensorGroup {
    /// The asset that has the sensor, the other meshes known to its description.
    pub(crate) asset: Asset,
    /// The assets that share it.
    pub(crate) members: Vec<AssetSpec>,
}

impl SensorGroup {
    /// The assets that get the records of an asset.
    ///
    /// Error: [`ServiceError::SensorOfOther`] where it has no sensor of its own.
    pub(crate) async fn of(store: &Store, id: &AssetId) -> Result<Self, ServiceError> {
        let all = store.assets_of_sensor(id).await?;
        let asset = one_of(&all, id)?;
        if let Some(of) = &asset.spec.sensor.of {
            return Err(ServiceError::SensorOfOther { asset: id.clone(), of: of.clone() });
        }
        let specs: Vec<AssetSpec> = all.into_iter().map(|asset| asset.spec).collect();
        let members = specs.iter().filter(|spec| spec.id != *id).map(|spec| spec.clone().among(&specs));
        Ok(Self { asset, members: members.collect() })
    }

    /// The descriptions of all of them, that of the asset with the sensor first.
    pub(crate) fn specs(&self) -> impl Iterator<Item = &AssetSpec> {
        std::iter::once(&self.asset.spec).chain(&self.members)
    }
}

/// An asset, the other meshes of its sensor known to its description.
pub(crate) async fn described(store: &Store, id: &AssetId) -> Result<Asset, ServiceError> {
    one_of(&store.assets_of_sensor(id).await?, id)
}

/// An asset that was read by itself, with the other meshes of its sensor.
pub(crate) async fn among_others(store: &Store, mut asset: Asset) -> Result<Asset, ServiceError> {
    let all = store.assets_of_sensor(&asset.spec.id).await?;
    let specs: Vec<AssetSpec> = all.into_iter().map(|asset| asset.spec).collect();
    asset.spec = asset.spec.among(&specs);
    Ok(asset)
}

/// The assets of the same sensor, this one among them.
pub(crate) async fn ids_of_sensor(store: &Store, id: &AssetId) -> Result<Vec<AssetId>, ServiceError> {
    let all = store.assets_of_sensor(id).await?;
    Ok(all.into_iter().map(|asset| asset.spec.id).collect())
}

/// The assets of the same sensor, where none of them has the sensor of this one.
///
/// Error: [`ServiceError::SensorShared`].
pub(crate) async fn ids_beside(store: &Store, id: &AssetId) -> Result<Vec<AssetId>, ServiceError> {
    let all = store.assets_of_sensor(id).await?;
    let through = all.iter().filter(|asset| asset.spec.sensor.of.as_ref() == Some(id));
    let members: Vec<&str> = through.map(|asset| asset.spec.id.as_str()).collect();
    if !members.is_empty() {
        return Err(ServiceError::SensorShared { asset: id.clone(), others: members.join(", ") });
    }
    Ok(all.into_iter().map(|asset| asset.spec.id).filter(|other| other != id).collect())
}

/// Checks whose sensor a description names, against what the asset was `before` where there is one.
pub(crate) async fn check_sensor(
    store: &Store,
    spec: &AssetSpec,
    before: Option<&AssetSpec>,
) -> Result<(), ServiceError> {
    let refuse = |expected: &'static str| {
        let value = spec.sensor.of.as_ref().map_or("not given".to_owned(), AssetId::to_string);
        Err(ServiceError::Field { field: "sensor.of", value, expected })
    };
    if let Some(before) = before
        && before.sensor.of != spec.sensor.of
        && store.channels(&spec.id).await?.iter().any(|channel| channel.segments > 0)
    {
        return refuse("what it was before, since the asset has records: describe the mesh as another asset");
    }
    let Some(of) = &spec.sensor.of else { return Ok(()) };
    let all = match store.assets_of_sensor(of).await {
        Err(StoreError::AssetUnknown(_)) => return refuse("the id of an asset that there is"),
        all => all?,
    };
    if all.iter().any(|other| other.spec.id == *of && other.spec.sensor.of.is_some()) {
        return refuse("an asset with a sensor of its own, not one that shares another's");
    }
    if all.iter().filter(|other| other.spec.id != spec.id).count() >= MAX_ON_ONE_SENSOR {
        return refuse("an asset whose sensor fewer than 8 meshes share");
    }
    if before.is_some() && ids_beside(store, &spec.id).await.is_err() {
        return refuse("nothing, since other assets share the sensor of this one");
    }
    Ok(())
}

/// One of the assets of a sensor, the others known to its description.
fn one_of(all: &[Asset], id: &AssetId) -> Result<Asset, ServiceError> {
    let asset = all.iter().find(|asset| asset.spec.id == *id).cloned();
    let mut asset = asset.ok_or_else(|| StoreError::AssetUnknown(id.clone()))?;
    let specs: Vec<AssetSpec> = all.iter().map(|asset| asset.spec.clone()).collect();
    asset.spec = asset.spec.among(&specs);
    Ok(asset)
}
