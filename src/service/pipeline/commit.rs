//! Commits of segments: those of concurrent connections are folded and committed together, so that they share
//! one wait for the disk.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use futures_util::future::try_join_all;
use tokio::sync::oneshot;

use crate::asset::{AssetId, Segment, SegmentId};
use crate::service::clock::Clock;
use crate::service::conflicts::retry_conflicts;
use crate::service::error::ServiceError;
use crate::service::events::EventSender;
use crate::service::history::{Appended, Committed, History};
use crate::service::raw::Retention;
use crate::service::sensor_group::among_others;
use crate::service::simulations::{KeyedEstimator, Simulations};
use crate::store::{Asset, NewSegment, SegmentKey, Store, Transaction};

/// Maximum number of segments committed together.
const MAX_TOGETHER: usize = 256;

/// Maximum number of retries of a transaction that conflicts with another process.
const MAX_RETRIES: u32 = 10;

/// Time after which a commit on a shared store counts as failed: a connection that is cut off gives no error.
const COMMIT_TIMEOUT: Duration = Duration::from_secs(60);

/// A segment after the commit.
#[derive(Debug)]
pub(crate) struct CommittedSegment {
    pub(crate) segment: Segment,
    /// Whether it was stored before.
    pub(crate) repeated: bool,
    /// Whether other assets shared the asset's sensor when it was stored; assets created later find it
    /// stored.
    pub(crate) shares_sensor: bool,
}

/// Segments of one asset to be committed, and the sender of the result.
pub(crate) struct Job {
    asset: AssetId,
    segments: Vec<NewSegment>,
    reply: oneshot::Sender<Result<Vec<CommittedSegment>, ServiceError>>,
}

/// Folds and commits segments, those of many connections together.
pub(crate) struct Committer {
    pub(crate) store: Store,
    pub(crate) simulations: Arc<Simulations>,
    pub(crate) history: Arc<History>,
    pub(crate) retention: Arc<Retention>,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) events: EventSender,
    pub(crate) queue: CommitQueue,
}

/// The queue of jobs to be committed.
#[derive(Default)]
pub(crate) struct CommitQueue {
    jobs: Mutex<Vec<Job>>,
    /// Held during a commit of segments, and during changes that must not run concurrently with one.
    committing: tokio::sync::Mutex<()>,
}

impl CommitQueue {
    fn push(&self, job: Job) {
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner).push(job);
    }

    /// Removes and returns the jobs to be committed together next.
    fn take(&self) -> Vec<Job> {
        let mut jobs = self.jobs.lock().unwrap_or_else(PoisonError::into_inner);
        let mut segments = 0;
        let together = jobs.iter().take_while(|job| {
            segments += job.segments.len();
            segments <= MAX_TOGETHER
        });
        let count = together.count().max(1).min(jobs.len());
        jobs.drain(..count).collect()
    }
}

