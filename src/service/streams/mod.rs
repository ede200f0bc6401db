//! Live streams: continuous samples, stored in a journal until records are cut out of them and sent through
//! the pipeline. The journal is in files, or in rows of a shared store.
//!
//! Acknowledged samples are durable. After a crash the next start continues with the journal, or another
//! process of a shared store does: a record that was cut is the same record then, with the same identifier,
//! and is stored once.

mod campaigns;
mod capture;
mod cutting;
mod frame;
mod journal;
mod live;
mod live_view;
mod location;
mod new_stream;
mod on_alarm;
mod recent;
mod sender;
mod shared_journal;
mod state;
mod status;
mod steadiness;
mod stored;
mod storing;
mod tachometer;
mod taking_over;

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use jiff::Timestamp;
use tokio::sync::{Semaphore, watch};

use super::clock::Clock;
use super::error::ServiceError;
use super::events::EventSender;
use super::pipeline::Pipeline;
use super::record::ChannelUnits;
use super::sensor_group::SensorGroup;
use super::workers::{Workers, blocking};
use crate::asset::AssetId;
use crate::recording::stream::{CutPolicy, StreamFormat};
use crate::store::{Store, StoreError, TimedLevel};
pub use campaigns::CampaignStatus;
use cutting::{Cutting, check_bytes};
pub use frame::{LiveChannel, LiveFrame, LiveSpeedSource};
use live::LiveStream;
pub use live_view::{LiveUpdate, StreamViewer};
use location::{SharedRows, StreamStorage, check_name, random, streams_in, too_many};
use new_stream::NewStream;
pub use sender::StreamSender;
pub use status::StreamStatus;
use stored::StoredStream;
pub use stored::{StreamGap, StreamProgress};
pub(crate) use tachometer::Pulses;

/// Time for the database to end what it is doing with streams when the service ends.
const CLOSING: Duration = Duration::from_secs(2);

/// Maximum number of records of a stream that wait for the pipeline; then the sender waits.
const MAX_PENDING: usize = 4;

/// The live streams of a service.
pub struct Streams {
    store: Store,
    workers: Arc<Workers>,
    pipeline: Arc<Pipeline>,
    clock: Arc<dyn Clock>,
    storage: StreamStorage,
    /// Alarms.
    events: EventSender,
    all: Mutex<HashMap<(AssetId, String), Arc<LiveStream>>>,
    /// Records that may be in memory at once, from the journal to the commit: as many as keep the worker
    /// threads busy. The records of streams that began together are all complete at the same time.
    records_at_once: Semaphore,
    is_over: watch::Sender<bool>,
}

impl Streams {
    pub(crate) fn new(
        store: Store,
        workers: Arc<Workers>,
        pipeline: Arc<Pipeline>,
        clock: Arc<dyn Clock>,
        events: EventSender,
        folder: PathBuf,
    ) -> Arc<Self> {
        let storage = if store.is_shared() {
            StreamStorage::Shared(Arc::new(SharedRows::new(store.clone(), Arc::clone(&clock))))
        } else {
            StreamStorage::Folder { disk: store.disk(), folder }
        };
        let is_over = watch::Sender::new(false);
        let records_at_once = Semaphore::new(workers.threads() + 1);
        let all = Mutex::default();
        Arc::new(Self { store, workers, pipeline, clock, storage, events, all, records_at_once, is_over })
    }

