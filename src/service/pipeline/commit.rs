//! Storing segments: what many connections bring at once is folded and committed together, so that all share
//! one wait for the disk.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use futures_util::future::try_join_all;
use tokio::sync::oneshot;

use crate::asset::{AssetId, Segment, SegmentId};
use crate::service::clock::Clock;
use crate::service::error::ServiceError;
use crate::service::events::Announcer;
use crate::service::history::{Appended, Committed, History};
use crate::service::raw::Retention;
use crate::service::sensor_group::among_others;
use crate::service::simulations::{KeyedEstimator, Simulations};
use crate::store::{Asset, Commit, NewSegment, SegmentKey, Store};

/// Segments committed together.
const MAX_TOGETHER: usize = 256;

/// How often a transaction that another process stood in the way of is prepared again.
const PREPARED_AGAIN: u32 = 10;

/// How long storing may take on a store that other processes use, before it counts as away: a connection that
/// was cut says nothing.
const PATIENCE: Duration = Duration::from_secs(60);

/// A segment as it is after storing.
#[derive(Debug)]
pub(crate) struct CommittedSegment {
    pub(crate) segment: Segment,
    /// It was there before.
    pub(crate) repeated: bool,
    /// Other assets shared the asset's sensor when it was stored; those described later find it stored.
    pub(crate) shares_sensor: bool,
}

/// Segments of one asset that are to be stored, and who waits for it.
pub(crate) struct Job {
    asset: AssetId,
    segments: Vec<NewSegment>,
    answer: oneshot::Sender<Result<Vec<CommittedSegment>, ServiceError>>,
}

/// Folds and commits segments, those of many connections together.
pub(crate) struct Committer {
    pub(crate) store: Store,
    pub(crate) simulations: Arc<Simulations>,
    pub(crate) history: Arc<History>,
    pub(crate) retention: Arc<Retention>,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) events: Announcer,
    pub(crate) waiting: Waiting,
}

/// What waits to be stored.
#[derive(Default)]
pub(crate) struct Waiting {
    jobs: Mutex<Vec<Job>>,
    /// Held while segments are committed, and while something between them is stored.
    turn: tokio::sync::Mutex<()>,
}

