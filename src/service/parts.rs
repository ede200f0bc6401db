//! The service, which connects its parts.

use std::sync::Arc;
use std::time::Duration;

use super::alarms::Alarms;
use super::assets::Assets;
use super::backfill::Backfill;
use super::client_limiter::ClientLimiter;
use super::clock::Clock;
use super::error::ServiceError;
use super::events::EventSender;
use super::exclusion::Exclusions;
use super::feeds::Feeds;
use super::history::History;
use super::limits::{OldResults, ServiceFolders, WorkLimits};
use super::maintenance::Maintenance;
use super::pipeline::{CommitQueue, Committer, Pipeline};
use super::raw::{RawObjects, Retention, UploadPieces};
use super::record::StoredRecords;
use super::record_counts::RecordCounts;
use super::removal::Removals;
use super::replays::{Replays, prepare_folders};
use super::simulations::{LibrarySource, Simulations};
use super::streams::Streams;
use super::thinner::Thinner;
use super::upkeep::Upkeep;
use super::work_queue::Role;
use super::workers::Workers;
use crate::asset::AssetId;
use crate::library::{GridSettings, LibraryCache};
use crate::store::Store;

/// Minutes between two searches for unreferenced raw objects.
const SWEEP_INTERVAL_MINUTES: u32 = 24 * 60;

/// Time between two searches for long histories that are not stored as columns yet.
const TREND_BLOCKS_INTERVAL: Duration = Duration::from_secs(10);

/// All parts of the service, on one store.
pub struct Service {
    /// The store; other modules only read it.
    pub store: Store,
    /// The worker threads.
    pub workers: Arc<Workers>,
    /// The libraries of the assets.
    pub simulations: Arc<Simulations>,
    /// Processes records.
    pub pipeline: Arc<Pipeline>,
    /// The histories of all channels.
    pub history: Arc<History>,
    /// Reads stored records.
    pub records: StoredRecords,
    /// Changes assets.
    pub assets: Assets,
    /// Changes alarms.
    pub alarms: Arc<Alarms>,
    /// Changes maintenance events.
    pub maintenance: Maintenance,
    /// Removes records.
    pub removals: Removals,
    /// Excludes records from their histories, and includes them again.
    pub exclusions: Exclusions,
    /// Replays of recordings.
    pub replays: Replays,
    /// Live streams.
    pub streams: Arc<Streams>,
    /// Limits the streams that are sent at the same time, by requests and over MQTT.
    pub(crate) stream_limiter: ClientLimiter,
    /// Downloads of raw recordings.
    pub(crate) download_limiter: ClientLimiter,
    /// Pieces of resumable uploads.
    pub uploads: Arc<UploadPieces>,
    /// Sources of records other than HTTP.
    pub feeds: Feeds,
    /// Counts of records since the start.
    pub record_counts: Arc<RecordCounts>,
    /// Live events.
    pub events: EventSender,
    /// The role of this process.
    pub role: Role,
    clock: Arc<dyn Clock>,
    pub(super) raw: Arc<RawObjects>,
    retention: Arc<Retention>,
    backfill: Arc<Backfill>,
    upkeep_interval: Duration,
    old_results: Option<OldResults>,
}

