//! What is left to be done by whichever process finds it, where one that had it to do may have died.

use jiff::{SignedDuration, Timestamp};

use super::rows::{asset_id, get, to_ns};
use super::{Store, StoreError};
use crate::asset::AssetId;

/// Between two searches for objects that nothing refers to, whichever process makes them.
const SWEPT_EVERY: SignedDuration = SignedDuration::from_hours(24);

impl Store {
    /// Up to `limit` assets of which a channel's history may not be as it is asked for.
    pub async fn unsettled_assets(&self, limit: u32) -> Result<Vec<AssetId>, StoreError> {
        let rows = sqlx::query(
            "SELECT id FROM assets a WHERE settled_revision < revision
                OR EXISTS (SELECT 1 FROM channels c WHERE c.asset_id = a.id AND c.must_fold + c.leftovers > 0) LIMIT $1",
        )
        .bind(i64::from(limit))
        .fetch_all(self.read())
        .await?;
        rows.iter().map(|row| asset_id(get(row, "id")?)).collect()
    }

    /// Says that all histories of an asset are as they were asked for at a version of it.
    pub async fn settle_asset(&self, asset: &AssetId, version: i64) -> Result<(), StoreError> {
        sqlx::query("UPDATE assets SET settled_revision = $2 WHERE id = $1 AND settled_revision < $2")
            .bind(asset.as_str())
            .bind(version)
            .execute(self.write())
            .await?;
        Ok(())
    }

    /// The time: where processes share the store by the database's clock, which is one for all of them.
    pub async fn now(&self, local: Timestamp) -> Result<Timestamp, StoreError> {
        let Some(text) = self.dialect().time_ns() else {
            return Ok(local);
        };
        let row = sqlx::query(text).fetch_one(self.read()).await?;
        super::rows::get_time(&row, "now_ns")
    }

    /// Whether this process is to search for objects that nothing refers to: none did for a day.
    pub async fn begin_sweep(&self, now: Timestamp) -> Result<bool, StoreError> {
        let begun = sqlx::query("UPDATE counters SET value = $1 WHERE name = 'swept_at_ns' AND value <= $2")
            .bind(to_ns(now)?)
            .bind(to_ns(now.saturating_sub(SWEPT_EVERY).unwrap_or(Timestamp::MIN))?)
            .execute(self.write())
            .await?;
        Ok(begun.rows_affected() > 0)
    }

    /// Whether the store was closed.
    pub fn is_closed(&self) -> bool {
        self.write().is_closed()
    }
}
