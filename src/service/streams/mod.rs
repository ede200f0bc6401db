//! Live streams: continuous samples, stored in a journal on the disk until records are cut out of them and
//! sent through the pipeline.
//!
//! Acknowledged samples are durable. After a crash the next start continues with the journal: a record that
//! was cut is the same record then, with the same identifier, and is stored once.

mod campaigns;
mod capture;
mod cutting;
mod feed;
mod frame;
mod live;
mod on_alarm;
mod recent;
mod sender;
mod state;
mod steadiness;
mod stored;
mod storing;
mod tachometer;

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use jiff::Timestamp;
use tokio::sync::watch;

use super::clock::Clock;
use super::error::ServiceError;
use super::events::Announcer;
use super::pipeline::Pipeline;
use super::sensor_group::SensorGroup;
use super::workers::{Workers, blocking};
use crate::asset::AssetId;
use crate::recording::stream::{CutPolicy, StreamFormat};
use crate::store::{Store, StoreError, TimedLevel};
pub use campaigns::CampaignStatus;
use cutting::{Cutting, check_bytes};
pub use feed::{LiveUpdate, StreamViewer};
pub use frame::{LiveChannel, LiveFrame, LiveSpeedSource};
use live::LiveStream;
pub use sender::StreamSender;
use stored::{StoredStream, folder_of};
pub use stored::{StreamGap, StreamProgress};
pub(crate) use tachometer::Pulses;

/// Maximum number of streams of one asset.
const MAX_OF_ASSET: usize = 16;

/// Number of records of a stream waiting for the pipeline from which on the sender has to wait.
const MAX_PENDING: usize = 4;

/// The live streams of a service.
pub struct Streams {
    store: Store,
    workers: Arc<Workers>,
    pipeline: Arc<Pipeline>,
    clock: Arc<dyn Clock>,
    /// `None` on a shared store, because a journal is in the folder of one process.
    folder: Option<PathBuf>,
    events: Announcer,
    all: Mutex<HashMap<(AssetId, String), Arc<LiveStream>>>,
    is_over: watch::Sender<bool>,
}

/// The status of a stream.
#[derive(Debug, Clone, PartialEq)]
pub struct StreamStatus {
    /// Its name.
    pub name: String,
    /// The format of its samples.
    pub format: StreamFormat,
    /// Index after the last stored sample.
    pub next: Option<u64>,
    /// The time of this index.
    pub next_time: Option<Timestamp>,
    /// Deviation of the actual from the nominal sampling rate in parts per million; positive if samples
    /// arrive faster.
    pub drift_ppm: Option<f64>,
    /// Number of jumps of the sender's clock.
    pub clock_jumps: u64,
    /// Number of gaps.
    pub gaps: u64,
    /// Samples of each channel that are missing in the gaps.
    pub gap_samples: u64,
    /// Number of cuts stored as records; the records of all channels count as one.
    pub records: u64,
    /// Number of cuts whose records were refused.
    pub records_refused: u64,
    /// Number of cuts that are not stored yet.
    pub records_waiting: u64,
    /// Bytes of the journal on the disk.
    pub journal_bytes: u64,
    /// The running measuring campaign, or else the last one.
    pub campaign: Option<CampaignStatus>,
}

impl Streams {
    pub(crate) fn new(
        store: Store,
        workers: Arc<Workers>,
        pipeline: Arc<Pipeline>,
        clock: Arc<dyn Clock>,
        events: Announcer,
        folder: PathBuf,
    ) -> Arc<Self> {
        let folder = (!store.is_shared()).then_some(folder);
        let is_over = watch::Sender::new(false);
        Arc::new(Self { store, workers, pipeline, clock, folder, events, all: Mutex::default(), is_over })
    }

    /// Opens a stream for sending, a new one or an existing one. A previous sender is notified that it has
    /// been replaced. `first` is the index at which a new stream starts; by default that of its first sample.
    ///
    /// Errors: the asset has no sensor of its own; the stream has another format; a record of it would be too
    /// large; the asset has too many streams.
    pub async fn open(
        self: &Arc<Self>,
        asset: &AssetId,
        name: &str,
        format: StreamFormat,
        first: Option<u64>,
    ) -> Result<StreamSender, ServiceError> {
        check_name(name)?;
        let described = SensorGroup::of(&self.store, asset).await?.asset;
        let cutting = Arc::new(Cutting::of(&described.spec, &format)?);
        let stream = self.find(asset, name, true)?;
        let (opened, created_at, wanted) = (Arc::clone(&stream), described.created_at, format.clone());
        let (next, owner) = blocking("open a stream", move || {
            opened.with(|stored| {
                if stored.as_ref().is_some_and(|stored| stored.state().asset_created_at != created_at) {
                    // The stream of a deleted asset of the same name.
                    *stored = None;
                    remove_folder(&opened)?;
                }
                let stored = match stored {
                    Some(stored) => stored,
                    None => stored.insert(StoredStream::create(
                        Arc::clone(&opened.disk),
                        &opened.folder,
                        created_at,
                        wanted.clone(),
                        first,
                    )?),
                };
                if stored.state().format != wanted {
                    return Err(ServiceError::StreamFormat {
                        asset: opened.asset.clone(),
                        name: opened.name.clone(),
                    });
                }
                stored.drop_waiting_chunks();
                Ok((stored.state().next, opened.take_over()))
            })
        })
        .await??;
        self.cut_in_background(&stream);
        let pending = stream.follow_pending();
        Ok(StreamSender { streams: Arc::clone(self), stream, owner, cutting, format, next, pending })
    }

