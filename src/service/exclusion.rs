//! Exclusion of records from the histories by users, for example those of a test run or of maintenance work.

use std::sync::Arc;

use super::error::ServiceError;
use super::events::{Announcer, LiveEvent};
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
    pub(crate) events: Announcer,
}

impl Exclusions {
    /// Excludes one record from its history, or includes it again.
    pub async fn set_one(&self, segment: &Segment, is_excluded: bool) -> Result<u64, ServiceError> {
        self.set(&segment.asset_id, &RecordRange::of(segment), is_excluded).await
    }

    /// Excludes records of an asset from its histories, or includes them again.
    pub async fn set(
        &self,
        asset: &AssetId,
        range: &RecordRange,
        is_excluded: bool,
    ) -> Result<u64, ServiceError> {
        self.set_each(asset, std::slice::from_ref(range), is_excluded).await
    }

    /// Excludes records of several ranges, or includes them again, for the asset and the other assets of its
    /// sensor; returns how many records of the asset changed. Histories are folded again in the background.
    ///
    /// Error: [`ServiceError::SensorOfOther`] if the asset has no sensor of its own.
    pub async fn set_each(
        &self,
        asset: &AssetId,
        ranges: &[RecordRange],
        is_excluded: bool,
    ) -> Result<u64, ServiceError> {
        let group = SensorGroup::of(&self.store, asset).await?;
        let mut count = 0;
        let mut changed = Vec::new();
        {
            let _pause = self.committer.pause().await;
            for spec in group.specs() {
                let mut marked = 0;
                for range in ranges {
                    marked += self.store.set_excluded(&spec.id, range, is_excluded).await?;
                }
                if spec.id == *asset {
                    count = marked;
                }
                if marked > 0 {
                    changed.push(spec.id.clone());
                }
            }
        }
        for asset in &changed {
            tracing::info!(%asset, is_excluded, "changed the exclusion of records");
            self.raw.note_changed_asset(asset).await;
            self.events.announce(LiveEvent::AssetChanged(asset.clone()));
        }
        self.history.recompute_in_background(changed);
        Ok(count)
    }
}