impl Service {
    /// Connects the parts on a store; `grid` sets how libraries are simulated. Must be called inside a Tokio
    /// runtime.
    ///
    /// # Errors
    /// A folder cannot be created, or the worker threads cannot be started.
    pub fn new(
        store: Store,
        folders: ServiceFolders,
        limits: &WorkLimits,
        grid: GridSettings,
        clock: Arc<dyn Clock>,
        role: Role,
    ) -> Result<Arc<Self>, ServiceError> {
        prepare_folders(&folders)?;
        let events = EventSender::default();
        let record_counts = Arc::<RecordCounts>::default();
        let workers = Arc::new(Workers::new(limits)?);
        let cache = Arc::new(LibraryCache::new(folders.libraries));
        let source = LibrarySource::new(cache, &store, &clock, !role.is_api_node());
        let (changed, simulated) = tokio::sync::mpsc::unbounded_channel();
        let simulations = Arc::new(Simulations::new(source, grid, limits, changed)?);
        let history = Arc::new(History::new(
            store.clone(),
            Arc::clone(&workers),
            Arc::clone(&simulations),
            Arc::clone(&clock),
            events.clone(),
            role.clone(),
        ));
        if !role.is_api_node() {
            history.recompute_when_simulated(simulated);
        }
        let raw = Arc::new(RawObjects::new(
            store.clone(),
            Arc::clone(&workers),
            role.clone(),
            limits.quarantined_for,
        ));
        let retention = Arc::new(Retention::new(store.clone(), Arc::clone(&raw), limits.quotas));
        let committer = Arc::new(Committer {
            store: store.clone(),
            simulations: Arc::clone(&simulations),
            history: Arc::clone(&history),
            retention: Arc::clone(&retention),
            clock: Arc::clone(&clock),
            events: events.clone(),
            queue: CommitQueue::default(),
        });
        let pipeline = Arc::new(Pipeline {
            store: store.clone(),
            workers: Arc::clone(&workers),
            simulations: Arc::clone(&simulations),
            raw: Arc::clone(&raw),
            committer: Arc::clone(&committer),
            clock: Arc::clone(&clock),
            role: role.clone(),
            record_counts: Arc::clone(&record_counts),
            start_time_ahead: limits.start_time_ahead,
        });
        let backfill = Arc::new(Backfill {
            store: store.clone(),
            workers: Arc::clone(&workers),
            pipeline: Arc::clone(&pipeline),
            raw: Arc::clone(&raw),
            clock: Arc::clone(&clock),
            role: role.clone(),
            running: tokio::sync::Mutex::default(),
        });
        let streams = Streams::new(
            store.clone(),
            Arc::clone(&workers),
            Arc::clone(&pipeline),
            Arc::clone(&clock),
            // The workers' alarms arrive at an API node with the events of all processes.
            if role.is_api_node() { EventSender::default() } else { events.clone() },
            folders.streams,
        );
        Ok(Arc::new(Self {
            records: StoredRecords::new(store.clone(), Arc::clone(&workers)),
            assets: Assets {
                store: store.clone(),
                simulations: Arc::clone(&simulations),
                history: Arc::clone(&history),
                backfill: Arc::clone(&backfill),
                raw: Arc::clone(&raw),
                streams: Arc::clone(&streams),
                clock: Arc::clone(&clock),
                events: events.clone(),
                role: role.clone(),
                describing: tokio::sync::Mutex::default(),
            },
            alarms: Arc::new(Alarms {
                store: store.clone(),
                history: Arc::clone(&history),
                committer: Arc::clone(&committer),
                clock: Arc::clone(&clock),
                events: events.clone(),
            }),
            maintenance: Maintenance {
                store: store.clone(),
                history: Arc::clone(&history),
                committer: Arc::clone(&committer),
                raw: Arc::clone(&raw),
                events: events.clone(),
            },
            exclusions: Exclusions {
                store: store.clone(),
                committer: Arc::clone(&committer),
                raw: Arc::clone(&raw),
                history: Arc::clone(&history),
                events: events.clone(),
            },
            removals: Removals {
                store: store.clone(),
                committer,
                raw: Arc::clone(&raw),
                history: Arc::clone(&history),
                clock: Arc::clone(&clock),
                events: events.clone(),
            },
            replays: Replays::new(
                store.clone(),
                Arc::clone(&workers),
                Arc::clone(&pipeline),
                Arc::clone(&clock),
                events.clone(),
                role.clone(),
                folders.recordings,
            ),
            streams,
            stream_limiter: ClientLimiter::new(
                limits.streams_at_once,
                limits.streams_at_once.saturating_mul(3) / 4,
            ),
            download_limiter: ClientLimiter::new(
                limits.requests_at_once,
                limits.requests_at_once.saturating_mul(3) / 4,
            ),
            uploads: Arc::new(UploadPieces::new(store.clone(), Arc::clone(&workers), Arc::clone(&clock))),
            feeds: Feeds::default(),
            upkeep_interval: limits.upkeep_interval,
            old_results: limits.old_results,
            store,
            workers,
            simulations,
            pipeline,
            history,
            record_counts,
            events,
            role,
            clock,
            raw,
            retention,
            backfill,
        }))
    }

    /// The current time, by the clock with which the service was started.
    pub fn now(&self) -> jiff::Timestamp {
        self.clock.now()
    }

