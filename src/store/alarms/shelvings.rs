//! Expired shelvings of alarms.

use jiff::Timestamp;

use crate::store::database::rows::{get, to_ns};
use crate::store::{Store, StoreError};

impl Store {
    /// Identifiers of up to `limit` alarms whose shelving has expired at `now` and is not ended yet.
    pub async fn expired_shelvings(&self, now: Timestamp, limit: u32) -> Result<Vec<String>, StoreError> {
        let rows = sqlx::query(
            "SELECT id FROM alarms WHERE shelved_until_ns <= $1 ORDER BY shelved_until_ns, id LIMIT $2",
        )
        .bind(to_ns(now)?)
        .bind(i64::from(limit))
        .fetch_all(self.read())
        .await?;
        rows.iter().map(|row| get(row, "id")).collect()
    }
}
