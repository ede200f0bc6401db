//! Leases of workers, and the partitions of the queue that they own.
//!
//! A worker has one lease, whatever the number of its partitions: its renewal writes one row. When the lease
//! has expired, the worker's row is removed, and the rows of its partitions with it.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use jiff::Timestamp;

use crate::store::database::rows::{get, lease_end, placeholders, rows_of_placeholders, to_ns};
use crate::store::{Store, StoreError};

/// Length of a worker's lease, from its last renewal.
pub const WORKER_LEASE: Duration = Duration::from_secs(10);

/// The workers whose lease has not expired, with the partitions that each of them owns.
pub type PartitionOwners = BTreeMap<String, BTreeSet<u16>>;

impl Store {
    /// Renews the lease of a worker, and removes the workers whose leases have expired.
    pub async fn renew_queue_worker(&self, worker: &str, now: Timestamp) -> Result<(), StoreError> {
        let now = self.now(now).await?;
        sqlx::query(
            "INSERT INTO queue_workers (worker, alive_until_ns) VALUES ($1, $2)
             ON CONFLICT (worker) DO UPDATE SET alive_until_ns = excluded.alive_until_ns",
        )
        .bind(worker)
        .bind(to_ns(lease_end(now, WORKER_LEASE))?)
        .execute(self.write()?)
        .await?;
        sqlx::query("DELETE FROM queue_workers WHERE alive_until_ns < $1")
            .bind(to_ns(now)?)
            .execute(self.write()?)
            .await?;
        Ok(())
    }

    /// The workers and their partitions.
    pub async fn partition_owners(&self) -> Result<PartitionOwners, StoreError> {
        let rows = sqlx::query(
            "SELECT w.worker, p.partition_no FROM queue_workers w LEFT JOIN queue_partitions p ON p.worker = w.worker",
        )
        .fetch_all(self.read())
        .await?;
        let mut owners = PartitionOwners::new();
        for row in &rows {
            let owned = owners.entry(get(row, "worker")?).or_default();
            owned.extend(
                get::<Option<i64>>(row, "partition_no")?.and_then(|number| u16::try_from(number).ok()),
            );
        }
        Ok(owners)
    }

    /// Makes a worker the owner of those of the partitions that have none; returns these.
    pub async fn claim_partitions(
        &self,
        worker: &str,
        partitions: &[u16],
    ) -> Result<BTreeSet<u16>, StoreError> {
        if partitions.is_empty() {
            return Ok(BTreeSet::new());
        }
        let text = format!(
            "INSERT INTO queue_partitions (partition_no, worker) VALUES {}
             ON CONFLICT (partition_no) DO NOTHING RETURNING partition_no",
            rows_of_placeholders(partitions.len(), 2)
        );
        let query = sqlx::query(&text).persistent(false);
        let query =
            partitions.iter().fold(query, |query, partition| query.bind(i64::from(*partition)).bind(worker));
        let claimed = query.fetch_all(self.write()?).await?;
        let numbers = claimed.iter().map(|row| get::<i64>(row, "partition_no"));
        numbers.filter_map(|number| number.map(|number| u16::try_from(number).ok()).transpose()).collect()
    }

    /// Ends a worker's ownership of partitions.
    pub async fn release_partitions(&self, worker: &str, partitions: &[u16]) -> Result<(), StoreError> {
        if partitions.is_empty() {
            return Ok(());
        }
        let text = format!(
            "DELETE FROM queue_partitions WHERE worker = $1 AND partition_no IN ({})",
            placeholders(2, partitions.len())
        );
        let query = sqlx::query(&text).persistent(false).bind(worker);
        let query = partitions.iter().fold(query, |query, partition| query.bind(i64::from(*partition)));
        query.execute(self.write()?).await?;
        Ok(())
    }

    /// Ends the lease of a worker and its ownership of all partitions.
    pub async fn end_queue_worker(&self, worker: &str) -> Result<(), StoreError> {
        sqlx::query("DELETE FROM queue_workers WHERE worker = $1")
            .bind(worker)
            .execute(self.write()?)
            .await?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_partition_has_one_owner_until_its_lease_ends() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().into()).await.unwrap();
        let start: Timestamp = "2026-01-01T00:00:00Z".parse().unwrap();
        let later = start + WORKER_LEASE + Duration::from_secs(1);
        let set = |numbers: &[u16]| numbers.iter().copied().collect::<BTreeSet<_>>();
        store.renew_queue_worker("a", start).await.unwrap();
        store.renew_queue_worker("b", start).await.unwrap();
        assert_eq!(store.claim_partitions("a", &[1, 2, 3]).await.unwrap(), set(&[1, 2, 3]));
        assert_eq!(store.claim_partitions("b", &[3, 4]).await.unwrap(), set(&[4]));
        store.release_partitions("a", &[2, 4]).await.unwrap();
        let owners = store.partition_owners().await.unwrap();
        assert_eq!((&owners["a"], &owners["b"]), (&set(&[1, 3]), &set(&[4])));

        // The lease of `a` has expired, and `b` sees that with its next renewal.
        store.renew_queue_worker("b", later).await.unwrap();
        assert_eq!(store.claim_partitions("b", &[1]).await.unwrap(), set(&[1]));
        // A worker without a lease owns nothing.
        assert!(store.claim_partitions("a", &[7]).await.is_err());
        store.renew_queue_worker("a", later).await.unwrap();
        assert_eq!(store.partition_owners().await.unwrap()["a"], set(&[]));

        store.end_queue_worker("b").await.unwrap();
        assert_eq!(store.claim_partitions("a", &[1, 4]).await.unwrap(), set(&[1, 4]));
        store.close().await;
    }
}
