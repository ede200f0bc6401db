//! Streams of a shared store whose process is gone: another one stores their pending records.

use std::sync::{Arc, PoisonError};
use std::time::Duration;

use super::Streams;
use crate::asset::AssetId;
use crate::service::error::ServiceError;

/// Time between two looks for pending records that no process stores.
const INTERVAL: Duration = Duration::from_secs(5);

/// Maximum number of streams taken over at once.
const MAX_TAKEN: u32 = 16;

impl Streams {
    /// Stores the pending records of streams that no other process stores, for as long as the service exists.
    pub(super) fn take_over_in_background(self: &Arc<Self>) {
        let (streams, mut over) = (Arc::downgrade(self), self.watch_end());
        tokio::spawn(async move {
            loop {
                tokio::select! {
                    _ = over.wait_for(|over| *over) => return,
                    () = tokio::time::sleep(INTERVAL) => {}
                }
                let Some(streams) = streams.upgrade() else { return };
                if let Err(error) = streams.take_over().await {
                    tracing::warn!(%error, "failed to look for streams without a process; retrying later");
                }
                streams.forget_unused();
            }
        });
    }

    async fn take_over(self: &Arc<Self>) -> Result<(), ServiceError> {
        for (asset, name) in self.store.uncut_streams(self.clock.now(), MAX_TAKEN).await? {
            let stream = self.in_memory(&asset, &name)?;
            let read = Arc::clone(&stream);
            match super::blocking("read a stream", move || read.with_stored(|_| Ok(()))).await? {
                Ok(()) => self.cut_in_background(&stream),
                Err(error) => tracing::warn!(%asset, name, %error, "failed to take over a stream"),
            }
        }
        Ok(())
    }

    /// Forgets the streams of an asset that another process deleted. Streams in use are dropped by their last
    /// user.
    pub(super) fn forget(&self, asset: &AssetId) {
        let mut all = self.all.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|(of, _), stream| of != asset || Arc::strong_count(stream) > 1);
    }

    /// Forgets streams that do not exist or have been removed.
    fn forget_unused(&self) {
        let mut all = self.all.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|_, stream| Arc::strong_count(stream) > 1 || stream.is_used());
    }

    /// Releases the records that this process was storing, so that another one stores them at once.
    pub(super) async fn release_cutting(&self) {
        let Some(rows) = self.storage.shared() else { return };
        if let Err(error) = self.store.end_cutting(rows.process, None).await {
            tracing::warn!(%error, "failed to release the live streams; another process takes them over later");
        }
    }
}
