//! What a process beside others looks after: what one that died has left undone.

use std::sync::Arc;
use std::time::Duration;

use super::catch_up::CatchUp;
use super::clock::Clock;
use super::error::ServiceError;
use super::history::History;
use super::raw::{RawObjects, UploadPieces};
use crate::store::Store;

/// Assets brought up to date after one look.
const MAX_ASSETS: u32 = 100;

/// Looks after a store that processes share.
pub(crate) struct Upkeep {
    pub(crate) store: Store,
    pub(crate) history: Arc<History>,
    pub(crate) catch_up: Arc<CatchUp>,
    pub(crate) raw: Arc<RawObjects>,
    pub(crate) uploads: Arc<UploadPieces>,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) interval: Duration,
}

impl Upkeep {
    /// Brings histories up to date that another process has left, gives assets what they lack of their
    /// sensor's records, and removes what nobody needs any more, in the background.
    pub(crate) fn in_background(self) {
        tokio::spawn(async move {
            while !self.store.is_closed() {
                if let Err(error) = self.look_once().await {
                    tracing::warn!(%error, "failed to look after the shared store: trying again later");
                }
                tokio::time::sleep(self.interval).await;
            }
        });
    }

    async fn look_once(&self) -> Result<(), ServiceError> {
        let outdated = self.store.unsettled_assets(MAX_ASSETS).await?;
        self.history.recompute_in_background(outdated);
        // Where some are being caught up already, that may take longer than until the next look.
        if !self.catch_up.is_busy() {
            self.catch_up.in_background(self.store.late_members(MAX_ASSETS).await?);
        }
        self.store.raise_generation_if_changed().await?;
        self.uploads.expire().await?;
        if self.store.begin_sweep(self.store.now(self.clock.now()).await?).await? {
            self.raw.sweep().await?;
            self.uploads.remove_forgotten().await?;
        }
        Ok(())
    }
}
