//! Which histories are to be computed again, in what order, and how far that is.

use std::collections::{BTreeMap, BTreeSet, HashSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use tokio::sync::mpsc;

use super::recompute::Made;
use super::{Announcement, Ingest, IngestError, Part};
use crate::asset::AssetId;
use crate::store::ChannelSummary;

/// When a history that another process makes is looked at again.
const LOOKED_AGAIN_AFTER: Duration = Duration::from_secs(2);

/// What a recomputation is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RecomputationState {
    /// Indicators and features are computed again from the raw recordings.
    Analysing,
    /// The estimates are computed again.
    Folding,
    /// Everything is served as new.
    Finished,
    /// Could not go on; the old answers are served.
    Failed,
}

/// One channel's history being computed again, and how far it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Recomputation {
    /// The asset.
    pub asset: AssetId,
    /// The channel.
    pub channel: String,
    /// What it is doing.
    pub state: RecomputationState,
    /// Records of the channel when it began.
    pub records_total: u64,
    /// Records analysed again from their raw bytes.
    pub analysed: u64,
    /// Records that keep their old indicators, since their raw bytes are not kept any more or cannot be read.
    pub without_raw: u64,
    /// Records folded.
    pub folded: u64,
    /// Why it failed.
    pub error: Option<String>,
    /// When it began.
    pub started_at: Timestamp,
    /// When it ended.
    pub finished_at: Option<Timestamp>,
}

/// Recomputations since the start, the last one of each channel; and what is to be looked at.
#[derive(Debug, Default)]
pub(super) struct Recomputations {
    held: Mutex<Held>,
}

#[derive(Debug, Default)]
struct Held {
    shown: BTreeMap<(AssetId, String), Arc<Recomputation>>,
    waiting: Waiting,
    is_running: bool,
}

/// Assets in the order in which they are looked at, each once.
#[derive(Debug, Default)]
struct Waiting {
    order: VecDeque<AssetId>,
    /// The same ones: at a start that is the whole fleet.
    assets: HashSet<AssetId>,
}

impl Waiting {
    fn push(&mut self, asset: AssetId) {
        if self.assets.insert(asset.clone()) {
            self.order.push_back(asset);
        }
    }

    fn pop(&mut self) -> Option<AssetId> {
        let next = self.order.pop_front()?;
        self.assets.remove(&next);
        Some(next)
    }
}