impl Waiting {
    fn push(&self, job: Job) {
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner).push(job);
    }

    /// The jobs that are to be committed together next.
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
    /// Waits until no segments are being committed, and keeps them from it.
    pub(crate) async fn pause(&self) -> tokio::sync::MutexGuard<'_, ()> {
        self.waiting.turn.lock().await
    }

    /// Folds and stores segments of one asset, and announces them. The answer, in the order given, comes once
    /// everything is on the disk.
    pub(crate) async fn commit(
        &self,
        asset: &AssetId,
        segments: Vec<NewSegment>,
    ) -> Result<Vec<CommittedSegment>, ServiceError> {
        let (answer, mut answered) = oneshot::channel();
        let queue = &self.waiting;
        queue.push(Job { asset: asset.clone(), segments, answer });
        loop {
            {
                // Whoever has the turn works for all who wait; those behind find it done.
                let _turn = queue.turn.lock().await;
                if let Ok(answer) = answered.try_recv() {
                    return answer;
                }
                let jobs = queue.take();
                if jobs.is_empty() {
                    return Err(ServiceError::WorkerLost("store a record"));
                }
                self.commit_jobs(jobs).await;
            }
            match answered.try_recv() {
                Ok(answer) => return answer,
                // It was not among the first ones.
                Err(oneshot::error::TryRecvError::Empty) => {}
                Err(oneshot::error::TryRecvError::Closed) => {
                    return Err(ServiceError::WorkerLost("store a record"));
                }
            }
        }
    }

    async fn commit_jobs(&self, jobs: Vec<Job>) {
        let (waiting, answers): (Vec<_>, Vec<_>) =
            jobs.into_iter().map(|job| ((job.asset, job.segments), job.answer)).unzip();
        let outcomes = match self.commit_patiently(&waiting).await {
            Ok(stored) => stored.into_iter().map(Ok).collect(),
            Err(error) if waiting.len() == 1 => vec![Err(error)],
            Err(ServiceError::Store(error)) if error.is_unavailable() => {
                tracing::warn!(%error, jobs = waiting.len(), "failed to store records");
                waiting.iter().map(|_| Err(STORE_AWAY)).collect()
            }
            Err(error) => {
                tracing::debug!(%error, jobs = waiting.len(), "failed to store records together: storing each request by itself");
                let mut outcomes = Vec::with_capacity(waiting.len());
                for job in &waiting {
                    let stored = self.commit_patiently(std::slice::from_ref(job)).await;
                    outcomes.push(stored.map(|mut stored| stored.pop().unwrap_or_default()));
                }
                outcomes
            }
        };
        for (answer, outcome) in answers.into_iter().zip(outcomes) {
            // The asker may have gone; what is stored is stored.
            let _ = answer.send(outcome);
        }
    }

    /// Stores all of this in one transaction, or nothing; again where another process was in the way.
    async fn commit_patiently(
        &self,
        jobs: &[(AssetId, Vec<NewSegment>)],
    ) -> Result<Vec<Vec<CommittedSegment>>, ServiceError> {
        let mut tries = 0;
        loop {
            let outcome = if self.store.is_shared() {
                let together = tokio::time::timeout(PATIENCE, self.commit_together(jobs));
                together.await.unwrap_or(Err(STORE_AWAY))
            } else {
                self.commit_together(jobs).await
            };
            match outcome {
                Err(ServiceError::Store(error)) if error.is_conflict() && tries < PREPARED_AGAIN => {
                    tries += 1;
                    tracing::debug!(%error, tries, "conflict with another process: committing again");
                    tokio::time::sleep(Duration::from_millis(u64::from(5 * tries))).await;
                }
                outcome => return outcome,
            }
        }
    }

    /// Stores all of this in one transaction, or nothing.
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
        let mut slots = Vec::with_capacity(names.len());
        for (asset, channel) in &names {
            slots.push(self.history.lock(asset, channel).await);
        }
        let mut commit = self.store.begin().await?;
        // Locked in the order of their names; from here on no other process changes them.
        let (assets, sharing) = self.assets_of(&mut commit, &names).await?;
        let channels = commit.channels(&names).await?;
        // Asked under the locks: nobody else stores them now.
        let repeats = self.store.segments_by_id(&ids).await?;
        let mut done: HashMap<SegmentId, (Segment, bool)> = HashMap::new();
        done.extend(repeats.into_iter().map(|segment| (segment.id.clone(), (segment, true))));
        let mut fresh = Vec::with_capacity(names.len());
        let mut estimators: HashMap<&AssetId, KeyedEstimator> = HashMap::new();
        for (((asset, _), mut new), (channel, slot)) in
            by_channel.into_iter().zip(channels.into_iter().zip(slots))
        {
            new.retain(|key, _| !done.contains_key(&key.id));
            if new.is_empty() {
                continue;
            }
            if !estimators.contains_key(asset) {
                estimators.insert(asset, self.simulations.estimator(&assets[asset].spec));
            }
            fresh.push((asset, channel, new, slot));
        }
        let history = &self.history;
        let append = fresh.into_iter().map(|(asset, channel, new, slot)| {
            history.append(&assets[asset], &estimators[asset], channel, new, slot)
        });
        let appended = try_join_all(append).await?;
        for segment in self.write(commit, appended).await? {
            self.events.announce_segment(&segment);
            done.insert(segment.id.clone(), (segment, false));
        }
        // The same record twice in one batch is stored once and answered once in each job.
        let answer = |(asset, segments): &(AssetId, Vec<NewSegment>)| {
            let mut answered = Vec::with_capacity(segments.len());
            for segment in segments {
                if let Some((segment, repeated)) = done.get_mut(&segment.id) {
                    answered.push(CommittedSegment {
                        segment: segment.clone(),
                        repeated: std::mem::replace(repeated, true),
                        shares_sensor: sharing.contains(asset),
                    });
                }
            }
            answered
        };
        Ok(jobs.iter().map(answer).collect())
    }

    /// Writes what was folded in one transaction; returns the segments as they are stored.
    async fn write(
        &self,
        mut commit: Commit,
        mut appended: Vec<Appended<'_>>,
    ) -> Result<Vec<Segment>, ServiceError> {
        if appended.is_empty() {
            return Ok(Vec::new());
        }
        let mut rows = Vec::with_capacity(appended.len());
        for channel in &mut appended {
            rows.push(channel.rows()?);
        }
        commit.add(&mut rows).await?;
        let now = self.clock.now();
        let mut notices = Vec::new();
        for channel in &mut appended {
            notices.extend(channel.set_alarms(&mut commit, now).await?);
        }
        commit.finish().await?;
        let mut stored = Vec::new();
        let mut outdated = Vec::new();
        for channel in appended {
            let Committed { segments, outdated: asset } = channel.committed(&self.simulations);
            stored.extend(segments);
            outdated.extend(asset);
        }
        self.events.announce_alarms(notices);
        self.history.recompute_in_background(outdated);
        self.retention.apply_in_background();
        Ok(stored)
    }

    /// The assets of channels as they stay until the transaction's end, the other meshes of their sensors
    /// known to them; and which have any.
    async fn assets_of(
        &self,
        commit: &mut Commit,
        names: &[(&AssetId, &str)],
    ) -> Result<(HashMap<AssetId, Asset>, BTreeSet<AssetId>), ServiceError> {
        let mut ids: Vec<&AssetId> = names.iter().map(|(asset, _)| *asset).collect();
        ids.dedup();
        let mut assets = commit.assets(&ids).await?;
        let sharing = self.store.sharing_a_sensor(&ids).await?;
        for id in &sharing {
            if let Some(asset) = assets.remove(id) {
                assets.insert(id.clone(), among_others(&self.store, asset).await?);
            }
        }
        Ok((assets, sharing))
    }
}

/// What is answered where the store does not answer.
const STORE_AWAY: ServiceError = ServiceError::Busy { what: "the store is away", retry_after_s: 5 };
