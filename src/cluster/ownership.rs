//! Ownership of partitions: a worker renews its lease, and claims or releases partitions until it has its
//! share.
//!
//! Ownership is for speed, not for correctness: a record that two workers process is stored once,
//! with the same result.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::watch;

use super::ClusterError;
use super::connection::Connection;
use super::rebalance::Rebalance;
use crate::service::{Service, ServiceError};
use crate::store::WORKER_LEASE;

/// Time between two renewals. A worker that joins has its share after two of them.
const INTERVAL: Duration = Duration::from_secs(2);

/// Timeout of a renewal: a connection that is cut off gives no error.
const RENEWAL_TIMEOUT: Duration = Duration::from_secs(4);

const STORE_TIMEOUT: ServiceError =
    ServiceError::Busy { what: "the store does not respond", retry_after_s: 2 };

/// The ownership of a worker.
pub(super) struct Ownership {
    pub(super) connection: Connection,
    pub(super) service: Arc<Service>,
    /// The worker's name.
    pub(super) worker: String,
    /// The partitions that the worker owns.
    pub(super) owned: watch::Sender<BTreeSet<u16>>,
}

impl Ownership {
    /// Keeps the worker's share until the worker stops, then releases everything.
    pub(super) async fn run(self, mut stop: watch::Receiver<bool>) {
        let (mut renewed_at, mut is_failing) = (Instant::now(), false);
        loop {
            let began = Instant::now();
            match self.renew().await {
                Ok(()) => (renewed_at, is_failing) = (began, false),
                Err(error) => {
                    if !std::mem::replace(&mut is_failing, true) {
                        tracing::warn!(%error, "failed to renew the ownership of partitions; retrying");
                    }
                    // Others own them by now, and can store their records.
                    if renewed_at.elapsed() >= WORKER_LEASE {
                        self.own(BTreeSet::new());
                    }
                }
            }
            tokio::select! {
                _ = stop.wait_for(|stop| *stop) => break,
                () = tokio::time::sleep(INTERVAL) => {}
            }
        }
        self.own(BTreeSet::new());
        let ended = self.service.store.end_queue_worker(&self.worker);
        if !matches!(tokio::time::timeout(RENEWAL_TIMEOUT, ended).await, Ok(Ok(()))) {
            tracing::warn!("failed to release partitions; others take them over when the lease expires");
        }
    }

    async fn renew(&self) -> Result<(), ClusterError> {
        // Without a connection to the queue, other workers should take the records.
        if let Some(fault) = self.connection.fault() {
            return Err(ClusterError::jetstream("renew the ownership of partitions")(fault.into()));
        }
        let renewed = tokio::time::timeout(RENEWAL_TIMEOUT, self.renew_in_store()).await;
        renewed.unwrap_or(Err(ClusterError::Ingest(STORE_TIMEOUT)))
    }

    async fn renew_in_store(&self) -> Result<(), ClusterError> {
        let (store, worker) = (&self.service.store, &self.worker);
        store.renew_queue_worker(worker, self.service.now()).await?;
        let mut owners = store.partition_owners().await?;
        let changes = Rebalance::of(worker, &owners);
        let mut owned = owners.remove(worker).unwrap_or_default();
        owned.retain(|partition| !changes.release.contains(partition));
        // This worker stops before another one starts.
        self.own(owned.clone());
        store.release_partitions(worker, &changes.release).await?;
        let claimed = store.claim_partitions(worker, &changes.claim).await?;
        if !changes.release.is_empty() || !claimed.is_empty() {
            tracing::info!(
                owned = owned.len() + claimed.len(),
                claimed = claimed.len(),
                released = changes.release.len(),
                "the partitions of this worker changed"
            );
        }
        owned.extend(claimed);
        self.own(owned);
        Ok(())
    }

    fn own(&self, partitions: BTreeSet<u16>) {
        self.owned.send_if_modified(|owned| {
            let is_changed = *owned != partitions;
            *owned = partitions;
            is_changed
        });
    }
}