    /// Opens a stream for sending, a new one or an existing one. A new one is created with its first sample.
    /// A previous sender is notified that it has been replaced. `first` is the index at which a new stream
    /// starts; by default that of its first sample.
    ///
    /// # Errors
    /// The asset has no sensor of its own; its unit cannot be converted to that of a channel; the stream has
    /// another format; a record of it would be too large; the asset has too many streams; the stream may be
    /// that of an asset which the database has lost.
    pub async fn open(
        self: &Arc<Self>,
        asset: &AssetId,
        name: &str,
        format: StreamFormat,
        first: Option<u64>,
    ) -> Result<StreamSender, ServiceError> {
        check_name(name)?;
        let described = SensorGroup::load(&self.store, asset).await?.asset;
        let units = ChannelUnits::load(&self.store, &described.spec).await?;
        if let Some(unit) = &format.unit {
            format.signal_names().iter().try_for_each(|channel| units.check(channel, unit))?;
        }
        // Only where it is that of all channels.
        let mut defaults =
            format.signal_names().into_iter().map(|channel| units.default_of(&channel).map(str::to_owned));
        let first_default = defaults.next().flatten();
        let default_unit = first_default.filter(|first| defaults.all(|other| other.as_ref() == Some(first)));
        let with_unit = move |format: &StreamFormat| {
            let mut format = format.clone();
            format.unit = format.unit.or_else(|| default_unit.clone());
            format
        };
        let cutting = Arc::new(Cutting::of(&described.spec, &format)?);
        let stream = self.in_memory(asset, name)?;
        let (opened, created_at, wanted) = (Arc::clone(&stream), described.created_at, format.clone());
        let is_held = self.store.removal_hold().is_some();
        let (next, owner, new_stream, is_timed, newest_ns) = blocking("open a stream", move || {
            opened.with(|stored| {
                if stored.as_ref().is_some_and(|stored| stored.state().asset_created_at != created_at) {
                    if is_held {
                        return Err(opened.held());
                    }
                    // The stream of a deleted asset of the same name.
                    *stored = None;
                    opened.location.remove()?;
                }
                let Some(stored) = stored else {
                    let new_stream =
                        NewStream { asset_created_at: created_at, format: wanted.clone(), first };
                    return Ok((first, opened.take_over(), Some(new_stream), false, None));
                };
                let known = with_unit(&stored.state().format);
                if let Some((field, value, expected)) = known.difference(&with_unit(&wanted)) {
                    let (asset, name) = (opened.asset.clone(), opened.name.clone());
                    let (value, expected) = (value.into(), expected.into());
                    return Err(ServiceError::StreamFormat { asset, name, field, value, expected });
                }
                let owner = if opened.location.is_shared() {
                    let owner = random() as u64;
                    stored.begin_sending(owner)?;
                    owner
                } else {
                    opened.take_over()
                };
                stored.drop_waiting_chunks();
                let state = stored.state();
                Ok((state.next, owner, None, stored.is_timed(), state.newest_ns))
            })
        })
        .await??;
        self.cut_in_background(&stream);
        let pending = stream.watch_pending();
        let streams = Arc::clone(self);
        Ok(StreamSender {
            streams,
            stream,
            owner,
            cutting,
            format,
            next,
            new_stream,
            is_timed,
            newest_ns,
            pending,
        })
    }

    /// The status of each stream of an asset, sorted by name.
    pub async fn list(&self, asset: &AssetId) -> Result<Vec<StreamStatus>, ServiceError> {
        self.store.asset(asset).await?;
        let streams = self.of_asset(asset).await?;
        let list = move || {
            let known = streams
                .iter()
                .filter_map(|stream| stream.with_stored(|stored| StreamStatus::of(stream, stored)).ok());
            let mut known: Vec<StreamStatus> = known.collect();
            known.sort_by(|one, other| one.name.cmp(&other.name));
            known
        };
        blocking("read the status of streams", list).await
    }

    /// The status of a stream.
    ///
    /// # Errors
    /// [`ServiceError::StreamUnknown`].
    pub async fn status(&self, asset: &AssetId, name: &str) -> Result<StreamStatus, ServiceError> {
        self.of_stream(asset, name, |stream, stored| StreamStatus::of(stream, stored)).await
    }

