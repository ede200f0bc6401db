//! Assembly of a cluster process: an API node or a worker.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use crate::cluster::{Cluster, ClusterSettings, RunningWorker};
use crate::http::{HealthServer, Node, RunningService, ServiceConfig, start_node};
use crate::notifications::{NotificationSettings, Notifier};
use crate::service::{Role, Service, ServiceFolders, SystemClock};
use crate::store::{SharedSettings, Store, StoreError, StoreSettings};

use super::serve_error::ServeError;

/// Opens the shared store; retries while the database is unavailable.
async fn open(settings: SharedSettings) -> Result<Store, StoreError> {
    let settings = StoreSettings::Shared(settings);
    loop {
        match Store::open(&settings).await {
            Err(error) if error.is_unavailable() => {
                tracing::warn!(%error, "failed to open the store; retrying");
                tokio::time::sleep(Duration::from_secs(2)).await;
            }
            opened => return opened,
        }
    }
}

/// Starts an API node.
pub(super) async fn start_api(
    service: ServiceConfig,
    settings: ClusterSettings,
) -> Result<RunningService, ServeError> {
    let cluster = Cluster::join(settings.nats).await?;
    let store = open(settings.store).await.map_err(crate::cluster::ClusterError::from)?;
    let events = cluster.subscribe().await;
    let node = Node { store, queue: cluster.queue_of_node(), events };
    let running = start_node(service, node, Arc::new(SystemClock)).await?;
    cluster.publish_events(running.service());
    Ok(running)
}

/// A running worker process: worker, event publisher, notifier and health server.
pub(super) struct WorkerProcess {
    worker: RunningWorker,
    service: Arc<Service>,
    publishing: tokio::task::JoinHandle<()>,
    notifier: Notifier,
    health: Option<HealthServer>,
}

/// Starts a worker; `config` has its data folder and its limits.
pub(super) async fn start_worker(
    config: ServiceConfig,
    settings: ClusterSettings,
    notifications: NotificationSettings,
    health: Option<SocketAddr>,
) -> Result<WorkerProcess, ServeError> {
    let cluster = Cluster::join(settings.nats).await?;
    let store = open(settings.store).await.map_err(crate::cluster::ClusterError::from)?;
    store.notify(config.recipients);
    let folders = ServiceFolders::in_data_folder(&config.data_dir);
    let role = Role::Worker(cluster.queue_of_worker());
    let service = Service::new(store, folders, &config.work, config.grid, Arc::new(SystemClock), role)
        .map_err(crate::cluster::ClusterError::from)?;
    let health = match health {
        Some(address) => Some(HealthServer::start(address, service.clone()).await?),
        None => None,
    };
    let publishing = cluster.publish_events(&service);
    let worker = cluster.start_worker(service.clone(), settings.worker);
    let notifier = Notifier::start(notifications, &service);
    Ok(WorkerProcess { worker, service, publishing, notifier, health })
}

impl WorkerProcess {
    /// Address of the health server, if any.
    pub(super) fn health(&self) -> Option<SocketAddr> {
        self.health.as_ref().map(HealthServer::address)
    }

    /// Finishes the records in progress and stops, within the grace period.
    pub(super) async fn stop(self, grace: Duration) {
        let end = async {
            self.worker.stop().await;
            self.notifier.stop(grace).await;
            let store = self.service.store.clone();
            drop(self.service);
            // Other tasks may still hold the service; the publisher ends when the last of them drops it.
            let _ = tokio::time::timeout(Duration::from_secs(1), self.publishing).await;
            store.close().await;
        };
        if tokio::time::timeout(grace, end).await.is_err() {
            tracing::warn!(
                "failed to finish all records within the grace period; other workers take them over"
            );
        }
    }
}