    /// Resumes the work of the previous process in the background: starts to simulate the library of every
    /// asset, recomputes what was computed under other settings, and moves raw objects that no record refers
    /// to into quarantine. On a shared store it also finishes what other processes left undone.
    ///
    /// On an API node the workers do this, except for the live streams, which need the nodes. Nothing is done
    /// on a damaged database.
    pub async fn resume(&self) -> Result<(), ServiceError> {
        if self.store.damage().is_some() {
            return Ok(());
        }
        if self.role.is_api_node() {
            return self.streams.resume().await;
        }
        let mut after: Option<String> = None;
        let (mut all, mut members) = (Vec::new(), Vec::new());
        loop {
            let assets = self.store.assets(after.as_deref(), 500).await?;
            let Some(last) = assets.last() else { break };
            after = Some(last.spec.id.to_string());
            for asset in assets {
                self.simulations.start(&asset.spec);
                if asset.spec.sensor.of.is_some() {
                    members.push(asset.spec.id.clone());
                }
                all.push(asset.spec.id);
            }
        }
        self.write_metadata_in_background(all.clone());
        self.history.recompute_in_background(all);
        self.backfill.in_background(members);
        self.alarms.end_shelvings_in_background();
        self.alarms.watch_silence_in_background();
        self.alarms.watch_joint_novelty_in_background();
        self.store_trend_blocks_in_background();
        self.thin_results_in_background();
        if self.store.is_shared() {
            let upkeep = Upkeep {
                store: self.store.clone(),
                history: Arc::clone(&self.history),
                backfill: Arc::clone(&self.backfill),
                raw: Arc::clone(&self.raw),
                uploads: Arc::clone(&self.uploads),
                clock: Arc::clone(&self.clock),
                interval: self.upkeep_interval,
            };
            upkeep.in_background();
            if matches!(self.role, Role::Standalone) {
                self.streams.resume().await?;
            }
            return Ok(());
        }
        self.replays.resume().await?;
        self.streams.resume().await?;
        self.sweep_in_background();
        Ok(())
    }

    /// Moves unreferenced raw objects into quarantine, and removes objects whose quarantine has expired.
    pub async fn sweep(&self) -> Result<(), ServiceError> {
        self.raw.sweep().await
    }

    /// Writes the metadata of assets that the previous process did not write beside the raw objects.
    fn write_metadata_in_background(&self, assets: Vec<AssetId>) {
        let raw = Arc::clone(&self.raw);
        tokio::spawn(async move {
            for asset in assets {
                raw.update_asset_metadata(&asset).await;
            }
        });
    }

    /// Stores long histories as columns too.
    fn store_trend_blocks_in_background(&self) {
        let store = self.store.clone();
        tokio::spawn(async move {
            loop {
                tokio::time::sleep(TREND_BLOCKS_INTERVAL).await;
                if store.is_closed() {
                    return;
                }
                if let Err(error) = store.store_trend_blocks().await {
                    tracing::warn!(%error, "failed to store histories as columns; reading them row by row");
                }
            }
        });
    }

    /// Thins the results of old records, where that is wanted.
    fn thin_results_in_background(&self) {
        let Some(old_results) = self.old_results else { return };
        let thinner = Thinner { store: self.store.clone(), clock: Arc::clone(&self.clock), old_results };
        thinner.in_background();
    }

    /// Maintains the raw objects of a process that is alone on its store: searches for unreferenced ones now
    /// and once a day, and raises the generation of the store.
    fn sweep_in_background(&self) {
        let (raw, retention, store) =
            (Arc::clone(&self.raw), Arc::clone(&self.retention), self.store.clone());
        tokio::spawn(async move {
            while !store.is_closed() {
                if let Err(error) = raw.sweep().await {
                    tracing::warn!(%error, "failed to search for raw objects that no record refers to");
                }
                retention.apply_in_background();
                for _ in 0..SWEEP_INTERVAL_MINUTES {
                    tokio::time::sleep(Duration::from_secs(60)).await;
                    if store.is_closed() {
                        return;
                    }
                    if let Err(error) = store.raise_generation_if_changed().await {
                        tracing::warn!(%error, "failed to raise the generation of the store");
                    }
                }
            }
        });
    }
}
