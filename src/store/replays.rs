//! Storage of replays as numbered texts, whose format is up to the caller.

use super::database::rows::{get, get_count};
use super::{Store, StoreError};

impl Store {
    /// Inserts or replaces a replay.
    pub async fn save_replay(&self, number: u64, replay: &str) -> Result<(), StoreError> {
        sqlx::query("INSERT INTO replays (number, replay) VALUES ($1, $2) ON CONFLICT (number) DO UPDATE SET replay = excluded.replay")
            .bind(i64::try_from(number).unwrap_or(i64::MAX))
            .bind(replay)
            .execute(self.write()?)
            .await?;
        Ok(())
    }

    /// Deletes all replays before a number.
    pub async fn forget_replays_before(&self, number: u64) -> Result<(), StoreError> {
        sqlx::query("DELETE FROM replays WHERE number < $1")
            .bind(i64::try_from(number).unwrap_or(i64::MAX))
            .execute(self.write()?)
            .await?;
        Ok(())
    }

    /// All stored replays, by number.
    pub async fn saved_replays(&self) -> Result<Vec<(u64, String)>, StoreError> {
        let rows =
            sqlx::query("SELECT number, replay FROM replays ORDER BY number").fetch_all(self.read()).await?;
        rows.iter().map(|row| Ok((get_count(row, "number")?, get(row, "replay")?))).collect()
    }
}