impl Committer {
    /// Waits until no segments are being committed, and blocks commits until the guard is dropped.
    pub(crate) async fn pause(&self) -> tokio::sync::MutexGuard<'_, ()> {
        self.queue.committing.lock().await
    }

    /// Folds and stores segments of one asset, and sends their events. Returns them in the given order once
    /// everything is durable.
    pub(crate) async fn commit(
        &self,
        asset: &AssetId,
        segments: Vec<NewSegment>,
    ) -> Result<Vec<CommittedSegment>, ServiceError> {
        let (reply, mut receiver) = oneshot::channel();
        let queue = &self.queue;
        queue.push(Job { asset: asset.clone(), segments, reply });
        loop {
            {
                // The holder of the lock commits for all waiting callers, which then find their reply ready.
                let _guard = queue.committing.lock().await;
                if let Ok(reply) = receiver.try_recv() {
                    return reply;
                }
                let jobs = queue.take();
                if jobs.is_empty() {
                    return Err(ServiceError::WorkerLost("store a record"));
                }
                self.commit_jobs(jobs).await;
            }
            match receiver.try_recv() {
                Ok(reply) => return reply,
                // The job was not among the first ones.
                Err(oneshot::error::TryRecvError::Empty) => {}
                Err(oneshot::error::TryRecvError::Closed) => {
                    return Err(ServiceError::WorkerLost("store a record"));
                }
            }
        }
    }

    async fn commit_jobs(&self, jobs: Vec<Job>) {
        let (waiting, replies): (Vec<_>, Vec<_>) =
            jobs.into_iter().map(|job| ((job.asset, job.segments), job.reply)).unzip();
        let outcomes = match self.commit_with_retries(&waiting).await {
            Ok(stored) => stored.into_iter().map(Ok).collect(),
            Err(error) if waiting.len() == 1 => vec![Err(error)],
            Err(error) if is_unavailable(&error) => {
                tracing::warn!(%error, jobs = waiting.len(), "failed to commit records");
                waiting.iter().map(|_| Err(STORE_UNAVAILABLE)).collect()
            }
            Err(error) => {
                tracing::debug!(%error, jobs = waiting.len(), "failed to commit records together; committing each request separately");
                let mut outcomes = Vec::with_capacity(waiting.len());
                for job in &waiting {
                    // One timeout is enough.
                    if let Some(Err(error)) = outcomes.last()
                        && is_unavailable(error)
                    {
                        outcomes.push(Err(STORE_UNAVAILABLE));
                        continue;
                    }
                    let stored = self.commit_with_retries(std::slice::from_ref(job)).await;
                    outcomes.push(stored.map(|mut stored| stored.pop().unwrap_or_default()));
                }
                outcomes
            }
        };
        for (reply, outcome) in replies.into_iter().zip(outcomes) {
            // The caller may be gone; its segments stay stored.
            let _ = reply.send(outcome);
        }
    }

    /// Stores all jobs in one transaction, or none; retries on a conflict with another process.
    async fn commit_with_retries(
        &self,
        jobs: &[(AssetId, Vec<NewSegment>)],
    ) -> Result<Vec<Vec<CommittedSegment>>, ServiceError> {
        retry_conflicts("the commit", MAX_RETRIES, || self.commit_in_time(jobs)).await
    }

    /// Stores all jobs in one transaction, or none; fails if a shared store does not respond in time.
    async fn commit_in_time(
        &self,
        jobs: &[(AssetId, Vec<NewSegment>)],
    ) -> Result<Vec<Vec<CommittedSegment>>, ServiceError> {
        if !self.store.is_shared() {
            return self.commit_together(jobs).await;
        }
        let together = tokio::time::timeout(COMMIT_TIMEOUT, self.commit_together(jobs));
        together.await.unwrap_or(Err(STORE_UNAVAILABLE))
    }

    /// Stores all jobs in one transaction, or none.
    async fn commit_together(
        &self,
        jobs: &[(AssetId, Vec<NewSegment>)],
    ) -> Result<Vec<Vec<CommittedSegment>>, ServiceError> {
        let mut ids = Vec::new();
        let mut by_channel: BTreeMap<(&AssetId, &str), BTreeMap<SegmentKey, NewSegment>> = BTreeMap::new();
        for (asset, segments) in jobs {
            for segment in segments {
                ids.push(segment.id.clone());
                let channel = by_channel.entry((asset, &segment.channel)).or_default();
                channel.insert(segment.key(), segment.clone());
            }
        }
        let names: Vec<(&AssetId, &str)> = by_channel.keys().copied().collect();
        let mut caches = Vec::with_capacity(names.len());
        for (asset, channel) in &names {
            caches.push(self.history.lock(asset, channel).await);
        }
        let mut transaction = self.store.begin().await?;
        // Locked in the order of their names; no other process changes them from here on.
        let (assets, sharing) = self.assets_of(&mut transaction, &names).await?;
        let channels = transaction.channels(&names).await?;
        // Read under the locks: no one else stores them now.
        let repeats = self.store.segments_by_id(&ids).await?;
        let mut done: HashMap<SegmentId, (Segment, bool)> = HashMap::new();
        done.extend(repeats.into_iter().map(|segment| (segment.id.clone(), (segment, true))));
        let mut new_by_channel = Vec::with_capacity(names.len());
        let mut estimators: HashMap<&AssetId, KeyedEstimator> = HashMap::new();
        for (((asset, _), mut new), (channel, cache)) in
            by_channel.into_iter().zip(channels.into_iter().zip(caches))
        {
            new.retain(|key, _| !done.contains_key(&key.id));
            if new.is_empty() {
                continue;
            }
            if !estimators.contains_key(asset) {
                estimators.insert(asset, self.simulations.estimator(&assets[asset].spec));
            }
            new_by_channel.push((asset, channel, new, cache));
        }
        let history = &self.history;
        let append = new_by_channel.into_iter().map(|(asset, channel, new, cache)| {
            history.append(&assets[asset], &estimators[asset], channel, new, cache)
        });
        let appended = try_join_all(append).await?;
        for segment in self.write(transaction, appended).await? {
            self.events.send_segment(&segment);
            done.insert(segment.id.clone(), (segment, false));
        }
        // The same record twice in one batch is stored once and gets one response in each job.
        let of_job = |(asset, segments): &(AssetId, Vec<NewSegment>)| {
            let mut committed = Vec::with_capacity(segments.len());
            for segment in segments {
                if let Some((segment, repeated)) = done.get_mut(&segment.id) {
                    committed.push(CommittedSegment {
                        segment: segment.clone(),
                        repeated: std::mem::replace(repeated, true),
                        shares_sensor: sharing.contains(asset),
                    });
                }
            }
            committed
        };
        Ok(jobs.iter().map(of_job).collect())
    }

    /// Writes the folded segments in one transaction; returns them as stored.
    async fn write(
        &self,
        mut transaction: Transaction,
        mut appended: Vec<Appended<'_>>,
    ) -> Result<Vec<Segment>, ServiceError> {
        if appended.is_empty() {
            return Ok(Vec::new());
        }
        let mut rows = Vec::with_capacity(appended.len());
        for channel in &mut appended {
            rows.push(channel.rows()?);
        }
        transaction.add(&mut rows).await?;
        let now = self.clock.now();
        let mut notices = Vec::new();
        for channel in &mut appended {
            notices.extend(channel.set_alarms(&mut transaction, now).await?);
        }
        transaction.commit().await?;
        let mut stored = Vec::new();
        let mut outdated = Vec::new();
        for channel in appended {
            let Committed { segments, outdated: asset } = self.history.committed(channel);
            stored.extend(segments);
            outdated.extend(asset);
        }
        self.events.send_alarms(notices);
        self.history.recompute_in_background(outdated);
        self.retention.apply_in_background();
        Ok(stored)
    }

    /// Reads the assets of channels, locked until the end of the transaction, with the other meshes of their
    /// sensors. Also returns the assets that share a sensor.
    async fn assets_of(
        &self,
        transaction: &mut Transaction,
        names: &[(&AssetId, &str)],
    ) -> Result<(HashMap<AssetId, Asset>, BTreeSet<AssetId>), ServiceError> {
        let mut ids: Vec<&AssetId> = names.iter().map(|(asset, _)| *asset).collect();
        ids.dedup();
        let mut assets = transaction.assets(&ids).await?;
        let sharing = self.store.sharing_a_sensor(&ids).await?;
        for id in &sharing {
            if let Some(asset) = assets.remove(id) {
                assets.insert(id.clone(), among_others(&self.store, asset).await?);
            }
        }
        Ok((assets, sharing))
    }
}

/// The error if the store does not respond.
const STORE_UNAVAILABLE: ServiceError =
    ServiceError::Busy { what: "the store is unavailable", retry_after_s: 5 };

/// Whether a commit failed because the store does not respond: other records would fail too.
fn is_unavailable(error: &ServiceError) -> bool {
    match error {
        ServiceError::Store(error) => error.is_unavailable(),
        error => matches!(error, ServiceError::Busy { .. }),
    }
}
