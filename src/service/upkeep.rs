//! Upkeep of a shared store: finishes what another process left undone when it died.

use std::sync::Arc;
use std::time::Duration;

use super::backfill::Backfill;
use super::background::every;
use super::clock::Clock;
use super::error::ServiceError;
use super::history::History;
use super::raw::{RawObjects, UploadPieces};
use crate::store::Store;

/// Maximum number of assets brought up to date in one round.
const MAX_ASSETS: u32 = 100;

/// Maintains a shared store.
pub(crate) struct Upkeep {
    pub(crate) store: Store,
    pub(crate) history: Arc<History>,
    pub(crate) backfill: Arc<Backfill>,
    pub(crate) raw: Arc<RawObjects>,
    pub(crate) uploads: Arc<UploadPieces>,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) interval: Duration,
}

impl Upkeep {
    /// Brings outdated histories up to date, backfills members of sensor groups, and removes what is no
    /// longer needed, periodically in the background.
    pub(crate) fn in_background(self) {
        let (store, interval, upkeep) = (self.store.clone(), self.interval, Arc::new(self));
        every(interval, Duration::ZERO, "maintain the shared store", &store, move || {
            let upkeep = Arc::clone(&upkeep);
            Some(async move { upkeep.run_once().await })
        });
    }

    async fn run_once(&self) -> Result<(), ServiceError> {
        let outdated = self.store.outdated_assets(MAX_ASSETS).await?;
        self.history.recompute_in_background(outdated);
        // A running backfill may take longer than the time between two rounds.
        if !self.backfill.is_busy() {
            self.backfill.in_background(self.store.late_members(MAX_ASSETS).await?);
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
