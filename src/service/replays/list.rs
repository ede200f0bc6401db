//! The list of running and ended replays, in memory and in the store.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::watch;

use crate::service::error::ServiceError;
use crate::service::events::{EventSender, LiveEvent};
use crate::service::replay::{Replay, ReplayState};
use crate::store::Store;

/// Maximum number of replays that are remembered.
const MAX_REMEMBERED: usize = 1000;

/// The list of replays.
pub(crate) struct ReplayList {
    store: Store,
    events: EventSender,
    entries: Mutex<Entries>,
}

#[derive(Debug, Default)]
struct Entries {
    last_number: u64,
    by_number: BTreeMap<u64, (Arc<Replay>, watch::Sender<bool>)>,
}

impl ReplayList {
    pub(crate) fn new(store: Store, events: EventSender) -> Self {
        Self { store, events, entries: Mutex::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Entries> {
        // Entries are replaced as a whole, so a panic elsewhere cannot leave a partial one.
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Assigns a new replay its number, and saves it.
    pub(crate) async fn number(&self, replay: &mut Replay) -> u64 {
        let number = {
            let mut entries = self.lock();
            entries.last_number += 1;
            entries.last_number
        };
        replay.id = number.to_string();
        self.save(number, replay).await;
        let forgotten = number.saturating_sub(MAX_REMEMBERED as u64);
        if let Err(error) = self.store.forget_replays_before(forgotten).await {
            tracing::warn!(%error, "failed to remove old replays");
        }
        number
    }

    /// Reads the replays that the previous process saved; returns those that were running.
    pub(crate) async fn load(&self) -> Result<Vec<(u64, Replay)>, ServiceError> {
        let mut running = Vec::new();
        for (number, text) in self.store.saved_replays().await? {
            let replay: Replay = match serde_json::from_str(&text) {
                Ok(replay) => replay,
                Err(error) => {
                    tracing::warn!(replay = number, %error, "failed to read a saved replay");
                    continue;
                }
            };
            let mut entries = self.lock();
            entries.last_number = entries.last_number.max(number);
            let ended = (Arc::new(replay.clone()), watch::channel(false).0);
            entries.by_number.insert(number, ended);
            if replay.state == ReplayState::Running {
                running.push((number, replay));
            }
        }
        Ok(running)
    }

    /// Adds a running replay, which `stop` can stop.
    pub(crate) fn insert_running(&self, number: u64, replay: Arc<Replay>, stop: watch::Sender<bool>) {
        let by_number = &mut self.lock().by_number;
        by_number.insert(number, (replay, stop));
        while by_number.len() > MAX_REMEMBERED {
            let ended = by_number.iter().find(|(_, (replay, _))| replay.state != ReplayState::Running);
            let Some(number) = ended.map(|(number, _)| *number) else {
                break;
            };
            by_number.remove(&number);
        }
    }

    /// Updates a replay in the list.
    pub(crate) fn update(&self, number: u64, replay: &Replay) {
        if let Some((shown, _)) = self.lock().by_number.get_mut(&number) {
            *shown = Arc::new(replay.clone());
        }
    }

    /// Updates a replay and sends the event.
    pub(crate) fn publish(&self, number: u64, replay: &Replay) {
        self.update(number, replay);
        self.events.send(LiveEvent::ReplayChanged(Box::new(replay.clone())));
    }

    /// Saves a replay in the store, so that the next start can resume it.
    pub(crate) async fn save(&self, number: u64, replay: &Replay) {
        // Other processes on a shared store do not have the recording.
        if self.store.is_shared() {
            return;
        }
        let text = match serde_json::to_string(replay) {
            Ok(text) => text,
            Err(error) => {
                tracing::warn!(replay = number, %error, "failed to save a replay");
                return;
            }
        };
        if let Err(error) = self.store.save_replay(number, &text).await {
            tracing::warn!(replay = number, %error, "failed to save a replay");
        }
    }

    /// All replays, the latest first.
    pub(crate) fn all(&self) -> Vec<Arc<Replay>> {
        self.lock().by_number.values().rev().map(|(replay, _)| Arc::clone(replay)).collect()
    }

    /// A replay, and the sender that stops it.
    ///
    /// # Errors
    /// [`ServiceError::ReplayUnknown`].
    pub(crate) fn get(&self, id: &str) -> Result<(Arc<Replay>, watch::Sender<bool>), ServiceError> {
        let number: Option<u64> = id.parse().ok();
        let found = number.and_then(|number| self.lock().by_number.get(&number).cloned());
        found.ok_or_else(|| ServiceError::ReplayUnknown(id.to_string()))
    }
}
