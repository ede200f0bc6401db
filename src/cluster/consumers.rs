//! The consumers of the queue's stream: one for each partition, and one for unpartitioned records.

use std::collections::HashMap;

use async_nats::jetstream::consumer::{AckPolicy, Info, PullConsumer, pull};
use async_nats::jetstream::stream::Stream;
use futures_util::future::try_join_all;
use futures_util::{StreamExt, TryStreamExt};

use super::ClusterError;
use super::connection::Connection;
use super::partition::Source;

/// Number of consumers that are created at the same time.
const MAX_CONCURRENT: usize = 8;

impl Connection {
    /// Creates missing consumers and updates those with other settings: a worker of a version without
    /// partitions makes the consumer of unpartitioned records one of all records.
    pub(super) async fn prepare_consumers(&self) -> Result<(), ClusterError> {
        let stream = self.work().await?;
        let known: HashMap<String, Info> =
            consumers(&stream).await?.into_iter().map(|info| (info.name.clone(), info)).collect();
        let mut wanted = Vec::new();
        for source in Source::all(self.has_partitions()) {
            let config = self.config(source);
            let is_right = known.get(&source.consumer()).is_some_and(|info| {
                (&info.config.filter_subject, info.config.ack_wait)
                    == (&config.filter_subject, config.ack_wait)
            });
            if is_right {
                continue;
            }
            if source == Source::Unpartitioned {
                // As long as it is one of all records, the server refuses others beside it.
                create(&stream, config).await?;
            } else {
                wanted.push(config);
            }
        }
        for some in wanted.chunks(MAX_CONCURRENT) {
            try_join_all(some.iter().map(|config| create(&stream, config.clone()))).await?;
        }
        Ok(())
    }

    /// Returns the consumer of a source.
    pub(super) async fn consumer(&self, source: Source) -> Result<PullConsumer, ClusterError> {
        let found = self.jetstream.get_consumer_from_stream(source.consumer(), self.work_stream()).await;
        found.map_err(|error| ClusterError::jetstream("find a consumer")(error.into()))
    }

    /// Returns the queue's stream.
    pub(super) async fn work(&self) -> Result<Stream, ClusterError> {
        let found = self.jetstream.get_stream(self.work_stream()).await;
        found.map_err(|error| ClusterError::jetstream("find the queue")(error.into()))
    }

    fn config(&self, source: Source) -> pull::Config {
        pull::Config {
            durable_name: Some(source.consumer()),
            filter_subject: source.subject(self),
            ack_policy: AckPolicy::Explicit,
            ack_wait: self.settings().ack_wait,
            // Unlimited: the worker counts deliveries and moves the record to the dead letters.
            max_deliver: -1,
            max_ack_pending: -1,
            ..pull::Config::default()
        }
    }
}

/// Returns all consumers of the queue's stream; one request for up to 256.
pub(super) async fn consumers(stream: &Stream) -> Result<Vec<Info>, ClusterError> {
    let listed = stream.consumers().boxed().try_collect().await;
    listed.map_err(|error| ClusterError::jetstream("list the consumers")(error.into()))
}

async fn create(stream: &Stream, config: pull::Config) -> Result<(), ClusterError> {
    let created = stream.create_consumer(config).await;
    created.map(|_| ()).map_err(|error| ClusterError::jetstream("create a consumer")(error.into()))
}
