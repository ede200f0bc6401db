//! What a process beside others looks after: what one that died has left undone.

use std::time::Duration;

use super::{Ingest, IngestError};

/// Between two looks at what is left to be done.
const LOOKED_EVERY: Duration = Duration::from_secs(30);

/// Assets brought up to date after one look.
const MOST_ASSETS: u32 = 100;

impl Ingest {
    /// Brings histories up to date that another process has left, and removes objects that nothing refers to, in the background.
    pub(super) fn look_after_in_background(&self) {
        let ingest = self.clone();
        tokio::spawn(async move {
            while !ingest.inner.store.is_closed() {
                if let Err(error) = ingest.look_after().await {
                    tracing::warn!(%error, "what is left to be done is looked at again later");
                }
                tokio::time::sleep(LOOKED_EVERY).await;
            }
        });
    }

    async fn look_after(&self) -> Result<(), IngestError> {
        let store = &self.inner.store;
        self.recompute_in_background(store.unsettled_assets(MOST_ASSETS).await?);
        if store.begin_sweep(self.inner.clock.now()).await? {
            let (objects, bytes) = self.remove_orphans().await?;
            if objects > 0 {
                tracing::info!(objects, bytes, "removed raw objects that no record refers to");
            }
        }
        Ok(())
    }
}