    /// The status of each stream of an asset, sorted by name.
    pub async fn list(&self, asset: &AssetId) -> Result<Vec<StreamStatus>, ServiceError> {
        self.store.asset(asset).await?;
        let streams = self.of_asset(asset);
        let list = move || {
            let known = streams
                .iter()
                .filter_map(|stream| stream.with_stored(|stored| Ok(status(stream, stored))).ok());
            let mut known: Vec<StreamStatus> = known.collect();
            known.sort_by(|one, other| one.name.cmp(&other.name));
            known
        };
        blocking("read the status of streams", list).await
    }

    /// The status of a stream.
    ///
    /// Error: [`ServiceError::StreamUnknown`].
    pub async fn status(&self, asset: &AssetId, name: &str) -> Result<StreamStatus, ServiceError> {
        self.of_stream(asset, name, |stream, stored| Ok(status(stream, stored))).await
    }

    /// The levels of each second of a stream from one time to another.
    ///
    /// Error: [`ServiceError::StreamUnknown`].
    pub async fn levels(
        &self,
        asset: &AssetId,
        name: &str,
        from_ns: i64,
        to_ns: i64,
    ) -> Result<Vec<TimedLevel>, ServiceError> {
        self.of_stream(asset, name, move |_, stored| stored.levels(from_ns, to_ns)).await
    }

    /// Makes a record of the last seconds of a stream; returns its start time and its number of samples.
    ///
    /// Errors: [`ServiceError::StreamUnknown`], also if the stream has no sample.
    pub async fn keep_last(
        self: &Arc<Self>,
        asset: &AssetId,
        name: &str,
        seconds: f64,
    ) -> Result<(Timestamp, u64), ServiceError> {
        let kept = self.of_stream(asset, name, move |stream, stored| {
            // The same limit as for other records that are cut.
            let format = stored.state().format.clone();
            let most = CutPolicy::new(seconds, seconds, format.sample_rate_hz())?.record_frames();
            check_bytes(most, &format)?;
            if stored.state().pending.len() >= MAX_PENDING {
                return Err(ServiceError::Busy {
                    what: "too many records of the stream are waiting to be stored",
                    retry_after_s: 5,
                });
            }
            stored.keep_last(most)?.ok_or_else(|| stream.unknown())
        });
        let kept = kept.await?;
        self.cut_in_background(&self.find(asset, name, false)?);
        Ok((kept.start_time, kept.cut.frames))
    }

    /// Removes the streams of a deleted asset.
    pub async fn remove(&self, asset: &AssetId) -> Result<(), ServiceError> {
        let gone: Vec<Arc<LiveStream>> = {
            let mut all = self.all.lock().unwrap_or_else(PoisonError::into_inner);
            all.extract_if(|(of, _), _| of == asset).map(|(_, stream)| stream).collect()
        };
        blocking("remove streams", move || gone.iter().try_for_each(|stream| stream.remove())).await?
    }

    /// Ends the connections of all senders, at the end of the service.
    pub fn stop(&self) {
        self.is_over.send_replace(true);
    }

    /// Stops all writes, before another process takes over the data folder.
    pub async fn close(&self) {
        self.stop();
        let all: Vec<Arc<LiveStream>> = {
            let all = self.all.lock().unwrap_or_else(PoisonError::into_inner);
            all.values().cloned().collect()
        };
        if let Err(error) =
            blocking("close streams", move || all.iter().for_each(|stream| stream.close())).await
        {
            tracing::error!(%error, "failed to close the live streams");
        }
    }

    /// Becomes true when the service ends.
    pub fn follow_end(&self) -> watch::Receiver<bool> {
        self.is_over.subscribe()
    }