impl Recomputations {
    fn lock(&self) -> MutexGuard<'_, Held> {
        // Entries are replaced whole, so a panic elsewhere cannot have left half of one.
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Ingest {
    /// The last recomputation of each channel since the start, of one asset or of all.
    pub fn recomputations(&self, asset: Option<&AssetId>) -> Vec<Arc<Recomputation>> {
        let held = self.inner.recomputations.lock();
        let wanted = held.shown.values().filter(|shown| asset.is_none_or(|asset| shown.asset == *asset));
        wanted.cloned().collect()
    }

    /// Brings the histories of assets up to what is asked for now, one after the other, in the background; those of an entrance are done by
    /// workers.
    pub(super) fn recompute_in_background(&self, assets: Vec<AssetId>) {
        if let Part::Entrance(crew) = &self.inner.part {
            assets.iter().for_each(|asset| crew.tell_of(asset));
            return;
        }
        let mut held = self.inner.recomputations.lock();
        for asset in assets {
            held.waiting.push(asset);
        }
        if held.is_running || held.waiting.order.is_empty() {
            return;
        }
        held.is_running = true;
        drop(held);
        let ingest = self.clone();
        tokio::spawn(async move {
            while let Some(asset) = ingest.next_to_recompute() {
                match ingest.recompute_asset(&asset).await {
                    Ok(Made::Here) => {}
                    // Looked at again later: whoever is at it may end before it is done.
                    Ok(Made::Elsewhere) => {
                        ingest.inner.recomputations.lock().waiting.push(asset);
                        tokio::time::sleep(LOOKED_AGAIN_AFTER).await;
                    }
                    Err(IngestError::Store(error)) if error.is_unavailable() || error.is_conflict() => {
                        tracing::warn!(%asset, %error, "history not computed again yet");
                        ingest.inner.recomputations.lock().waiting.push(asset);
                        tokio::time::sleep(LOOKED_AGAIN_AFTER).await;
                    }
                    Err(error) => tracing::warn!(%asset, %error, "history not computed again"),
                }
            }
        });
    }

    /// Computes the histories again, in the background, of assets whose library's neighbours have come, each time some have.
    pub(super) fn recompute_when_complete(&self, mut completed: mpsc::UnboundedReceiver<String>) {
        // Not held: what waits here must not keep the service alive.
        let inner = Arc::downgrade(&self.inner);
        tokio::spawn(async move {
            while let Some(library) = completed.recv().await {
                let Some(inner) = inner.upgrade() else { return };
                let ingest = Self { inner };
                match ingest.assets_with(&library).await {
                    Ok(assets) => ingest.recompute_in_background(assets),
                    Err(error) => tracing::warn!(library, %error, "histories are not computed again with the library's neighbours"),
                }
            }
        });
    }

    /// The assets of a library.
    async fn assets_with(&self, library: &str) -> Result<Vec<AssetId>, IngestError> {
        let mut after: Option<String> = None;
        let mut found = Vec::new();
        loop {
            let assets = self.inner.store.assets(after.as_deref(), 500).await?;
            let Some(last) = assets.last() else { return Ok(found) };
            after = Some(last.spec.id.to_string());
            let with = assets
                .into_iter()
                .filter(|asset| self.inner.libraries.id_for(&asset.spec).as_deref() == Some(library));
            found.extend(with.map(|asset| asset.spec.id));
        }
    }

    fn next_to_recompute(&self) -> Option<AssetId> {
        let mut held = self.inner.recomputations.lock();
        let next = held.waiting.pop();
        held.is_running = next.is_some();
        next
    }

    /// Shows that a channel's history is being computed again.
    pub(super) fn begin_showing(&self, channel: &ChannelSummary) {
        let shown = Recomputation {
            asset: channel.asset_id.clone(),
            channel: channel.channel.clone(),
            state: RecomputationState::Analysing,
            records_total: channel.segments,
            analysed: 0,
            without_raw: 0,
            folded: 0,
            error: None,
            started_at: self.inner.clock.now(),
            finished_at: None,
        };
        let key = (channel.asset_id.clone(), channel.channel.clone());
        self.inner.recomputations.lock().shown.insert(key, Arc::new(shown));
    }

    /// Shows how far that is.
    pub(super) fn show(&self, asset: &AssetId, channel: &str, change: impl FnOnce(&mut Recomputation)) {
        let mut held = self.inner.recomputations.lock();
        if let Some(shown) = held.shown.get_mut(&(asset.clone(), channel.to_owned())) {
            change(Arc::make_mut(shown));
            let shown = Arc::clone(shown);
            drop(held);
            self.announce(Announcement::RecomputationChanged(shown));
        }
    }

    /// Shows a recomputation that another process does.
    pub fn note_recomputation(&self, done_elsewhere: Recomputation) {
        let key = (done_elsewhere.asset.clone(), done_elsewhere.channel.clone());
        self.inner.recomputations.lock().shown.insert(key, Arc::new(done_elsewhere));
    }

    /// Forgets the recomputations of an asset that is gone.
    pub fn forget_recomputations(&self, asset: &AssetId) {
        let mut held = self.inner.recomputations.lock();
        let gone: BTreeSet<_> = held.shown.keys().filter(|(of, _)| of == asset).cloned().collect();
        held.shown.retain(|key, _| !gone.contains(key));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_asset_waits_once_and_in_its_turn() {
        let asset = |name: &str| AssetId::new(name).unwrap();
        let mut waiting = Waiting::default();
        for name in ["a", "b", "a", "c"] {
            waiting.push(asset(name));
        }
        assert_eq!(waiting.pop(), Some(asset("a")));
        waiting.push(asset("a"));
        let rest: Vec<_> = std::iter::from_fn(|| waiting.pop()).collect();
        assert_eq!(rest, [asset("b"), asset("c"), asset("a")]);
    }
}
