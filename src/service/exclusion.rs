//! Exclusion of records from the histories by users, for example those of a test run or of maintenance work.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::error::ServiceError;
use super::events::{EventSender, LiveEvent};
use super::history::History;
use super::pipeline::Committer;
use super::raw::RawObjects;
use super::sensor_group::SensorGroup;
use crate::asset::{AssetId, Segment};
use crate::store::{RecordRange, Store};

/// Excludes records, and includes them again.
pub struct Exclusions {
    pub(crate) store: Store,
    pub(crate) committer: Arc<Committer>,
    pub(crate) raw: Arc<RawObjects>,
    pub(crate) history: Arc<History>,
    pub(crate) events: EventSender,
}

impl Exclusions {
    /// Excludes one record from its history, or includes it again.
    pub async fn set_one(&self, segment: &Segment, is_excluded: bool) -> Result<u64, ServiceError> {
        self.set_each(&segment.asset_id, &[RecordRange::of(segment)], is_excluded).await
    }

    /// Excludes records of several ranges, or includes them again, for the asset and the other assets of its
    /// sensor; returns how many records of the asset changed. Histories are folded again in the background.
    /// After an error, a repeat completes what is left.
    ///
    /// # Errors
    /// [`ServiceError::SensorOfOther`] if the asset has no sensor of its own.
    pub async fn set_each(
        &self,
        asset: &AssetId,
        ranges: &[RecordRange],
        is_excluded: bool,
    ) -> Result<u64, ServiceError> {
        let group = SensorGroup::load(&self.store, asset).await?;
        let assets: Vec<AssetId> = group.specs().map(|spec| spec.id.clone()).collect();
        let mut changed = BTreeMap::new();
        let marked = self.mark(&assets, ranges, is_excluded, &mut changed).await;
        // Also after an error, and if nothing changed: an earlier attempt may have failed in between.
        for asset in &assets {
            self.raw.update_asset_metadata(asset).await;
            let count = changed.get(asset).copied().unwrap_or(0);
            if count > 0 {
                tracing::info!(%asset, is_excluded, count, "changed the exclusion of records");
            }
            if count > 0 || marked.is_err() {
                self.events.send(LiveEvent::AssetChanged(asset.clone()));
            }
        }
        self.history.recompute_in_background(assets);
        marked.map(|()| changed.remove(asset).unwrap_or(0))
    }

    /// Marks the records of assets as excluded or not, and adds the numbers of changed ones to `changed`.
    async fn mark(
        &self,
        assets: &[AssetId],
        ranges: &[RecordRange],
        is_excluded: bool,
        changed: &mut BTreeMap<AssetId, u64>,
    ) -> Result<(), ServiceError> {
        let _pause = self.committer.pause().await;
        for asset in assets {
            for range in ranges {
                let count = self.store.set_excluded(asset, range, is_excluded).await?;
                *changed.entry(asset.clone()).or_default() += count;
            }
        }
        Ok(())
    }
}
