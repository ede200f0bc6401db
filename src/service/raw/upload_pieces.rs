//! Pieces of resumable uploads, removed once their upload expires.

use std::sync::Arc;

use crate::service::clock::Clock;
use crate::service::error::ServiceError;
use crate::service::workers::Workers;
use crate::store::{Store, StoreError};

/// Maximum number of uploads expired at a time.
const MAX_EXPIRED: u32 = 100;

/// The pieces of resumable uploads in a store.
pub struct UploadPieces {
    store: Store,
    workers: Arc<Workers>,
    clock: Arc<dyn Clock>,
}

impl UploadPieces {
    pub(crate) fn new(store: Store, workers: Arc<Workers>, clock: Arc<dyn Clock>) -> Self {
        Self { store, workers, clock }
    }

    /// Removes expired resumable uploads.
    pub async fn expire(&self) -> Result<(), ServiceError> {
        let gone = self.store.expire_resumable(self.clock.now(), MAX_EXPIRED).await?;
        self.remove(gone).await
    }

    /// Removes pieces of uploads that no longer exist, stored by a process that had not noticed.
    pub async fn remove_forgotten(&self) -> Result<(), ServiceError> {
        let store = self.store.clone();
        let list = move || store.objects().uploads();
        let uploads = self.workers.run("list uploads", list).await??;
        let forgotten = self.store.forgotten_uploads(uploads).await?;
        self.remove(forgotten).await
    }

    /// Removes all pieces of these uploads.
    pub async fn remove(&self, uploads: Vec<String>) -> Result<(), ServiceError> {
        if uploads.is_empty() {
            return Ok(());
        }
        let store = self.store.clone();
        let remove = move || uploads.iter().try_for_each(|upload| store.objects().remove_pieces(upload));
        let removed: Result<(), StoreError> = self.workers.run("remove uploads", remove).await?;
        Ok(removed?)
    }
}
