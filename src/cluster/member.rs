//! A process of a cluster: an API node, a worker, or a command.

use std::sync::Arc;

use tokio::sync::watch;
use tokio::task::JoinHandle;

use super::connection::Connection;
use super::queue::Queue;
use super::{ClusterError, DeadLetter, NatsSettings, WorkerLimits};
use super::{dead_letters, events, overview, worker};
use crate::service::{QueueOverview, Service, SharedEvents, WorkQueue};

/// A process's connection to a cluster.
pub struct Cluster {
    connection: Connection,
}

/// A running worker.
pub struct RunningWorker {
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
}

impl Cluster {
    /// Connects to NATS and creates missing streams.
    ///
    /// # Errors
    /// The credentials cannot be read, or a server rejects the connection.
    pub async fn join(settings: NatsSettings) -> Result<Self, ClusterError> {
        let connection = Connection::open(settings).await?;
        if let Err(error) = connection.prepare().await {
            // Workers and uploads create the streams once NATS is available.
            tracing::warn!(%error, "failed to create the cluster's streams; retrying when NATS is available");
        }
        Ok(Self { connection })
    }

    /// Connects to NATS to inspect a cluster; creates nothing.
    ///
    /// # Errors
    /// The credentials cannot be read, a server rejects the connection, or none answers.
    pub async fn connect(settings: NatsSettings) -> Result<Self, ClusterError> {
        let connection = Connection::open(settings).await?;
        connection.wait_until_connected().await?;
        Ok(Self { connection })
    }

    /// Returns the queue of an API node.
    pub fn queue_of_node(&self) -> Arc<dyn WorkQueue> {
        Arc::new(Queue::new(self.connection.clone(), true))
    }

    /// Returns the queue of a worker.
    pub fn queue_of_worker(&self) -> Arc<dyn WorkQueue> {
        Arc::new(Queue::new(self.connection.clone(), false))
    }

    /// Queries the queue and the workers that respond.
    pub async fn overview(&self) -> Result<QueueOverview, ClusterError> {
        overview::query(&self.connection).await
    }

    /// Lists the dead letters, oldest first.
    pub async fn dead_letters(&self) -> Result<Vec<DeadLetter>, ClusterError> {
        dead_letters::list(&self.connection).await
    }

    /// Returns one dead letter.
    pub async fn dead_letter(&self, number: u64) -> Result<DeadLetter, ClusterError> {
        dead_letters::get(&self.connection, number).await
    }

    /// Puts the record of a dead letter back into the queue.
    pub async fn retry_dead_letter(&self, number: u64) -> Result<(), ClusterError> {
        dead_letters::retry(&self.connection, number).await
    }

    /// Deletes a dead letter; its raw recording moves to quarantine unless something else refers to it.
    pub async fn drop_dead_letter(&self, number: u64) -> Result<(), ClusterError> {
        dead_letters::remove(&self.connection, number).await
    }

    /// Publishes a process's events to all nodes, until the process ends.
    pub fn publish_events(&self, service: &Service) -> JoinHandle<()> {
        tokio::spawn(events::publish(self.connection.clone(), service.events.subscribe()))
    }

    /// Subscribes to the events of all processes.
    pub async fn subscribe(&self) -> SharedEvents {
        events::subscribe(self.connection.clone()).await
    }

    /// Starts a worker on the records of the queue.
    pub fn start_worker(&self, service: Arc<Service>, limits: WorkerLimits) -> RunningWorker {
        let (stop, stopped) = watch::channel(false);
        let worker = worker::Worker::new(self.connection.clone(), service, limits, stopped);
        RunningWorker { stop, task: tokio::spawn(worker.run()) }
    }
}

impl RunningWorker {
    /// Stops taking records and waits until those in progress are committed and acknowledged.
    pub async fn stop(self) {
        self.stop.send_replace(true);
        if let Err(error) = self.task.await {
            tracing::error!(%error, "the worker task failed");
        }
    }
}
