//! Rights that one process at a time has, in a bucket of JetStream whose entries go by themselves when their holder does not renew them.
//!
//! A lease spares work that would be done twice; that nothing goes wrong where it is done twice after all is up to the store.

use std::time::Duration;

use async_nats::jetstream::kv::{CreateErrorKind, Store};
use tokio::sync::oneshot;

use super::connection::Connection;
use crate::ingest::Lease;

/// How long a lease lasts without being renewed.
pub(super) const LASTS: Duration = Duration::from_secs(15);

/// The leases of a cluster.
#[derive(Clone)]
pub(super) struct Leases {
    connection: Connection,
}

/// Dropped with the lease: then it is given back.
struct Held {
    _end: oneshot::Sender<()>,
}

impl Leases {
    pub(super) fn new(connection: Connection) -> Self {
        Self { connection }
    }

    /// The right to do `duty`, renewed until it is dropped; none where another process has it or NATS cannot say.
    pub(super) async fn take(&self, duty: &str) -> Option<Lease> {
        let bucket = self.connection.leases_bucket();
        let store = self.connection.jetstream.get_key_value(bucket).await;
        let store = store.inspect_err(|error| tracing::debug!(%error, duty, "no lease")).ok()?;
        let key = key(duty);
        let revision = match store.create(&key, bytes::Bytes::new()).await {
            Ok(revision) => revision,
            Err(error) => {
                if error.kind() != CreateErrorKind::AlreadyExists {
                    tracing::debug!(%error, duty, "no lease");
                }
                return None;
            }
        };
        let (end, ended) = oneshot::channel();
        tokio::spawn(hold(store, key, revision, ended));
        Some(Box::new(Held { _end: end }))
    }
}

async fn hold(store: Store, key: String, mut revision: u64, mut ended: oneshot::Receiver<()>) {
    let mut renewed = tokio::time::Instant::now();
    loop {
        tokio::select! {
            _ = &mut ended => break,
            () = tokio::time::sleep(LASTS / 3) => {}
        }
        match store.update(&key, bytes::Bytes::new(), revision).await {
            Ok(next) => (revision, renewed) = (next, tokio::time::Instant::now()),
            Err(error) if renewed.elapsed() < LASTS => tracing::debug!(%error, key, "lease not renewed yet"),
            Err(error) => {
                tracing::warn!(%error, key, "lease lost");
                return;
            }
        }
    }
    // Where it cannot be given back it ends by itself.
    if let Err(error) = store.delete_expect_revision(&key, Some(revision)).await {
        tracing::debug!(%error, key, "lease not given back");
    }
}

/// A duty's name as a key: what a key cannot hold is written as its bytes.
fn key(duty: &str) -> String {
    let mut key = String::with_capacity(duty.len());
    for byte in duty.bytes() {
        if byte.is_ascii_alphanumeric() || b"-_.".contains(&byte) {
            key.push(char::from(byte));
        } else {
            key.push_str(&format!("={byte:02x}"));
        }
    }
    key
}