    /// The levels of each second of a stream from one time to another.
    ///
    /// # Errors
    /// [`ServiceError::StreamUnknown`].
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
    /// # Errors
    /// [`ServiceError::StreamUnknown`], also if the stream has no sample.
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
        self.cut_in_background(&self.find(asset, name).await?);
        Ok((kept.start_time, kept.cut.frames))
    }

    /// Removes a stream with its samples that are not part of a stored record.
    ///
    /// # Errors
    /// [`ServiceError::StreamUnknown`].
    pub async fn remove_stream(&self, asset: &AssetId, name: &str) -> Result<(), ServiceError> {
        self.status(asset, name).await?;
        let stream = self.find(asset, name).await?;
        if self.storage.shared().is_some() {
            self.store.remove_stream(asset, name).await?;
        }
        self.remove_from_memory(vec![stream], false).await
    }

    /// Removes the streams of a deleted asset.
    pub(crate) async fn remove(&self, asset: &AssetId) -> Result<(), ServiceError> {
        let gone: Vec<Arc<LiveStream>> = {
            let all = self.all.lock().unwrap_or_else(PoisonError::into_inner);
            all.values().filter(|stream| stream.asset == *asset).cloned().collect()
        };
        self.remove_each(gone).await
    }

    /// Removes streams whose asset does not exist. Their folders are kept while removals are suspended: a
    /// database that was lost or is older than the raw recordings proves nothing about an asset.
    async fn remove_each(&self, gone: Vec<Arc<LiveStream>>) -> Result<(), ServiceError> {
        self.remove_from_memory(gone, self.store.removal_hold().is_some()).await
    }

    /// Removes streams from memory, and their folders unless these are held.
    async fn remove_from_memory(
        &self,
        gone: Vec<Arc<LiveStream>>,
        is_held: bool,
    ) -> Result<(), ServiceError> {
        let remove = move || {
            for stream in gone {
                stream.remove(is_held)?;
                if is_held {
                    tracing::warn!(asset = %stream.asset, name = stream.name, "kept the journal of a stream without an asset: `flankwatch rebuild` restores assets");
                }
            }
            Ok(())
        };
        let removed = blocking("remove streams", remove).await?;
        // Only now: until then nobody may create another stream in the folder.
        self.all.lock().unwrap_or_else(PoisonError::into_inner).retain(|_, stream| !stream.is_removed());
        removed
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
        let close = blocking("close streams", move || all.iter().for_each(|stream| stream.close()));
        if self.storage.shared().is_some() {
            // A statement of an unreachable database is not awaited: what it appends is whole in any case.
            let close = async {
                let _ = close.await;
                self.release_cutting().await;
            };
            if tokio::time::timeout(CLOSING, close).await.is_err() {
                tracing::warn!("failed to release the live streams in time; another process takes them over");
            }
        } else if let Err(error) = close.await {
            tracing::error!(%error, "failed to close the live streams");
        }
    }

    /// Becomes true when the service ends.
    pub fn watch_end(&self) -> watch::Receiver<bool> {
        self.is_over.subscribe()
    }

    /// Resumes the streams that the previous process left; on a shared store, also those that other processes
    /// leave from now on.
    pub(crate) async fn resume(self: &Arc<Self>) -> Result<(), ServiceError> {
        self.watch_alarms_in_background();
        let StreamStorage::Folder { folder, .. } = &self.storage else {
            self.take_over_in_background();
            return Ok(());
        };
        let folder = folder.clone();
        for (asset, name) in blocking("list streams", move || streams_in(&folder)).await? {
            let stream = self.in_memory(&asset, &name)?;
            let described = match self.store.asset(&asset).await {
                Err(StoreError::AssetUnknown(_)) => None,
                described => Some(described?),
            };
            let Some(described) = described else {
                if let Err(error) = self.remove_each(vec![stream]).await {
                    tracing::error!(%asset, name, %error, "failed to remove a stream without an asset");
                }
                continue;
            };
            let opened = Arc::clone(&stream);
            let is_there = blocking("open a stream", move || {
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

    /// The streams of an asset.
    async fn of_asset(&self, asset: &AssetId) -> Result<Vec<Arc<LiveStream>>, ServiceError> {
        if self.storage.shared().is_some() {
            let names = self.store.stream_names(asset).await?;
            return names.iter().map(|name| self.in_memory(asset, name)).collect();
        }
        let all = self.all.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(all.values().filter(|stream| stream.asset == *asset).cloned().collect())
    }

    async fn of_stream<T: Send + 'static>(
        &self,
        asset: &AssetId,
        name: &str,
        work: impl FnOnce(&LiveStream, &mut StoredStream) -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        self.store.asset(asset).await?;
        let stream = self.find(asset, name).await?;
        blocking("access a stream", move || stream.with_stored(|stored| work(&stream, stored))).await?
    }

    /// Finds a stream.
    async fn find(&self, asset: &AssetId, name: &str) -> Result<Arc<LiveStream>, ServiceError> {
        let key = (asset.clone(), name.to_owned());
        let known = self.all.lock().unwrap_or_else(PoisonError::into_inner).get(&key).cloned();
        if let Some(stream) = known {
            return Ok(stream);
        }
        if self.storage.shared().is_some() && self.store.has_stream(asset, name).await? {
            return self.in_memory(asset, name);
        }
        Err(ServiceError::StreamUnknown { asset: asset.clone(), name: name.to_owned() })
    }

    /// Finds a stream in memory, or creates it there.
    fn in_memory(&self, asset: &AssetId, name: &str) -> Result<Arc<LiveStream>, ServiceError> {
        let mut all = self.all.lock().unwrap_or_else(PoisonError::into_inner);
        let key = (asset.clone(), name.to_owned());
        if let Some(stream) = all.get(&key).filter(|stream| !stream.is_removed()) {
            return Ok(Arc::clone(stream));
        }
        let location = self.storage.of(asset, name);
        if !location.has_room() {
            return Err(too_many(name));
        }
        // Those that were opened and never sent, or that are removed.
        all.retain(|(of, _), stream| {
            of != asset || Arc::strong_count(stream) > 1 || stream.location.exists()
        });
        let stream = Arc::new(LiveStream::new(asset.clone(), name.to_owned(), location));
        all.insert(key, Arc::clone(&stream));
        Ok(stream)
    }
}
