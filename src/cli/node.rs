//! A process of a cluster put together: an API node, or a worker.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use crate::cluster::{Cluster, ClusterSecrets, ClusterSettings, ClusterTable, RunningWorker, Words};
use crate::http::{HealthServer, Node, RunningService, ServiceConfig, SharedEvents, live_events, lost_events, start_node};
use crate::ingest::{Ingest, IngestFolders, Part, SystemClock};
use crate::store::{SharedSettings, Store, StoreError, StoreSettings};

use super::serve::ServeError;

/// How announcements are put into words.
const WORDS: Words = Words {
    of: live_events,
    lost: lost_events,
};

/// The settings of a cluster's table and the environment.
pub(super) fn resolve(table: ClusterTable) -> Result<ClusterSettings, ServeError> {
    let said = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
    let secrets = ClusterSecrets {
        database_url: said("FLANKWATCH_DATABASE_URL"),
        nats_password: said("FLANKWATCH_NATS_PASSWORD"),
        nats_token: said("FLANKWATCH_NATS_TOKEN"),
        s3_access_key_id: said("FLANKWATCH_S3_ACCESS_KEY_ID"),
        s3_secret_access_key: said("FLANKWATCH_S3_SECRET_ACCESS_KEY"),
    };
    Ok(table.resolve(secrets)?)
}

/// Opens the shared store; a database that is away is waited for.
async fn open(settings: SharedSettings) -> Result<Store, StoreError> {
    let settings = StoreSettings::Shared(settings);
    loop {
        match Store::open(&settings).await {
            Err(error) if error.is_unavailable() => {
                tracing::warn!(%error, "the store is away, trying again");
                tokio::time::sleep(Duration::from_secs(2)).await;
            }
            opened => return opened,
        }
    }
}

/// Opens the shared store for a moment; where it is away that is said.
pub(super) async fn open_once(settings: SharedSettings) -> Result<Store, ServeError> {
    let opened = Store::open(&StoreSettings::Shared(settings)).await;
    Ok(opened.map_err(crate::cluster::ClusterError::from)?)
}

/// Starts an API node.
pub(super) async fn start_api(service: ServiceConfig, settings: ClusterSettings) -> Result<RunningService, ServeError> {
    let cluster = Cluster::join(settings.nats).await?;
    let store = open(settings.store).await.map_err(crate::cluster::ClusterError::from)?;
    let heard = cluster.hear().await;
    let node = Node {
        store,
        crew: cluster.crew_of_node(),
        events: SharedEvents {
            run: heard.run,
            backlog: heard.backlog,
            receiver: heard.receiver,
        },
    };
    let running = start_node(service, node, Arc::new(SystemClock)).await?;
    cluster.tell(running.ingest(), WORDS);
    Ok(running)
}

/// A worker with what it tells and its health.
pub(super) struct Working {
    worker: RunningWorker,
    ingest: Ingest,
    told: tokio::task::JoinHandle<()>,
    health: Option<HealthServer>,
}

/// Starts a worker; `service` says where its folder is and how much it takes on.
pub(super) async fn start_worker(
    service: ServiceConfig,
    settings: ClusterSettings,
    health: Option<SocketAddr>,
) -> Result<Working, ServeError> {
    let cluster = Cluster::join(settings.nats).await?;
    let store = open(settings.store).await.map_err(crate::cluster::ClusterError::from)?;
    let folders = IngestFolders {
        libraries: service.data_dir.join("libraries"),
        recordings: service.data_dir.join("recordings"),
        uploads: service.data_dir.join("uploads"),
    };
    let part = Part::Worker(cluster.crew_of_worker());
    let ingest = Ingest::with_part(store, folders, &service.ingest, service.grid, Arc::new(SystemClock), part)
        .map_err(crate::cluster::ClusterError::from)?;
    let health = match health {
        Some(address) => Some(HealthServer::start(address, ingest.clone()).await?),
        None => None,
    };
    let told = cluster.tell(&ingest, WORDS);
    let worker = cluster.start_worker(ingest.clone(), settings.worker);
    Ok(Working {
        worker,
        ingest,
        told,
        health,
    })
}

impl Working {
    /// Where the health is told.
    pub(super) fn health(&self) -> Option<SocketAddr> {
        self.health.as_ref().map(HealthServer::address)
    }

    /// Ends what was begun, within the time of grace.
    pub(super) async fn stop(self, grace: Duration) {
        let end = async {
            self.worker.stop().await;
            let store = self.ingest.store().clone();
            drop(self.ingest);
            // What others do with the path of records may still hold it.
            let _ = tokio::time::timeout(Duration::from_secs(1), self.told).await;
            store.close().await;
        };
        if tokio::time::timeout(grace, end).await.is_err() {
            tracing::warn!("records were still under way at the end of the time of grace: others will take them");
        }
    }
}
