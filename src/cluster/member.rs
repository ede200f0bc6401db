//! A process in a cluster: a node or a worker.

use std::sync::Arc;

use tokio::sync::watch;
use tokio::task::JoinHandle;

use super::connection::Connection;
use super::events::Subscription;
use super::queue::Queue;
use super::{ClusterError, DeadLetter, NatsSettings, WorkerLimits};
use super::{dead_letters, events, overview, worker};
use crate::service::{QueueOverview, Service, WorkQueue};

/// A process's place in a cluster.
pub struct Cluster {
    connection: Connection,
}

/// A worker at work.
pub struct RunningWorker {
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
}

impl Cluster {
    /// Connects to NATS and makes what is missing there.
    ///
    /// Errors: credentials that cannot be read; a server that refuses.
    pub async fn join(settings: NatsSettings) -> Result<Self, ClusterError> {
        let connection = Connection::open(settings).await?;
        if let Err(error) = connection.prepare().await {
            // Workers and uploads make it when NATS is back.
            tracing::warn!(%error, "failed to make the cluster's streams: trying again when NATS is back");
        }
        Ok(Self { connection })
    }

    /// Connects to NATS to look at a cluster; nothing is made there.
    ///
    /// Errors: credentials that cannot be read; a server that refuses.
    pub async fn look_at(settings: NatsSettings) -> Result<Self, ClusterError> {
        let connection = Connection::open(settings).await?;
        connection.wait_until_connected().await?;
        Ok(Self { connection })
    }

    /// The queue of an API node.
    pub fn queue_of_node(&self) -> Arc<dyn WorkQueue> {
        Arc::new(Queue::new(self.connection.clone(), true))
    }

    /// The queue of a worker.
    pub fn queue_of_worker(&self) -> Arc<dyn WorkQueue> {
        Arc::new(Queue::new(self.connection.clone(), false))
    }

    /// What waits in the queue, and which workers answer.
    pub async fn overview(&self) -> Result<QueueOverview, ClusterError> {
        overview::look(&self.connection).await
    }

    /// The records that could not be stored.
    pub async fn dead_letters(&self) -> Result<Vec<DeadLetter>, ClusterError> {
        dead_letters::list(&self.connection).await
    }

    /// One of the records that could not be stored.
    pub async fn dead_letter(&self, number: u64) -> Result<DeadLetter, ClusterError> {
        dead_letters::letter(&self.connection, number).await
    }

    /// Puts the record of a dead letter back into the queue.
    pub async fn retry_dead_letter(&self, number: u64) -> Result<(), ClusterError> {
        dead_letters::retry(&self.connection, number).await
    }

    /// Takes a dead letter away; its raw bytes go where nothing else refers to them.
    pub async fn drop_dead_letter(&self, number: u64) -> Result<(), ClusterError> {
        dead_letters::drop_letter(&self.connection, number).await
    }

    /// Publishes to all nodes what a process announces, until it ends.
    pub fn publish_events(&self, service: &Service) -> JoinHandle<()> {
        tokio::spawn(events::publish(self.connection.clone(), service.events.follow()))
    }

    /// Subscribes to the events of all processes.
    pub async fn subscribe(&self) -> Subscription {
        events::subscribe(self.connection.clone()).await
    }

    /// Begins to work on the records of the queue.
    pub fn start_worker(&self, service: Arc<Service>, limits: WorkerLimits) -> RunningWorker {
        let (stop, stopped) = watch::channel(false);
        let worker = worker::Worker::new(self.connection.clone(), service, limits, stopped);
        RunningWorker { stop, task: tokio::spawn(worker.run()) }
    }
}

impl RunningWorker {
    /// Takes no more records, and waits until those that were begun are committed and acknowledged.
    pub async fn stop(self) {
        self.stop.send_replace(true);
        if let Err(error) = self.task.await {
            tracing::error!(%error, "the worker task failed");
        }
    }
}