    /// Resumes the streams that the previous process left.
    pub(crate) async fn resume(self: &Arc<Self>) -> Result<(), ServiceError> {
        let Some(folder) = self.folder.clone() else { return Ok(()) };
        self.follow_alarms_in_background();
        for (asset, name) in blocking("list streams", move || names_in(&folder)).await? {
            let stream = self.find(&asset, &name, true)?;
            let described = match self.store.asset(&asset).await {
                Err(StoreError::AssetUnknown(_)) => None,
                described => Some(described?),
            };
            let opened = Arc::clone(&stream);
            let is_there = blocking("open a stream", move || {
                let Some(described) = described else { return opened.remove().map(|()| false) };
                opened.with(|stored| {
                    let Some(stored) = stored else { return Ok(false) };
                    if stored.state().asset_created_at != described.created_at {
                        return Ok(false);
                    }
                    if let Ok(cutting) = Cutting::of(&described.spec, &stored.state().format) {
                        stored.plan_records(&cutting)?;
                    }
                    Ok(true)
                })
            });
            match is_there.await? {
                Ok(true) => self.cut_in_background(&stream),
                Ok(false) => {}
                Err(error) => tracing::error!(%asset, name, %error, "failed to resume a stream"),
            }
        }
        Ok(())
    }

    fn of_asset(&self, asset: &AssetId) -> Vec<Arc<LiveStream>> {
        let all = self.all.lock().unwrap_or_else(PoisonError::into_inner);
        all.values().filter(|stream| stream.asset == *asset).cloned().collect()
    }

    async fn of_stream<T: Send + 'static>(
        &self,
        asset: &AssetId,
        name: &str,
        work: impl FnOnce(&LiveStream, &mut StoredStream) -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        self.store.asset(asset).await?;
        let stream = self.find(asset, name, false)?;
        blocking("access a stream", move || stream.with_stored(|stored| work(&stream, stored))).await?
    }

    /// Finds a stream; creates it in memory if `is_made`.
    fn find(&self, asset: &AssetId, name: &str, is_made: bool) -> Result<Arc<LiveStream>, ServiceError> {
        let folder = self.folder.as_deref().ok_or(ServiceError::StreamsShared)?;
        let mut all = self.all.lock().unwrap_or_else(PoisonError::into_inner);
        let key = (asset.clone(), name.to_owned());
        if let Some(stream) = all.get(&key) {
            return Ok(Arc::clone(stream));
        }
        if !is_made {
            return Err(ServiceError::StreamUnknown { asset: asset.clone(), name: name.to_owned() });
        }
        if all.keys().filter(|(of, _)| of == asset).count() >= MAX_OF_ASSET {
            let expected = "one of the asset's existing streams, which are at the maximum of 16";
            return Err(ServiceError::Field { field: "name", value: name.to_owned(), expected });
        }
        let folder = folder_of(folder, asset.as_str(), name);
        let stream = Arc::new(LiveStream::new(asset.clone(), name.to_owned(), folder, self.store.disk()));
        all.insert(key, Arc::clone(&stream));
        Ok(stream)
    }
}

fn status(stream: &LiveStream, stored: &StoredStream) -> StreamStatus {
    let state = stored.state();
    StreamStatus {
        name: stream.name.clone(),
        format: state.format.clone(),
        next: state.next,
        next_time: state.next.and_then(|next| state.time(next)),
        drift_ppm: state.clock.drift_ppm(),
        clock_jumps: state.clock.jumps(),
        gaps: state.gaps,
        gap_samples: state.gap_samples,
        records: state.records,
        records_refused: state.refused,
        records_waiting: state.pending.len() as u64,
        journal_bytes: stored.journal_bytes(),
        campaign: CampaignStatus::of(state),
    }
}

/// Checks a stream name, which is part of a path.
fn check_name(name: &str) -> Result<(), ServiceError> {
    AssetId::new(name).map(|_| ()).map_err(|_| ServiceError::Field {
        field: "name",
        value: format!("{:?}", name.chars().take(64).collect::<String>()),
        expected: "1 to 64 characters of a-z, 0-9, - and _, starting with a letter or digit",
    })
}

fn remove_folder(stream: &LiveStream) -> Result<(), ServiceError> {
    stream.disk.remove_folder(&stream.folder).map_err(|source| ServiceError::File {
        action: "remove",
        path: stream.folder.clone(),
        source,
    })
}

/// The assets and names of the streams in a folder.
fn names_in(folder: &std::path::Path) -> Vec<(AssetId, String)> {
    let names = |folder: &std::path::Path| -> Vec<String> {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.filter_map(|entry| entry.file_name().into_string().ok()).collect()
    };
    let assets = names(folder).into_iter().filter_map(|asset| AssetId::new(asset).ok());
    assets
        .flat_map(|asset| {
            let streams = names(&folder.join(asset.as_str())).into_iter();
            streams
                .filter(|name| check_name(name).is_ok())
                .map(move |name| (asset.clone(), name))
                .collect::<Vec<_>>()
        })
        .collect()
}
