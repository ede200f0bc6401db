//! The history of each channel: its records are folded in the order of time, late ones too, and folded again
//! when the inputs of the fold change.

mod append;
mod channels;
mod fold;
mod folding;
mod hindsight;
mod progress;
mod recompute;
mod timeline;
mod update_queue;

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::{OwnedMutexGuard, mpsc};

use super::clock::Clock;
use super::error::ServiceError;
use super::events::EventSender;
use super::failure_cause::FailureCause;
use super::recomputation::Recomputation;
use super::simulations::Simulations;
use super::work_queue::Role;
use super::workers::{Workers, detached};
use crate::asset::AssetId;
use crate::store::Store;
pub(crate) use append::{Appended, Committed};
pub(crate) use channels::ChannelCache;
use folding::Folding;
use progress::Progress;
use recompute::{Recomputer, UpdateOutcome};
use update_queue::UpdateQueue;

/// Time after which a history that another process computes is checked again.
const RETRY_AFTER: Duration = Duration::from_secs(2);

/// Time after which a recomputation is retried that a full, failing or damaged disk has stopped.
const RETRY_DISK_AFTER: Duration = Duration::from_secs(60);

/// The histories of all channels.
pub struct History {
    simulations: Arc<Simulations>,
    role: Role,
    channels: Arc<channels::Channels>,
    folding: Folding,
    progress: Arc<Progress>,
    recomputer: Recomputer,
    queue: Mutex<UpdateQueue>,
}

impl History {
    pub(crate) fn new(
        store: Store,
        workers: Arc<Workers>,
        simulations: Arc<Simulations>,
        clock: Arc<dyn Clock>,
        events: EventSender,
        role: Role,
    ) -> Self {
        let channels = Arc::<channels::Channels>::default();
        let progress = Arc::new(Progress::new(events.clone()));
        let folding =
            Folding { store: store.clone(), workers: Arc::clone(&workers), states_read: Arc::default() };
        let recomputer = Recomputer {
            store,
            workers,
            simulations: Arc::clone(&simulations),
            clock,
            events,
            channels: Arc::clone(&channels),
            folding: folding.clone(),
            progress: Arc::clone(&progress),
        };
        Self { simulations, role, channels, folding, progress, recomputer, queue: Mutex::default() }
    }

    /// Locks a channel for changes.
    pub(crate) async fn lock(&self, asset: &AssetId, channel: &str) -> OwnedMutexGuard<ChannelCache> {
        self.channels.cache(asset, channel).lock_owned().await
    }

    /// Number of states of channels read from the store to append records to them.
    pub fn states_read(&self) -> u64 {
        self.folding.states_read.load(Ordering::Relaxed)
    }

    /// Forgets a deleted asset.
    pub(crate) fn forget(&self, asset: &AssetId) {
        self.channels.forget(asset);
        self.progress.forget(asset);
    }

    /// The last recomputation of each channel since the start, of one asset or of all assets.
    pub fn recomputations(&self, asset: Option<&AssetId>) -> Vec<Arc<Recomputation>> {
        self.progress.list(asset)
    }

    /// Records the progress of a recomputation in another process.
    pub fn set_recomputation(&self, done_elsewhere: Recomputation) {
        self.progress.insert(done_elsewhere);
    }

    /// Brings the histories of assets up to date in the background, one after the other; an API node notifies
    /// the workers instead.
    pub(crate) fn recompute_in_background(self: &Arc<Self>, assets: Vec<AssetId>) {
        if let Role::ApiNode(queue) = &self.role {
            assets.iter().for_each(|asset| queue.notify_changed(asset));
            return;
        }
        {
            let mut queue = self.queue();
            assets.into_iter().for_each(|asset| queue.push(asset));
            if queue.is_running || queue.is_empty() {
                return;
            }
            queue.is_running = true;
        }
        let history = Arc::clone(self);
        tokio::spawn(async move {
            while let Some(asset) = history.next() {
                let (recomputing, id) = (Arc::clone(&history), asset.clone());
                // In a task of its own, so that a panic does not end the work on the others.
                let recompute = async move { recomputing.recomputer.recompute_asset(&id).await };
                match detached("recompute a history", recompute).await.and_then(|outcome| outcome) {
                    Ok(UpdateOutcome::Done | UpdateOutcome::AwaitsLibrary) => {}
                    // The other process may end before it is done.
                    Ok(UpdateOutcome::InOtherProcess) => history.retry_later(asset, RETRY_AFTER),
                    Err(error) => match retry_after(&error) {
                        Some(time) => {
                            tracing::warn!(%asset, %error, "failed to recompute a history; retrying later");
                            history.retry_later(asset, time);
                        }
                        None => tracing::warn!(%asset, %error, "failed to recompute a history"),
                    },
                }
            }
        });
    }

    fn queue(&self) -> MutexGuard<'_, UpdateQueue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn next(&self) -> Option<AssetId> {
        self.queue().pop()
    }

    /// Queues an asset again after a time, in which others take their turn.
    fn retry_later(self: &Arc<Self>, asset: AssetId, time: Duration) {
        if !self.queue().begin_wait(&asset) {
            return;
        }
        // Weak: this task must not keep the service alive.
        let history = Arc::downgrade(self);
        tokio::spawn(async move {
            tokio::time::sleep(time).await;
            let Some(history) = history.upgrade() else { return };
            history.queue().end_wait(&asset);
            history.recompute_in_background(vec![asset]);
        });
    }

    /// Recomputes, in the background, the histories of assets whose library is ready, has more members, or
    /// has failed.
    pub(crate) fn recompute_when_simulated(
        self: &Arc<Self>,
        mut simulated: mpsc::UnboundedReceiver<Vec<AssetId>>,
    ) {
        // Weak: this task must not keep the service alive.
        let history = Arc::downgrade(self);
        tokio::spawn(async move {
            while let Some(assets) = simulated.recv().await {
                let Some(history) = history.upgrade() else { return };
                history.recompute_in_background(assets);
            }
        });
    }
}

/// Time after which a recomputation is retried; `None` if it would fail again.
fn retry_after(error: &ServiceError) -> Option<Duration> {
    match error {
        ServiceError::Store(error) if error.is_unavailable() || error.is_conflict() => Some(RETRY_AFTER),
        // Reported damage may prove to be a disk that failed for a moment.
        ServiceError::Store(error) if error.is_damage() => Some(RETRY_DISK_AFTER),
        _ => (error.cause() == FailureCause::External).then_some(RETRY_DISK_AFTER),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::StoreError;

    #[test]
    fn a_recomputation_that_the_disk_or_another_process_stopped_is_retried() {
        let full = std::io::Error::from(std::io::ErrorKind::StorageFull);
        let retried = [
            (StoreError::Outdated("the channel"), Some(RETRY_AFTER)),
            (StoreError::Database(sqlx::Error::PoolTimedOut), Some(RETRY_AFTER)),
            (StoreError::Database(sqlx::Error::Io(full)), Some(RETRY_DISK_AFTER)),
            (
                StoreError::DatabaseDamaged { path: "flankwatch.db".into(), what: "a page".into() },
                Some(RETRY_DISK_AFTER),
            ),
            (StoreError::NotFinite { field: "rms".into(), value: f64::NAN }, None),
        ];
        for (error, time) in retried {
            assert_eq!(retry_after(&ServiceError::Store(error)), time);
        }
    }
}
