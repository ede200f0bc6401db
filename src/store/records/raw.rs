//! The raw objects of each asset, and their total sizes.

use std::collections::{HashMap, HashSet};

use crate::asset::AssetId;
use crate::store::database::rows::{get, get_count, placeholders};
use crate::store::database::watched::WatchedTransaction;
use crate::store::{Store, StoreError};

/// Maximum number of names in one query.
const NAMES_PER_QUERY: usize = 500;

/// Raw objects deleted by the retention.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct DeletedRaw {
    /// Their number, counted once for each asset.
    pub objects: u64,
    /// Their total size in bytes.
    pub bytes: u64,
    /// Whether the remaining ones are within the quota.
    pub is_within: bool,
    /// Names of those that are no longer referenced.
    pub orphans: Vec<String>,
}

impl Store {
    /// Total size in bytes of the raw objects of each asset; an object of two assets counts for both.
    pub async fn raw_volumes(&self) -> Result<HashMap<String, u64>, StoreError> {
        let rows = sqlx::query("SELECT asset_id, bytes FROM raw_volumes").fetch_all(self.read()).await?;
        rows.iter().map(|row| Ok((get(row, "asset_id")?, get_count(row, "bytes")?))).collect()
    }

    /// Whether an asset still has a raw object: not after the retention deleted it.
    pub async fn keeps_raw(&self, asset: &AssetId, name: &str) -> Result<bool, StoreError> {
        let row = sqlx::query("SELECT bytes FROM raw_objects WHERE sha256 = $1 AND asset_id = $2")
            .bind(name)
            .bind(asset.as_str())
            .fetch_optional(self.read())
            .await?;
        Ok(row.is_some())
    }

    /// Deletes the rows of the oldest raw objects, of one asset or of all, until the rest is within `quota`
    /// bytes or `max` objects are deleted. One process at a time, so that no more are deleted than
    /// necessary. Their segments are kept. The caller removes the files.
    pub async fn delete_oldest_raw(
        &self,
        asset: Option<&AssetId>,
        quota: u64,
        max: u32,
    ) -> Result<DeletedRaw, StoreError> {
        let mut transaction = self.write()?.begin().await?;
        // Other processes wait here until the end of this transaction, and then see its result.
        sqlx::query("UPDATE counters SET value = value + 1 WHERE name = 'retention'")
            .execute(&mut *transaction)
            .await?;
        let bytes = volume(&mut transaction, asset).await?.saturating_sub(quota);
        if bytes == 0 {
            return Ok(DeletedRaw { is_within: true, ..DeletedRaw::default() });
        }
        let text = match asset {
            Some(_) => {
                "SELECT sha256, asset_id, bytes FROM raw_objects WHERE asset_id = $2 ORDER BY start_time_ns LIMIT $1"
            }
            None => "SELECT sha256, asset_id, bytes FROM raw_objects ORDER BY start_time_ns LIMIT $1",
        };
        let mut query = sqlx::query(text).bind(i64::from(max));
        if let Some(asset) = asset {
            query = query.bind(asset.as_str());
        }
        let mut total = DeletedRaw::default();
        let mut names = Vec::new();
        for row in query.fetch_all(&mut *transaction).await? {
            if total.bytes >= bytes {
                break;
            }
            let (name, of): (String, String) = (get(&row, "sha256")?, get(&row, "asset_id")?);
            let size: i64 = get(&row, "bytes")?;
            let deleted = sqlx::query("DELETE FROM raw_objects WHERE sha256 = $1 AND asset_id = $2")
                .bind(name.as_str())
                .bind(of.as_str())
                .execute(&mut *transaction)
                .await?;
            if deleted.rows_affected() == 0 {
                // Another process deleted it first.
                continue;
            }
            sqlx::query("UPDATE raw_volumes SET bytes = bytes - $2 WHERE asset_id = $1")
                .bind(of.as_str())
                .bind(size)
                .execute(&mut *transaction)
                .await?;
            total.objects += 1;
            total.bytes += u64::try_from(size).unwrap_or(0);
            names.push(name);
        }
        let kept = kept_among(&mut transaction, &names).await?;
        transaction.commit().await?;
        names.retain(|name| !kept.contains(name));
        names.sort_unstable();
        names.dedup();
        total.orphans = names;
        total.is_within = total.bytes >= bytes;
        Ok(total)
    }

    /// Returns the names that no asset references.
    pub async fn orphans_among(&self, names: Vec<String>) -> Result<Vec<String>, StoreError> {
        if names.is_empty() {
            return Ok(names);
        }
        let mut snapshot = self.read().begin().await?;
        let kept = kept_among(&mut snapshot, &names).await?;
        Ok(names.into_iter().filter(|name| !kept.contains(name)).collect())
    }
}

/// Total size in bytes of the raw objects of an asset, or of all.
async fn volume(transaction: &mut WatchedTransaction, asset: Option<&AssetId>) -> Result<u64, StoreError> {
    let text = "SELECT CAST(COALESCE(SUM(bytes), 0) AS BIGINT) AS volume FROM raw_volumes";
    let row = match asset {
        Some(asset) => {
            sqlx::query(&format!("{text} WHERE asset_id = $1"))
                .bind(asset.as_str())
                .fetch_one(&mut **transaction)
                .await?
        }
        None => sqlx::query(text).fetch_one(&mut **transaction).await?,
    };
    Ok(u64::try_from(get::<i64>(&row, "volume")?).unwrap_or(0))
}

/// Returns the names that an asset references.
pub(in crate::store) async fn kept_among(
    transaction: &mut WatchedTransaction,
    names: &[String],
) -> Result<HashSet<String>, StoreError> {
    let mut kept = HashSet::new();
    for chunk in names.chunks(NAMES_PER_QUERY) {
        let text = format!(
            "SELECT DISTINCT sha256 FROM raw_objects WHERE sha256 IN ({})",
            placeholders(1, chunk.len())
        );
        let query = chunk.iter().fold(sqlx::query(&text), |query, name| query.bind(name.as_str()));
        for row in query.fetch_all(&mut **transaction).await? {
            kept.insert(get(&row, "sha256")?);
        }
    }
    Ok(kept)
}
