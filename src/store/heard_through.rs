//! Which assets hear through the measuring points of another one.

use sqlx::{Any, Transaction};

use super::rows::{get, get_json};
use super::{Store, StoreError};
use crate::asset::{AssetId, AssetSpec};

/// One row for each asset that hears through another one, beside its description: so that a record's listeners are found by an index.
pub(super) const TABLE: &[&str] = &[
    "CREATE TABLE heard_through (
        asset_id TEXT NOT NULL PRIMARY KEY REFERENCES assets (id) ON DELETE CASCADE,
        of_asset TEXT NOT NULL REFERENCES assets (id)
    )",
    "CREATE INDEX heard_through_asset ON heard_through (of_asset)",
];

/// Brings the row of an asset in line with its description.
pub(super) async fn set(transaction: &mut Transaction<'_, Any>, spec: &AssetSpec) -> Result<(), StoreError> {
    sqlx::query("DELETE FROM heard_through WHERE asset_id = $1")
        .bind(spec.id.as_str())
        .execute(&mut **transaction)
        .await?;
    if let Some(of) = &spec.sensor.of {
        sqlx::query("INSERT INTO heard_through (asset_id, of_asset) VALUES ($1, $2)")
            .bind(spec.id.as_str())
            .bind(of.as_str())
            .execute(&mut **transaction)
            .await?;
    }
    Ok(())
}

impl Store {
    /// The descriptions of an asset and of all others of its sensor, in the order of their names: the one that the records come for, and those
    /// that hear through it.
    ///
    /// Error: [`StoreError::AssetUnknown`].
    pub async fn assets_of_sensor(&self, id: &AssetId) -> Result<Vec<AssetSpec>, StoreError> {
        let rows = sqlx::query(
            "SELECT id, spec FROM assets WHERE id = $1
                OR id IN (SELECT of_asset FROM heard_through WHERE asset_id = $1)
                OR id IN (SELECT asset_id FROM heard_through WHERE of_asset = $1)
                OR id IN (SELECT b.asset_id FROM heard_through a JOIN heard_through b ON b.of_asset = a.of_asset WHERE a.asset_id = $1)
             ORDER BY id",
        )
        .bind(id.as_str())
        .fetch_all(self.read())
        .await?;
        let mut specs = Vec::with_capacity(rows.len());
        for row in &rows {
            let id: String = get(row, "id")?;
            let spec: AssetSpec = get_json(row, "spec", &id)?;
            specs.push(spec);
        }
        if specs.iter().any(|spec| spec.id == *id) {
            Ok(specs)
        } else {
            Err(StoreError::AssetUnknown(id.clone()))
        }
    }
}
