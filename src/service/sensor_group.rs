//! Sensors shared by several meshes: each mesh is an asset, and the records of the asset that owns the sensor
//! are analysed for all of them.
//!
//! An asset whose `sensor.of` names another asset has its own records, analyses, estimates and alarms. Raw
//! bytes are stored once, and counted for each asset.

use super::error::ServiceError;
use crate::asset::{AssetId, AssetSpec, MAX_ON_ONE_SENSOR};
use crate::store::{Asset, Store, StoreError};

/// The assets of one sensor.
pub(crate) struct SensorGroup {
    /// The asset that owns the sensor; its description includes the other meshes.
    pub(crate) asset: Asset,
    /// The assets that share the sensor.
    pub(crate) members: Vec<AssetSpec>,
}

impl SensorGroup {
    /// Reads the group of the sensor that an asset owns.
    ///
    /// # Errors
    /// [`ServiceError::SensorOfOther`] if the asset has no sensor of its own.
    pub(crate) async fn load(store: &Store, id: &AssetId) -> Result<Self, ServiceError> {
        let all = store.assets_of_sensor(id).await?;
        let asset = one_of(&all, id)?;
        if let Some(of) = &asset.spec.sensor.of {
            return Err(ServiceError::SensorOfOther { asset: id.clone(), of: of.clone() });
        }
        let specs: Vec<AssetSpec> = all.into_iter().map(|asset| asset.spec).collect();
        let members = specs.iter().filter(|spec| spec.id != *id).map(|spec| spec.clone().among(&specs));
        Ok(Self { asset, members: members.collect() })
    }

    /// The descriptions of all assets, that of the sensor's owner first.
    pub(crate) fn specs(&self) -> impl Iterator<Item = &AssetSpec> {
        std::iter::once(&self.asset.spec).chain(&self.members)
    }
}

/// Reads an asset; its description includes the other meshes of its sensor.
pub(crate) async fn described(store: &Store, id: &AssetId) -> Result<Asset, ServiceError> {
    one_of(&store.assets_of_sensor(id).await?, id)
}

/// Adds the other meshes of its sensor to the description of an asset.
pub(crate) async fn among_others(store: &Store, mut asset: Asset) -> Result<Asset, ServiceError> {
    let all = store.assets_of_sensor(&asset.spec.id).await?;
    let specs: Vec<AssetSpec> = all.into_iter().map(|asset| asset.spec).collect();
    asset.spec = asset.spec.among(&specs);
    Ok(asset)
}

/// The assets of the same sensor, including this one.
pub(crate) async fn ids_of_sensor(store: &Store, id: &AssetId) -> Result<Vec<AssetId>, ServiceError> {
    let all = store.assets_of_sensor(id).await?;
    Ok(all.into_iter().map(|asset| asset.spec.id).collect())
}

/// The other assets of the same sensor, provided that none of them shares the sensor of this one.
///
/// # Errors
/// [`ServiceError::SensorShared`].
pub(crate) async fn ids_beside(store: &Store, id: &AssetId) -> Result<Vec<AssetId>, ServiceError> {
    let all = store.assets_of_sensor(id).await?;
    let through = all.iter().filter(|asset| asset.spec.sensor.of.as_ref() == Some(id));
    let members: Vec<&str> = through.map(|asset| asset.spec.id.as_str()).collect();
    if !members.is_empty() {
        return Err(ServiceError::SensorShared { asset: id.clone(), others: members.join(", ") });
    }
    Ok(all.into_iter().map(|asset| asset.spec.id).filter(|other| other != id).collect())
}

/// Checks the `sensor.of` of a description, against the description `before` if the asset exists already.
pub(crate) async fn check_sensor(
    store: &Store,
    spec: &AssetSpec,
    before: Option<&AssetSpec>,
) -> Result<(), ServiceError> {
    let refuse = |expected: &str| {
        let value = spec.sensor.of.as_ref().map_or("not given".to_owned(), AssetId::to_string);
        Err(ServiceError::Field { field: "sensor.of", value, expected: expected.to_owned().into() })
    };
    if let Some(before) = before
        && before.sensor.of != spec.sensor.of
        && store.channels(&spec.id).await?.iter().any(|channel| channel.segments > 0)
    {
        return refuse(
            "the previous value, because the asset has records: create another asset for the mesh",
        );
    }
    let Some(of) = &spec.sensor.of else { return Ok(()) };
    let all = match store.assets_of_sensor(of).await {
        Err(StoreError::AssetUnknown(_)) => return refuse("the id of an existing asset"),
        all => all?,
    };
    if all.iter().any(|other| other.spec.id == *of && other.spec.sensor.of.is_some()) {
        return refuse("an asset with a sensor of its own, not one that shares another sensor");
    }
    if all.iter().filter(|other| other.spec.id != spec.id).count() >= MAX_ON_ONE_SENSOR {
        return refuse(&format!("an asset whose sensor is shared by fewer than {MAX_ON_ONE_SENSOR} meshes"));
    }
    if before.is_none() {
        return Ok(());
    }
    match ids_beside(store, &spec.id).await {
        Err(ServiceError::SensorShared { .. }) => {
            refuse("no value, because other assets share the sensor of this one")
        }
        others => others.map(|_| ()),
    }
}

/// Selects one of the assets of a sensor; its description includes the meshes of the others.
fn one_of(all: &[Asset], id: &AssetId) -> Result<Asset, ServiceError> {
    let asset = all.iter().find(|asset| asset.spec.id == *id).cloned();
    let mut asset = asset.ok_or_else(|| StoreError::AssetUnknown(id.clone()))?;
    let specs: Vec<AssetSpec> = all.iter().map(|asset| asset.spec.clone()).collect();
    asset.spec = asset.spec.among(&specs);
    Ok(asset)
}
