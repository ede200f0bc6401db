//! Leases for building a library, so that only one process builds it.

use jiff::{SignedDuration, Timestamp};

use crate::store::database::rows::{lease_end, to_ns};
use crate::store::{Store, StoreError};

/// Length of a builder's lease, from its last renewal.
const LEASE: SignedDuration = SignedDuration::from_secs(60);

impl Store {
    /// Acquires the lease to build a library; returns false if another process has it.
    pub async fn begin_building(&self, library: &str, now: Timestamp) -> Result<bool, StoreError> {
        let now = self.now(now).await?;
        let begun = sqlx::query(
            "INSERT INTO library_builds (library_id, builder_until_ns) VALUES ($1, $2)
             ON CONFLICT (library_id) DO UPDATE SET builder_until_ns = excluded.builder_until_ns WHERE library_builds.builder_until_ns < $3",
        )
        .bind(library)
        .bind(alive_until(now)?)
        .bind(to_ns(now)?)
        .execute(self.write()?)
        .await?;
        Ok(begun.rows_affected() > 0)
    }

    /// Renews the lease to build a library.
    pub async fn renew_building(&self, library: &str, now: Timestamp) -> Result<(), StoreError> {
        let now = self.now(now).await?;
        sqlx::query("UPDATE library_builds SET builder_until_ns = $2 WHERE library_id = $1")
            .bind(library)
            .bind(alive_until(now)?)
            .execute(self.write()?)
            .await?;
        Ok(())
    }

    /// Releases the lease to build a library, so that another process can acquire it at once.
    pub async fn end_building(&self, library: &str) -> Result<(), StoreError> {
        sqlx::query("DELETE FROM library_builds WHERE library_id = $1")
            .bind(library)
            .execute(self.write()?)
            .await?;
        Ok(())
    }
}

fn alive_until(now: Timestamp) -> Result<i64, StoreError> {
    to_ns(lease_end(now, LEASE))
}
