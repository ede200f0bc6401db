//! Replays: recordings from the replay folder sent through the pipeline, at the pace at which they were
//! recorded or faster.

mod folder;
mod list;
mod run;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::sync::{OwnedSemaphorePermit, watch};

use super::clock::Clock;
use super::error::ServiceError;
use super::events::EventSender;
use super::pipeline::{Pipeline, RecordStream};
use super::record::{ChannelUnits, defaults_of};
use super::replay::{Replay, ReplayRequest, ReplayState};
use super::sensor_group::SensorGroup;
use super::work_queue::Role;
use super::workers::{Workers, blocking};
use crate::asset::{AssetId, AssetSpec};
use crate::recording::{Cut, RecordingFile};
use crate::store::Store;
pub use folder::ReplayFile;
pub(crate) use folder::prepare as prepare_folders;
use list::ReplayList;
use run::Run;

/// Runs and lists replays.
pub struct Replays {
    store: Store,
    workers: Arc<Workers>,
    pipeline: Arc<Pipeline>,
    clock: Arc<dyn Clock>,
    role: Role,
    folder: PathBuf,
    list: Arc<ReplayList>,
    /// Whether the service ends: replays that are stopped now resume at the next start.
    is_ending: Arc<AtomicBool>,
}

impl Replays {
    pub(crate) fn new(
        store: Store,
        workers: Arc<Workers>,
        pipeline: Arc<Pipeline>,
        clock: Arc<dyn Clock>,
        events: EventSender,
        role: Role,
        folder: PathBuf,
    ) -> Self {
        Self {
            list: Arc::new(ReplayList::new(store.clone(), events)),
            store,
            workers,
            pipeline,
            clock,
            role,
            folder,
            is_ending: Arc::default(),
        }
    }

    /// The recordings that may be replayed, the latest first; an API node has none.
    ///
    /// # Errors
    /// [`ServiceError::WorkerLost`].
    pub async fn files(&self) -> Result<Vec<ReplayFile>, ServiceError> {
        if self.role.is_api_node() {
            return Ok(Vec::new());
        }
        let folder = self.folder.clone();
        blocking("list recordings", move || folder::recordings(&folder)).await
    }

    /// Starts a replay.
    ///
    /// # Errors
    /// The asset does not exist, the file is outside the replay folder, too many recordings are being read,
    /// or this is an API node, which has no replay folder.
    pub async fn start(&self, request: ReplayRequest) -> Result<Arc<Replay>, ServiceError> {
        if self.role.is_api_node() {
            return Err(ServiceError::ReplayFile {
                file: request.file,
                reason: "cannot be replayed by an API node, which has no replay folder: send it with `flankwatch replay`",
            });
        }
        request.recording.check()?;
        let found = self.find(&request.asset, &request.file).await?;
        let permit = self.workers.admit_recording()?;
        let mut replay = Replay::begin(request, self.clock.now());
        let number = self.list.number(&mut replay).await;
        Ok(self.run_in_background(number, replay, found, Some(permit)))
    }

    /// Resumes the replays that were running when the previous process ended, and lists the ended ones.
    pub(crate) async fn resume(&self) -> Result<(), ServiceError> {
        for (number, mut replay) in self.list.load().await? {
            tracing::info!(
                replay = number,
                file = replay.file,
                done = replay.records_done,
                "resuming a replay"
            );
            match self.find(&replay.asset, &replay.file).await {
                Ok(found) => {
                    // All that were running may be more than are admitted at once.
                    self.run_in_background(number, replay, found, None);
                }
                Err(error) => {
                    tracing::warn!(replay = number, %error, "failed to resume a replay");
                    replay.state = ReplayState::Failed;
                    replay.error = Some(error.to_string());
                    replay.finished_at = Some(self.clock.now());
                    self.list.save(number, &replay).await;
                    self.list.update(number, &replay);
                }
            }
        }
        Ok(())
    }

    /// Finds what a replay needs: the asset's description and the recording.
    async fn find(
        &self,
        asset: &AssetId,
        file: &str,
    ) -> Result<(AssetSpec, ChannelUnits, PathBuf), ServiceError> {
        let spec = SensorGroup::load(&self.store, asset).await?.asset.spec;
        let path = folder::find(&self.folder, file)?;
        let units = ChannelUnits::load(&self.store, &spec).await?;
        Ok((spec, units, path))
    }

    /// Runs a replay, which waits for a permit to read its recording if it has none.
    fn run_in_background(
        &self,
        number: u64,
        replay: Replay,
        (spec, units, path): (AssetSpec, ChannelUnits, PathBuf),
        permit: Option<OwnedSemaphorePermit>,
    ) -> Arc<Replay> {
        let (stop, mut stopped) = watch::channel(false);
        let first = Arc::new(replay.clone());
        self.list.insert_running(number, Arc::clone(&first), stop);
        let mut defaults = defaults_of(&spec, &units, replay.started_at);
        replay.recording.complete(&mut defaults);
        let cut = replay.recording.record_seconds.map(Cut::Seconds);
        let done = usize::try_from(replay.records_done).unwrap_or(usize::MAX);
        let workers = Arc::clone(&self.workers);
        let run = Run {
            pipeline: Arc::clone(&self.pipeline),
            list: Arc::clone(&self.list),
            clock: Arc::clone(&self.clock),
            is_ending: Arc::clone(&self.is_ending),
            number,
        };
        tokio::spawn(async move {
            let _permit = match permit {
                Some(permit) => Some(permit),
                None => tokio::select! {
                    permit = workers.wait_for_recording() => permit,
                    _ = stopped.wait_for(|stopped| *stopped) => None,
                },
            };
            let records = RecordStream::spawn(workers.recording_bytes(), move || {
                Ok(RecordingFile::open(&path, defaults, cut)?.skip(done))
            });
            let records = records.numbered_from(replay.records_done);
            run.to_end(replay, records, stopped).await;
        });
        first
    }

    /// All replays, the latest first.
    pub fn list(&self) -> Vec<Arc<Replay>> {
        self.list.all()
    }

    /// A replay.
    ///
    /// # Errors
    /// [`ServiceError::ReplayUnknown`].
    pub fn get(&self, id: &str) -> Result<Arc<Replay>, ServiceError> {
        Ok(self.list.get(id)?.0)
    }

    /// Stops a replay and waits until it has stopped; an ended one stays as it is.
    pub async fn stop(&self, id: &str) -> Result<Arc<Replay>, ServiceError> {
        let (_, stop) = self.list.get(id)?;
        stop.send_replace(true);
        // The replay drops its end of the channel when it ends.
        stop.closed().await;
        self.get(id)
    }

    /// Stops all replays at the end of the service; they resume at the next start.
    pub async fn stop_all(&self) {
        self.is_ending.store(true, Ordering::SeqCst);
        for replay in self.list() {
            if let Err(error) = self.stop(&replay.id).await {
                tracing::warn!(replay = replay.id, %error, "failed to stop a replay");
            }
        }
    }
}
