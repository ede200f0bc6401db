//! Work that any process may take over because the one responsible for it may have died, and the shared
//! clock.

use jiff::{SignedDuration, Timestamp};

use crate::asset::AssetId;
use crate::store::database::rows::{asset_id, get, get_time, to_ns};
use crate::store::{Store, StoreError};

/// Time between two searches for unreferenced objects by any process.
const SWEEP_INTERVAL: SignedDuration = SignedDuration::from_hours(24);

impl Store {
    /// Up to `limit` assets with a history that may be outdated.
    pub async fn outdated_assets(&self, limit: u32) -> Result<Vec<AssetId>, StoreError> {
        let rows = sqlx::query(
            "SELECT id FROM assets a WHERE settled_revision < revision
                OR EXISTS (SELECT 1 FROM channels c WHERE c.asset_id = a.id AND c.must_fold + c.leftovers > 0) LIMIT $1",
        )
        .bind(i64::from(limit))
        .fetch_all(self.read())
        .await?;
        rows.iter().map(|row| asset_id(get(row, "id")?)).collect()
    }

    /// Marks all histories of an asset as up to date at a version of it.
    pub async fn mark_up_to_date(&self, asset: &AssetId, version: i64) -> Result<(), StoreError> {
        sqlx::query("UPDATE assets SET settled_revision = $2 WHERE id = $1 AND settled_revision < $2")
            .bind(asset.as_str())
            .bind(version)
            .execute(self.write()?)
            .await?;
        Ok(())
    }

    /// The current time: on a shared store by the database's clock, which is the same for all processes.
    pub async fn now(&self, local: Timestamp) -> Result<Timestamp, StoreError> {
        let Some(text) = self.dialect().time_ns() else {
            return Ok(local);
        };
        let row = sqlx::query(text).fetch_one(self.read()).await?;
        get_time(&row, "now_ns")
    }

    /// Claims the search for unreferenced objects; returns false if a process made one within the last day.
    pub async fn begin_sweep(&self, now: Timestamp) -> Result<bool, StoreError> {
        self.begin_round("swept_at_ns", now, SWEEP_INTERVAL).await
    }

    /// Claims a round of work; returns false if a process made one within the interval. A round in the
    /// future, made while the clock was ahead, delays none.
    pub(in crate::store) async fn begin_round(
        &self,
        counter: &'static str,
        now: Timestamp,
        interval: SignedDuration,
    ) -> Result<bool, StoreError> {
        let due = now.saturating_sub(interval).unwrap_or(Timestamp::MIN);
        let begun =
            sqlx::query("UPDATE counters SET value = $1 WHERE name = $3 AND (value <= $2 OR value > $1)")
                .bind(to_ns(now)?)
                .bind(to_ns(due)?)
                .bind(counter)
                .execute(self.write()?)
                .await?;
        Ok(begun.rows_affected() > 0)
    }

    /// Whether the store was closed.
    pub fn is_closed(&self) -> bool {
        self.read().is_closed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::StoreSettings;

    #[tokio::test]
    async fn a_round_is_due_after_its_interval_or_if_the_last_one_lies_in_the_future() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&StoreSettings::Folder(folder.path().to_owned())).await.unwrap();
        for (hour, is_due) in
            [(100, true), (110, false), (124, true), (9000, true), (130, true), (131, false)]
        {
            let now = Timestamp::UNIX_EPOCH + SignedDuration::from_hours(hour);
            assert_eq!(store.begin_sweep(now).await.unwrap(), is_due, "hour {hour}");
        }
    }
}
