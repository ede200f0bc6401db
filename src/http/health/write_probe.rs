//! Checks whether a record could be stored, by writing a small item to every part that stores a piece of one.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::Mutex;

use crate::service::{PartHealth, Service};
use crate::store::StoreError;

/// Timeout after which a part counts as unavailable.
pub(crate) const RESPONSE_TIMEOUT: Duration = Duration::from_secs(3);

/// Time for which a result is reused, however often it is requested.
const KNOWN_FOR: Duration = Duration::from_secs(2);

/// The result of a check.
#[derive(Debug, Clone, Default)]
pub(crate) struct Writability {
    /// Why the database cannot be written to; `None` if it can.
    pub(crate) database: Option<String>,
    /// Why a record does not fit on the disk; `None` if it does.
    pub(crate) free_space: Option<String>,
    /// The parts shared by processes.
    pub(crate) parts: Vec<PartHealth>,
}

/// Writes, and caches the result.
#[derive(Debug, Default)]
pub(crate) struct WriteProbe(Mutex<Option<(Instant, Writability)>>);

impl Writability {
    pub(crate) fn is_whole(&self) -> bool {
        self.database.is_none()
            && self.free_space.is_none()
            && self.parts.iter().all(|part| part.fault.is_none())
    }
}

impl WriteProbe {
    /// Returns the current or a recent result. Concurrent callers wait for the same check.
    pub(crate) async fn ask(&self, service: &Arc<Service>) -> Writability {
        let mut last = self.0.lock().await;
        if let Some((found_at, found)) = last.as_ref()
            && found_at.elapsed() < KNOWN_FOR
        {
            return found.clone();
        }
        let found = write(service).await;
        *last = Some((Instant::now(), found.clone()));
        found
    }
}

async fn write(service: &Arc<Service>) -> Writability {
    let queue = async {
        match service.role.queue() {
            Some(queue) => queue.health().await,
            None => Vec::new(),
        }
    };
    let (database, free_space, bucket, mut parts) =
        tokio::join!(database(service), free_space(service), object_store(service), queue);
    parts.extend(bucket);
    Writability { database, free_space, parts }
}

async fn database(service: &Service) -> Option<String> {
    match tokio::time::timeout(RESPONSE_TIMEOUT, service.store.check_writable(service.now())).await {
        Ok(Ok(())) => None,
        Ok(Err(error)) => Some(error.to_string()),
        Err(_) => Some("does not answer".to_owned()),
    }
}

/// Why a record does not fit on this machine's disk.
async fn free_space(service: &Service) -> Option<String> {
    // A damaged database is not written to, and reported separately
    if service.store.damage().is_some() {
        return None;
    }
    let store = service.store.clone();
    on_objects(move || store.objects().check_free_space()).await
}

/// For processes that share a store: whether the object store can be written to.
async fn object_store(service: &Service) -> Option<PartHealth> {
    if !service.store.is_shared() {
        return None;
    }
    let store = service.store.clone();
    Some(PartHealth {
        part: "object_store",
        fault: on_objects(move || store.objects().check_writable()).await,
    })
}

async fn on_objects(look: impl FnOnce() -> Result<(), StoreError> + Send + 'static) -> Option<String> {
    match tokio::time::timeout(RESPONSE_TIMEOUT, tokio::task::spawn_blocking(look)).await {
        Ok(Ok(Ok(()))) => None,
        Ok(Ok(Err(error))) => Some(error.to_string()),
        Ok(Err(error)) => Some(error.to_string()),
        Err(_) => Some("does not answer".to_owned()),
    }
}
