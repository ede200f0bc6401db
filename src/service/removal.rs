//! Removal of records by users, for example those of a loose sensor or of a wrong asset or time.

use std::sync::Arc;

use super::clock::Clock;
use super::error::ServiceError;
use super::events::{Announcer, LiveEvent};
use super::history::History;
use super::pipeline::Committer;
use super::raw::RawObjects;
use super::sensor_group::SensorGroup;
use crate::asset::{AssetId, Segment};
use crate::store::{RecordRange, RemovalNote, Store};

/// Records of each channel removed in one transaction; other transactions run in between.
const AT_ONCE: u32 = 200;

/// Removes records.
pub struct Removals {
    pub(crate) store: Store,
    pub(crate) committer: Arc<Committer>,
    pub(crate) raw: Arc<RawObjects>,
    pub(crate) history: Arc<History>,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) events: Announcer,
}

impl Removals {
    /// Removes a record as if it had never been received.
    pub async fn remove_one(&self, segment: &Segment) -> Result<u64, ServiceError> {
        self.remove(&segment.asset_id, &RecordRange::of(segment)).await
    }

    /// Removes records of an asset as if they had never been received.
    pub async fn remove(&self, asset: &AssetId, range: &RecordRange) -> Result<u64, ServiceError> {
        self.remove_each(asset, std::slice::from_ref(range)).await
    }

    /// Removes the records of several ranges from an asset and from the other assets of its sensor; returns
    /// the number removed from the asset. Raw recordings are moved into quarantine, and histories are
    /// recomputed in the background.
    ///
    /// Error: [`ServiceError::SensorOfOther`] if the asset has no sensor of its own.
    pub async fn remove_each(&self, asset: &AssetId, ranges: &[RecordRange]) -> Result<u64, ServiceError> {
        let group = SensorGroup::of(&self.store, asset).await?;
        let assets: Vec<AssetId> = group.specs().map(|spec| spec.id.clone()).collect();
        let mut count = 0;
        for range in ranges {
            count += self.remove_range(asset, &assets, range).await?;
        }
        if count > 0 {
            tracing::info!(%asset, count, "removed records");
            for asset in &assets {
                self.events.announce(LiveEvent::AssetChanged(asset.clone()));
            }
            self.history.recompute_in_background(assets);
        }
        Ok(count)
    }

    async fn remove_range(
        &self,
        asset: &AssetId,
        assets: &[AssetId],
        range: &RecordRange,
    ) -> Result<u64, ServiceError> {
        let mut count = 0;
        loop {
            let _exclusive = self.raw.exclusive().await;
            let _pause = self.committer.pause().await;
            let (mut segments, mut orphans) = (Vec::new(), Vec::new());
            // The owner of the sensor comes last: once its records are gone, those of the others would not be
            // looked for again.
            for of in assets.iter().rev() {
                let removed = self.store.remove_records(of, range, AT_ONCE).await?;
                if of == asset {
                    count += removed.segments.len() as u64;
                }
                segments.extend(removed.segments);
                orphans.extend(removed.orphans);
            }
            if segments.is_empty() {
                break;
            }
            self.raw.note_removal(RemovalNote { removed_at: self.clock.now(), segments }).await?;
            self.raw.quarantine(orphans).await?;
        }
        Ok(count)
    }
}
