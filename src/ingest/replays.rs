//! The replays that a process runs and remembers: recordings from the replay folder fed through the service as if they happened now.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::watch;

use super::accept::defaults_of;
use super::read_ahead::RecordStream;
use super::replay::{Replay, ReplayRequest, ReplayState};
use super::{Announcement, Ingest, IngestError, replay_folder};
use crate::asset::AssetSpec;
use crate::recording::RecordingFile;

/// Ended replays that are remembered.
const MOST_REMEMBERED: usize = 1000;

/// All replays that are remembered.
#[derive(Debug, Default)]
pub(super) struct Replays {
    held: Mutex<Held>,
    /// The service ends: replays that are stopped now go on at the next start.
    is_ending: AtomicBool,
}

#[derive(Debug, Default)]
struct Held {
    given_out: u64,
    by_number: BTreeMap<u64, (Arc<Replay>, watch::Sender<bool>)>,
}

impl Replays {
    fn lock(&self) -> MutexGuard<'_, Held> {
        // Entries are replaced whole, so a panic elsewhere cannot have left half of one.
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Ingest {
    /// Starts a replay.
    ///
    /// Errors: no such asset, a file outside the replay folder, too many recordings being read; a process that hands records over has no
    /// replay folder.
    pub async fn start_replay(&self, request: ReplayRequest) -> Result<Arc<Replay>, IngestError> {
        if self.is_entrance() {
            return Err(IngestError::ReplayFile {
                file: request.file,
                reason: "is in no folder that all API nodes have: `flankwatch replay` sends recordings to them",
            });
        }
        let spec = self.hearers(&request.asset).await?.asset.spec;
        let path = replay_folder::find(&self.inner.folders.recordings, &request.file)?;
        let turn = self.recording_turn()?;
        let started_at = self.inner.clock.now();
        let replay = Replay {
            id: String::new(),
            asset: request.asset,
            file: request.file,
            pace: request.pace,
            state: ReplayState::Running,
            error: None,
            records_total: None,
            records_done: 0,
            stored: 0,
            repeated: 0,
            refused: 0,
            started_at,
            finished_at: None,
            first_start_time: None,
            last_start_time: None,
            record_seconds_done: 0.0,
            times_real_time: None,
        };
        let (number, replay, forgotten) = {
            let mut held = self.inner.replays.lock();
            let number = held.given_out + 1;
            held.given_out = number;
            let replay = Replay {
                id: number.to_string(),
                ..replay
            };
            (number, replay, number.saturating_sub(MOST_REMEMBERED as u64))
        };
        self.save_replay(number, &replay).await;
        if let Err(error) = self.inner.store.forget_replays_before(forgotten).await {
            tracing::warn!(%error, "old replays not forgotten");
        }
        Ok(self.run_in_background(number, replay, spec, path, turn))
    }

    /// Goes on with the replays that were running when the process before ended, and remembers those that were over.
    pub(super) async fn resume_replays(&self) -> Result<(), IngestError> {
        for (number, text) in self.inner.store.saved_replays().await? {
            let replay: Replay = match serde_json::from_str(&text) {
                Ok(replay) => replay,
                Err(error) => {
                    tracing::warn!(replay = number, %error, "stored replay cannot be read");
                    continue;
                }
            };
            {
                let mut held = self.inner.replays.lock();
                held.given_out = held.given_out.max(number);
                let over = (Arc::new(replay.clone()), watch::channel(false).0);
                held.by_number.insert(number, over);
            }
            if replay.state == ReplayState::Running {
                tracing::info!(replay = number, file = replay.file, done = replay.records_done, "replay goes on");
                self.resume_replay(number, replay).await;
            }
        }
        Ok(())
    }

    async fn resume_replay(&self, number: u64, mut replay: Replay) {
        let found = async {
            let spec = self.hearers(&replay.asset).await?.asset.spec;
            let path = replay_folder::find(&self.inner.folders.recordings, &replay.file)?;
            Ok::<_, IngestError>((spec, path, self.recording_turn()?))
        };
        match found.await {
            Ok((spec, path, turn)) => {
                self.run_in_background(number, replay, spec, path, turn);
            }
            Err(error) => {
                tracing::warn!(replay = number, %error, "replay cannot go on");
                replay.state = ReplayState::Failed;
                replay.error = Some(error.to_string());
                replay.finished_at = Some(self.inner.clock.now());
                self.save_replay(number, &replay).await;
                if let Some((held, _)) = self.inner.replays.lock().by_number.get_mut(&number) {
                    *held = Arc::new(replay);
                }
            }
        }
    }

    fn run_in_background(
        &self,
        number: u64,
        replay: Replay,
        spec: AssetSpec,
        path: PathBuf,
        turn: tokio::sync::OwnedSemaphorePermit,
    ) -> Arc<Replay> {
        let (stop, stopped) = watch::channel(false);
        let first = Arc::new(replay.clone());
        {
            let mut held = self.inner.replays.lock();
            held.by_number.insert(number, (Arc::clone(&first), stop));
            while held.by_number.len() > MOST_REMEMBERED {
                let ended = held.by_number.iter().find(|(_, (replay, _))| replay.state != ReplayState::Running);
                let Some(number) = ended.map(|(number, _)| *number) else { break };
                held.by_number.remove(&number);
            }
        }
        let defaults = defaults_of(&spec, replay.started_at);
        let done = usize::try_from(replay.records_done).unwrap_or(usize::MAX);
        let records = RecordStream::spawn(self.inner.workers.recording_bytes(), move || {
            Ok(RecordingFile::open(&path, defaults, None)?.skip(done))
        });
        let ingest = self.clone();
        tokio::spawn(async move {
            let _turn = turn;
            ingest.run_replay(number, replay, records, stopped).await;
        });
        first
    }

    /// Notes a replay in the store, to go on with at the next start.
    pub(super) async fn save_replay(&self, number: u64, replay: &Replay) {
        // A recording in the folder of one of several processes is that one's own affair.
        if self.inner.store.is_shared() {
            return;
        }
        let text = match serde_json::to_string(replay) {
            Ok(text) => text,
            Err(error) => {
                tracing::warn!(replay = number, %error, "replay not saved");
                return;
            }
        };
        if let Err(error) = self.inner.store.save_replay(number, &text).await {
            tracing::warn!(replay = number, %error, "replay not saved");
        }
    }

    /// All replays, the latest first.
    pub fn replays(&self) -> Vec<Arc<Replay>> {
        let held = self.inner.replays.lock();
        held.by_number.values().rev().map(|(replay, _)| Arc::clone(replay)).collect()
    }

    /// A replay.
    ///
    /// Error: [`IngestError::ReplayUnknown`].
    pub fn replay(&self, id: &str) -> Result<Arc<Replay>, IngestError> {
        let unknown = || IngestError::ReplayUnknown(id.to_string());
        let number: u64 = id.parse().map_err(|_| unknown())?;
        let held = self.inner.replays.lock();
        held.by_number
            .get(&number)
            .map(|(replay, _)| Arc::clone(replay))
            .ok_or_else(unknown)
    }

    /// Stops a replay and waits until it has; one that has ended is left as it is.
    pub async fn stop_replay(&self, id: &str) -> Result<Arc<Replay>, IngestError> {
        self.replay(id)?;
        let ended = {
            let held = self.inner.replays.lock();
            let entry = id.parse().ok().and_then(|number: u64| held.by_number.get(&number));
            entry.map(|(_, stop)| {
                stop.send_replace(true);
                stop.clone()
            })
        };
        if let Some(ended) = ended {
            // The replay drops its end of the channel when it is over.
            ended.closed().await;
        }
        self.replay(id)
    }

    /// Whether the service ends.
    pub(super) fn is_ending(&self) -> bool {
        self.inner.replays.is_ending.load(Ordering::SeqCst)
    }

    /// Stops all replays, for the end of the service: they go on at its next start.
    pub async fn stop_replays(&self) {
        self.inner.replays.is_ending.store(true, Ordering::SeqCst);
        for replay in self.replays() {
            if let Err(error) = self.stop_replay(&replay.id).await {
                tracing::warn!(replay = replay.id, %error, "replay not stopped");
            }
        }
    }

    /// Shows a replay as it is now.
    pub(super) fn announce_replay(&self, number: u64, replay: &Replay) {
        let shown = Arc::new(replay.clone());
        if let Some((held, _)) = self.inner.replays.lock().by_number.get_mut(&number) {
            *held = Arc::clone(&shown);
        }
        self.announce(Announcement::ReplayChanged(shown));
    }
}
