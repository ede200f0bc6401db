//! What a process beside others looks after: what one that died has left undone.

use super::{Ingest, IngestError};
use crate::store::StoreError;

/// Assets brought up to date after one look.
const MOST_ASSETS: u32 = 100;

/// Uploads forgotten after one look.
const MOST_UPLOADS: u32 = 100;

impl Ingest {
    /// Brings histories up to date that another process has left, gives assets what they lack of their sensor's records, and removes what nobody
    /// needs any more, in the background.
    pub(super) fn look_after_in_background(&self) {
        let ingest = self.clone();
        tokio::spawn(async move {
            while !ingest.inner.store.is_closed() {
                if let Err(error) = ingest.look_after().await {
                    tracing::warn!(%error, "what is left to be done is looked at again later");
                }
                tokio::time::sleep(ingest.inner.looked_every).await;
            }
        });
    }

    async fn look_after(&self) -> Result<(), IngestError> {
        let store = &self.inner.store;
        self.recompute_in_background(store.unsettled_assets(MOST_ASSETS).await?);
        // Where some are being caught up already, that may take longer than until the next look.
        if self.inner.catching_up.try_lock().is_ok() {
            self.catch_up_in_background(store.late_listeners(MOST_ASSETS).await?);
        }
        self.expire_uploads().await?;
        if store.begin_sweep(self.inner.clock.now()).await? {
            let (objects, bytes) = self.remove_orphans().await?;
            if objects > 0 {
                tracing::info!(objects, bytes, "removed raw objects that no record refers to");
            }
            self.remove_forgotten_uploads().await?;
        }
        Ok(())
    }

    /// Removes resumable uploads that nobody went on with.
    pub async fn expire_uploads(&self) -> Result<(), IngestError> {
        let gone = self.inner.store.expire_resumable(self.inner.clock.now(), MOST_UPLOADS).await?;
        self.remove_pieces(gone).await
    }

    /// Removes what a process brought that did not see that its upload had gone.
    async fn remove_forgotten_uploads(&self) -> Result<(), IngestError> {
        let store = self.inner.store.clone();
        let list = move || store.objects().uploads();
        let uploads = self.inner.workers.run("list uploads", list).await??;
        let forgotten = self.inner.store.forgotten_uploads(uploads).await?;
        self.remove_pieces(forgotten).await
    }

    /// Removes everything that is kept of uploads.
    pub async fn remove_pieces(&self, uploads: Vec<String>) -> Result<(), IngestError> {
        if uploads.is_empty() {
            return Ok(());
        }
        let store = self.inner.store.clone();
        let remove = move || uploads.iter().try_for_each(|upload| store.objects().remove_pieces(upload));
        let removed: Result<(), StoreError> = self.inner.workers.run("remove uploads", remove).await?;
        Ok(removed?)
    }
}
