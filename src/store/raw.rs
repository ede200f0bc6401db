//! Which raw objects are kept for which asset, and how many bytes they are.

use std::collections::{HashMap, HashSet};

use sqlx::{Any, Transaction};

use super::rows::{get, get_count, placeholders};
use super::{Store, StoreError};
use crate::asset::AssetId;

/// Names asked for by one statement.
const NAMES_AT_ONCE: usize = 500;

/// Raw objects that were given up.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct GivenUp {
    /// How many, counted once for each asset.
    pub objects: u64,
    /// Their bytes.
    pub bytes: u64,
    /// What is left is within the quota.
    pub is_within: bool,
    /// Names of those that nothing refers to any more.
    pub orphans: Vec<String>,
}

impl Store {
    /// Bytes of raw objects kept for each asset; an object that two assets have counts for both.
    pub async fn raw_volumes(&self) -> Result<HashMap<String, u64>, StoreError> {
        let rows = sqlx::query("SELECT asset_id, bytes FROM raw_volumes").fetch_all(self.read()).await?;
        rows.iter().map(|row| Ok((get(row, "asset_id")?, get_count(row, "bytes")?))).collect()
    }

    /// Whether a raw object is kept for an asset: not any more after it was given up.
    pub async fn keeps_raw(&self, asset: &AssetId, name: &str) -> Result<bool, StoreError> {
        let row = sqlx::query("SELECT bytes FROM raw_objects WHERE sha256 = $1 AND asset_id = $2")
            .bind(name)
            .bind(asset.as_str())
            .fetch_optional(self.read())
            .await?;
        Ok(row.is_some())
    }

    /// Gives up the oldest raw objects, of one asset or of all, until they are within `quota` bytes or `most`
    /// objects are gone; one process at a time, so that no more go than need to. Their segments stay. The
    /// files are the caller's to remove.
    pub async fn give_up_oldest(
        &self,
        asset: Option<&AssetId>,
        quota: u64,
        most: u32,
    ) -> Result<GivenUp, StoreError> {
        let mut transaction = self.write().begin().await?;
        // Others wait here until this transaction's end, and then see what it has left.
        sqlx::query("UPDATE counters SET value = value + 1 WHERE name = 'retention'")
            .execute(&mut *transaction)
            .await?;
        let bytes = volume(&mut transaction, asset).await?.saturating_sub(quota);
        if bytes == 0 {
            return Ok(GivenUp { is_within: true, ..GivenUp::default() });
        }
        let text = match asset {
            Some(_) => {
                "SELECT sha256, asset_id, bytes FROM raw_objects WHERE asset_id = $2 ORDER BY start_time_ns LIMIT $1"
            }
            None => "SELECT sha256, asset_id, bytes FROM raw_objects ORDER BY start_time_ns LIMIT $1",
        };
        let mut query = sqlx::query(text).bind(i64::from(most));
        if let Some(asset) = asset {
            query = query.bind(asset.as_str());
        }
        let mut given_up = GivenUp::default();
        let mut names = Vec::new();
        for row in query.fetch_all(&mut *transaction).await? {
            if given_up.bytes >= bytes {
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
                // Another process was first.
                continue;
            }
            sqlx::query("UPDATE raw_volumes SET bytes = bytes - $2 WHERE asset_id = $1")
                .bind(of.as_str())
                .bind(size)
                .execute(&mut *transaction)
                .await?;
            given_up.objects += 1;
            given_up.bytes += u64::try_from(size).unwrap_or(0);
            names.push(name);
        }
        let kept = kept_among(&mut transaction, &names).await?;
        transaction.commit().await?;
        names.retain(|name| !kept.contains(name));
        names.sort_unstable();
        names.dedup();
        given_up.orphans = names;
        given_up.is_within = given_up.bytes >= bytes;
        Ok(given_up)
    }

    /// Those of the names that no asset keeps.
    pub async fn orphans_among(&self, names: Vec<String>) -> Result<Vec<String>, StoreError> {
        let mut snapshot = self.read().begin().await?;
        let kept = kept_among(&mut snapshot, &names).await?;
        Ok(names.into_iter().filter(|name| !kept.contains(name)).collect())
    }
}

/// Bytes of raw objects kept for an asset, or for all.
async fn volume(
    transaction: &mut Transaction<'static, Any>,
    asset: Option<&AssetId>,
) -> Result<u64, StoreError> {
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

/// Those of the names that an asset keeps.
pub(super) async fn kept_among(
    transaction: &mut Transaction<'static, Any>,
    names: &[String],
) -> Result<HashSet<String>, StoreError> {
    let mut kept = HashSet::new();
    for chunk in names.chunks(NAMES_AT_ONCE) {
        let text = format!(
            "SELECT DISTINCT sha256 FROM raw_objects WHERE sha256 IN ({})",
            placeholders(1, chunk.len())
        );
        let mut query = sqlx::query(&text);
        for name in chunk {
            query = query.bind(name.as_str());
        }
        for row in query.fetch_all(&mut **transaction).await? {
            kept.insert(get(&row, "sha256")?);
        }
    }
    Ok(kept)
}
