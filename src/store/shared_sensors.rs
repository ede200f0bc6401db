//! The assets that share the sensor of another asset.

use std::collections::BTreeSet;

use super::assets::asset_of;
use super::database::rows::{asset_id, get, placeholders};
use super::database::watched::WatchedTransaction;
use super::{Asset, Store, StoreError};
use crate::asset::{AssetId, AssetSpec};

/// Condition for the other assets of the sensor of asset `$1`.
const OF_SENSOR: &str = "id IN (SELECT of_asset FROM shared_sensors WHERE asset_id = $1)
    OR id IN (SELECT asset_id FROM shared_sensors WHERE of_asset = $1)
    OR id IN (SELECT b.asset_id FROM shared_sensors a JOIN shared_sensors b ON b.of_asset = a.of_asset WHERE a.asset_id = $1)";

/// Marks the other assets of an asset's sensor as changed, because their analysis depends on it.
pub(super) async fn change_others(
    transaction: &mut WatchedTransaction,
    id: &AssetId,
) -> Result<(), StoreError> {
    let text = format!("SELECT id FROM assets WHERE id <> $1 AND ({OF_SENSOR}) ORDER BY id");
    let others = sqlx::query(&text).bind(id.as_str()).fetch_all(&mut **transaction).await?;
    for other in others {
        let other: String = get(&other, "id")?;
        sqlx::query("UPDATE counters SET value = value + 1 WHERE name = 'asset_revision'")
            .execute(&mut **transaction)
            .await?;
        sqlx::query("UPDATE assets SET revision = (SELECT value FROM counters WHERE name = 'asset_revision') WHERE id = $1")
            .bind(other)
            .execute(&mut **transaction)
            .await?;
    }
    Ok(())
}

/// Updates the row of an asset after a change of its description.
pub(super) async fn set(transaction: &mut WatchedTransaction, spec: &AssetSpec) -> Result<(), StoreError> {
    change_others(transaction, &spec.id).await?;
    sqlx::query("DELETE FROM shared_sensors WHERE asset_id = $1")
        .bind(spec.id.as_str())
        .execute(&mut **transaction)
        .await?;
    if let Some(of) = &spec.sensor.of {
        sqlx::query("INSERT INTO shared_sensors (asset_id, of_asset) VALUES ($1, $2)")
            .bind(spec.id.as_str())
            .bind(of.as_str())
            .execute(&mut **transaction)
            .await?;
        change_others(transaction, &spec.id).await?;
    }
    Ok(())
}

impl Store {
    /// Up to `limit` assets that share another asset's sensor and lack records from before they were created.
    pub async fn late_members(&self, limit: u32) -> Result<Vec<AssetId>, StoreError> {
        let rows = sqlx::query(
            "SELECT asset_id FROM shared_sensors WHERE is_caught_up = 0 ORDER BY asset_id LIMIT $1",
        )
        .bind(i64::from(limit))
        .fetch_all(self.read())
        .await?;
        rows.iter().map(|row| asset_id(get(row, "asset_id")?)).collect()
    }

    /// Marks an asset as backfilled with the earlier records of the asset whose sensor it shares.
    pub async fn mark_backfilled(&self, member: &AssetId, of: &AssetId) -> Result<(), StoreError> {
        sqlx::query("UPDATE shared_sensors SET is_caught_up = 1 WHERE asset_id = $1 AND of_asset = $2 AND is_caught_up = 0")
            .bind(member.as_str())
            .bind(of.as_str())
            .execute(self.write()?)
            .await?;
        Ok(())
    }

    /// Returns the assets whose sensor is shared, and the other assets of these sensors.
    pub async fn sharing_a_sensor(&self, ids: &[&AssetId]) -> Result<BTreeSet<AssetId>, StoreError> {
        let list = placeholders(1, ids.len());
        let text = format!(
            "SELECT asset_id, of_asset FROM shared_sensors WHERE asset_id IN ({list}) OR of_asset IN ({list})"
        );
        let query = sqlx::query(&text).persistent(self.dialect().caches_statement(ids.len()));
        let query = ids.iter().fold(query, |query, id| query.bind(id.as_str()));
        let mut sharing = BTreeSet::new();
        for row in query.fetch_all(self.read()).await? {
            sharing.insert(asset_id(get(&row, "asset_id")?)?);
            sharing.insert(asset_id(get(&row, "of_asset")?)?);
        }
        Ok(sharing)
    }

    /// An asset and the other assets of its sensor, sorted by name: the owner of the sensor, and those that
    /// share it.
    ///
    /// # Errors
    /// [`StoreError::AssetUnknown`].
    pub async fn assets_of_sensor(&self, id: &AssetId) -> Result<Vec<Asset>, StoreError> {
        let text = format!("SELECT * FROM assets WHERE id = $1 OR {OF_SENSOR} ORDER BY id");
        let rows = sqlx::query(&text).bind(id.as_str()).fetch_all(self.read()).await?;
        let assets: Vec<Asset> = rows.iter().map(asset_of).collect::<Result<_, _>>()?;
        if assets.iter().any(|asset| asset.spec.id == *id) {
            Ok(assets)
        } else {
            Err(StoreError::AssetUnknown(id.clone()))
        }
    }
}
