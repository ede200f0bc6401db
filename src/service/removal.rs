//! Removal of records by users, for example those of a loose sensor or of a wrong asset or time.

use std::sync::Arc;

use super::clock::Clock;
use super::error::ServiceError;
use super::events::{EventSender, LiveEvent};
use super::history::History;
use super::pipeline::Committer;
use super::raw::RawObjects;
use super::sensor_group::SensorGroup;
use crate::asset::{AssetId, Segment};
use crate::store::{RecordRange, Store, StoreError, Tombstone};

/// Records of each channel removed in one transaction; other transactions run in between.
const REMOVAL_BATCH: u32 = 200;

/// Removes records.
pub struct Removals {
    pub(crate) store: Store,
    pub(crate) committer: Arc<Committer>,
    pub(crate) raw: Arc<RawObjects>,
    pub(crate) history: Arc<History>,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) events: EventSender,
}

impl Removals {
    /// Removes a record as if it had never been received.
    pub async fn remove_one(&self, segment: &Segment) -> Result<u64, ServiceError> {
        self.remove_each(&segment.asset_id, &[RecordRange::of(segment)]).await
    }

    /// Removes the records of several ranges from an asset and from the other assets of its sensor, as if
    /// they had never been received; returns the number removed from the asset. Raw recordings are moved into
    /// quarantine, and histories are recomputed in the background. After an error, a repeat completes what is
    /// left.
    ///
    /// # Errors
    /// [`ServiceError::SensorOfOther`] if the asset has no sensor of its own.
    pub async fn remove_each(&self, asset: &AssetId, ranges: &[RecordRange]) -> Result<u64, ServiceError> {
        let group = SensorGroup::load(&self.store, asset).await?;
        let assets: Vec<AssetId> = group.specs().map(|spec| spec.id.clone()).collect();
        let mut count = 0;
        let mut orphans = Vec::new();
        let mut removed = Ok(());
        for range in ranges {
            removed = self.remove_range(asset, &assets, range, &mut count, &mut orphans).await;
            if removed.is_err() {
                break;
            }
        }
        let quarantined = self.raw.quarantine(orphans).await;
        let removed = removed.and(quarantined);
        if count > 0 {
            tracing::info!(%asset, count, "removed records");
        }
        // Also after an error, and if nothing was left: an earlier attempt may have failed in between.
        for asset in &assets {
            self.raw.update_asset_metadata(asset).await;
            if count > 0 || removed.is_err() {
                self.events.send(LiveEvent::AssetChanged(asset.clone()));
            }
        }
        self.history.recompute_in_background(assets);
        removed.map(|()| count)
    }

    /// Removes the records of a range. Adds the number removed from the asset to `count`, and the names of
    /// objects that are no longer referenced to `orphans`.
    async fn remove_range(
        &self,
        asset: &AssetId,
        assets: &[AssetId],
        range: &RecordRange,
        count: &mut u64,
        orphans: &mut Vec<String>,
    ) -> Result<(), ServiceError> {
        loop {
            let _exclusive = self.raw.exclusive().await;
            let _pause = self.committer.pause().await;
            match self.remove_some(asset, assets, range, count, orphans).await {
                Ok(true) => {}
                Ok(false) => return Ok(()),
                Err(error) => {
                    if let Err(error) = self.raw.forget_failed_removals().await {
                        tracing::warn!(%asset, %error, "failed to withdraw the tombstone of a failed removal");
                    }
                    return Err(error);
                }
            }
        }
    }

    /// Removes the earliest records of a range; returns whether there were any.
    async fn remove_some(
        &self,
        asset: &AssetId,
        assets: &[AssetId],
        range: &RecordRange,
        count: &mut u64,
        orphans: &mut Vec<String>,
    ) -> Result<bool, ServiceError> {
        let mut segments = Vec::new();
        for of in assets {
            segments.extend(self.store.records_in(of, range, REMOVAL_BATCH).await?);
        }
        if segments.is_empty() {
            return Ok(false);
        }
        // Before the rows go: without the tombstone a rebuild would bring the records back, and a repeat
        // would not find them any more.
        let tombstone = Tombstone { removed_at: self.clock.now(), segments: segments.clone() };
        self.raw.write_tombstone(tombstone).await?;
        // The owner of the sensor comes last: once its records are gone, those of the others would not be
        // looked for again.
        for of in assets.iter().rev() {
            let removed = match self.store.remove_records(of, &segments).await {
                // Another process removed a channel's last record meanwhile: the next look finds the rest.
                Err(StoreError::AssetUnknown(of)) if self.store.asset(&of).await.is_ok() => continue,
                removed => removed?,
            };
            if of == asset {
                *count += removed.segments.len() as u64;
            }
            orphans.extend(removed.orphans);
        }
        Ok(true)
    }
}
