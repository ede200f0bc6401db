//! Raw bytes that are kept before the rows that refer to them are stored.

use tokio::runtime::Handle;

use super::{Ingest, IngestError};

/// Raw objects whose rows are still to be stored. Where that does not happen, those that nothing refers to are removed when this is dropped:
/// they count to no quota.
pub(super) struct KeptRaw {
    ingest: Ingest,
    names: Vec<String>,
}

impl KeptRaw {
    /// Where other processes store as well, what one has lost is removed by their look after what nobody needs.
    pub(super) fn new(ingest: &Ingest, mut names: Vec<String>) -> Self {
        if ingest.inner.store.is_shared() {
            names.clear();
        }
        Self {
            ingest: ingest.clone(),
            names,
        }
    }

    /// Their rows are stored.
    pub(super) fn are_stored(mut self) {
        self.names.clear();
    }
}

impl Drop for KeptRaw {
    fn drop(&mut self) {
        if self.names.is_empty() {
            return;
        }
        // At the end of the process the next start does it.
        let Ok(runtime) = Handle::try_current() else { return };
        let (ingest, names) = (self.ingest.clone(), std::mem::take(&mut self.names));
        runtime.spawn(async move {
            match ingest.remove_unstored(names).await {
                Ok(0) => {}
                Ok(objects) => tracing::info!(objects, "removed raw objects whose records could not be stored"),
                Err(error) => tracing::debug!(%error, "raw objects whose records could not be stored stay until the next start"),
            }
        });
    }
}

impl Ingest {
    /// Removes those of these raw objects that nothing refers to; returns how many.
    async fn remove_unstored(&self, names: Vec<String>) -> Result<usize, IngestError> {
        // Nobody is between keeping raw bytes and storing their rows now.
        let _nobody_keeps = self.inner.keeping.write().await;
        let orphans = self.inner.store.orphans_among(names).await?;
        let count = orphans.len();
        self.remove_objects(orphans).await?;
        Ok(count)
    }
}
