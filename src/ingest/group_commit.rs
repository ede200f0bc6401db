//! Storing segments: what many connections bring at once is folded and committed together, so that all share one wait for the disk.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::{OwnedMutexGuard, oneshot};

use super::channels::{Basis, Slot};
use super::fold::{FoldInput, FoldPoint, Folded, RecentPoints, while_recomputing};
use super::keys::analysis_keys;
use super::libraries::KeyedTracker;
use super::{Announcement, Ingest, IngestError};
use crate::asset::{AssetId, Segment, SegmentId};
use crate::estimate::METHOD;
use crate::store::{Asset, ChannelKeys, ChannelSummary, Commit, FoldState, NewSegment, RunResult, SEGMENTS_PER_STATE, SegmentKey};

/// Segments committed together.
const MOST_TOGETHER: usize = 256;

/// Stored records after a late one that are folded again at once. Where there are more, the late record gets its estimate, and those
/// after it are folded in the background.
const FOLDED_AT_ONCE: u64 = 512;

/// How often a transaction that another process stood in the way of is prepared again.
const PREPARED_AGAIN: u32 = 10;

/// How long storing may take on a store that other processes use, before it counts as away: a connection that was cut says nothing.
const PATIENCE: Duration = Duration::from_secs(60);

/// A segment as it is after storing.
#[derive(Debug)]
pub(super) struct Stored {
    pub(super) segment: Segment,
    /// It was there before.
    pub(super) repeated: bool,
}

/// Segments of one asset that are to be stored, and who waits for it.
struct Job {
    asset: AssetId,
    segments: Vec<NewSegment>,
    answer: oneshot::Sender<Result<Vec<Stored>, IngestError>>,
}

/// What waits to be stored.
#[derive(Default)]
pub(super) struct CommitQueue {
    waiting: Mutex<Vec<Job>>,
    /// Held while segments are committed, and while something between them is stored.
    pub(super) turn: tokio::sync::Mutex<()>,
}

impl CommitQueue {
    fn push(&self, job: Job) {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner).push(job);
    }

    /// The jobs that are to be committed together next.
    fn take(&self) -> Vec<Job> {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let mut segments = 0;
        let together = waiting.iter().take_while(|job| {
            segments += job.segments.len();
            segments <= MOST_TOGETHER
        });
        let count = together.count().max(1).min(waiting.len());
        waiting.drain(..count).collect()
    }
}

/// A channel's new segments with what they become.
struct Prepared {
    /// As it is in the transaction.
    channel: ChannelSummary,
    new: BTreeMap<SegmentKey, NewSegment>,
    slot: OwnedMutexGuard<Slot>,
    /// Under which keys the channel's history stands.
    keys: ChannelKeys,
    fold: Fold,
}

/// What new segments do to a channel's history.
enum Fold {
    /// The estimates after position `after` are these.
    From { after: u64, folded: Folded, tracker: KeyedTracker },
    /// They have these results for now, and the history after them is to be folded again in the background.
    Later { results: Vec<(SegmentKey, RunResult)> },
}

impl Ingest {
    /// Folds and stores segments of one asset, and announces them. The answer, in the order given, comes once everything is on the
    /// disk.
    pub(super) async fn store_segments(&self, asset: &AssetId, segments: Vec<NewSegment>) -> Result<Vec<Stored>, IngestError> {
        let (answer, mut answered) = oneshot::channel();
        let queue = &self.inner.commits;
        queue.push(Job {
            asset: asset.clone(),
            segments,
            answer,
        });
        loop {
            {
                // Whoever has the turn works for all who wait; those behind find it done.
                let _turn = queue.turn.lock().await;
                if let Ok(answer) = answered.try_recv() {
                    return answer;
                }
                let jobs = queue.take();
                if jobs.is_empty() {
                    return Err(IngestError::WorkerLost("store a record"));
                }
                self.commit_jobs(jobs).await;
            }
            match answered.try_recv() {
                Ok(answer) => return answer,
                // It was not among the first ones.
                Err(oneshot::error::TryRecvError::Empty) => {}
                Err(oneshot::error::TryRecvError::Closed) => return Err(IngestError::WorkerLost("store a record")),
            }
        }
    }

    async fn commit_jobs(&self, jobs: Vec<Job>) {
        let (waiting, answers): (Vec<_>, Vec<_>) = jobs.into_iter().map(|job| ((job.asset, job.segments), job.answer)).unzip();
        let outcomes = match self.commit_patiently(&waiting).await {
            Ok(stored) => stored.into_iter().map(Ok).collect(),
            Err(error) if waiting.len() == 1 => vec![Err(error)],
            Err(IngestError::Store(error)) if error.is_unavailable() => {
                tracing::warn!(%error, jobs = waiting.len(), "not stored");
                waiting.iter().map(|_| Err(STORE_AWAY)).collect()
            }
            Err(error) => {
                tracing::debug!(%error, jobs = waiting.len(), "not stored together, each one by itself now");
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
    async fn commit_patiently(&self, jobs: &[(AssetId, Vec<NewSegment>)]) -> Result<Vec<Vec<Stored>>, IngestError> {
        let mut tries = 0;
        loop {
            let outcome = if self.inner.store.is_shared() {
                let together = tokio::time::timeout(PATIENCE, self.commit_together(jobs));
                together.await.unwrap_or(Err(STORE_AWAY))
            } else {
                self.commit_together(jobs).await
            };
            match outcome {
                Err(IngestError::Store(error)) if error.is_conflict() && tries < PREPARED_AGAIN => {
                    tries += 1;
                    tracing::debug!(%error, tries, "another process was in the way");
                    tokio::time::sleep(Duration::from_millis(u64::from(5 * tries))).await;
                }
                outcome => return outcome,
            }
        }
    }

    /// Stores all of this in one transaction, or nothing.
    async fn commit_together(&self, jobs: &[(AssetId, Vec<NewSegment>)]) -> Result<Vec<Vec<Stored>>, IngestError> {
        let ids: Vec<SegmentId> = jobs
            .iter()
            .flat_map(|(_, segments)| segments.iter().map(|segment| segment.id.clone()))
            .collect();
        let mut by_asset: BTreeMap<&AssetId, BTreeMap<&str, BTreeMap<SegmentKey, NewSegment>>> = BTreeMap::new();
        for (asset, segments) in jobs {
            let channels = by_asset.entry(asset).or_default();
            for segment in segments {
                let channel = channels.entry(&segment.channel).or_default();
                channel.insert(segment.key(), segment.clone());
            }
        }
        let mut slots = Vec::new();
        for (asset, channels) in by_asset {
            for (name, new) in channels {
                let slot = self.inner.channels.lock(asset, name).await;
                slots.push((asset, name, new, slot));
            }
        }
        // Locked in the order of their names; from here on no other process changes them.
        let mut commit = self.inner.store.begin().await?;
        let mut assets: HashMap<&AssetId, Asset> = HashMap::new();
        for (asset, ..) in &slots {
            if !assets.contains_key(*asset) {
                let described = commit.asset(asset).await?;
                assets.insert(*asset, self.among_others(described).await?);
            }
        }
        let mut locked = Vec::with_capacity(slots.len());
        for (asset, name, new, slot) in slots {
            locked.push((asset, commit.channel(asset, name).await?, new, slot));
        }
        // Asked under the locks: nobody else stores them now.
        let repeats = self.inner.store.segments_by_id(&ids).await?;
        let repeats: HashMap<SegmentId, Segment> = repeats.into_iter().map(|segment| (segment.id.clone(), segment)).collect();
        let mut prepared = Vec::with_capacity(locked.len());
        let mut trackers: HashMap<&AssetId, KeyedTracker> = HashMap::new();
        for (asset, channel, mut new, slot) in locked {
            new.retain(|key, _| !repeats.contains_key(&key.id));
            if new.is_empty() {
                continue;
            }
            let described = &assets[asset];
            if !trackers.contains_key(asset) {
                trackers.insert(asset, self.inner.libraries.tracker_now(&described.spec)?);
            }
            let wanted = analysis_keys(&described.spec);
            if new.values().any(|segment| segment.analysed.keys != wanted) {
                return Err(IngestError::DescriptionChanged(asset.clone()));
            }
            prepared.push((described, self.prepare(described, &trackers[asset], channel, new, slot).await?));
        }
        let mut done: HashMap<SegmentId, (Segment, bool)> = repeats.into_iter().map(|(id, segment)| (id, (segment, true))).collect();
        for segment in self.commit_prepared(commit, prepared).await? {
            self.announce(Announcement::SegmentStored(Arc::new(segment.clone())));
            done.insert(segment.id.clone(), (segment, false));
        }
        // The same record twice in one batch is stored once and answered once in each job.
        let answer = |(_, segments): &(AssetId, Vec<NewSegment>)| {
            let mut answered = Vec::with_capacity(segments.len());
            for segment in segments {
                if let Some((segment, repeated)) = done.get_mut(&segment.id) {
                    answered.push(Stored {
                        segment: segment.clone(),
                        repeated: std::mem::replace(repeated, true),
                    });
                }
            }
            answered
        };
        Ok(jobs.iter().map(answer).collect())
    }

    /// Folds the new segments of a channel as far as that is done at once.
    async fn prepare(
        &self,
        asset: &Asset,
        current: &KeyedTracker,
        channel: ChannelSummary,
        new: BTreeMap<SegmentKey, NewSegment>,
        mut slot: OwnedMutexGuard<Slot>,
    ) -> Result<Prepared, IngestError> {
        if channel.segments == 0 {
            // The first records of a channel stand under what is asked for now.
            let keys = ChannelKeys {
                analysed: analysis_keys(&asset.spec),
                fold: current.fold_key.clone(),
            };
            let occurrences = self.occurrences(asset, None, &mut slot).await?;
            let folded = self.fold_on(current, None, inputs_of(&new), &occurrences).await?;
            let tracker = current.clone();
            return Ok(Prepared {
                channel,
                new,
                slot,
                keys,
                fold: Fold::From { after: 0, folded, tracker },
            });
        }
        let keys = channel.keys.clone();
        let fits = new.values().all(|segment| segment.analysed.keys.feature == keys.analysed.feature);
        // Records go on under the tracker of the history that is served, until another one is.
        let tracker = self.inner.libraries.kept(&keys.fold).filter(|_| fits);
        let fold = match tracker {
            Some(tracker) => self.fold_in(&tracker, asset, &channel, &new, &mut slot).await?,
            None => {
                let need = asset.spec.baseline.records;
                let result = || while_recomputing(need, METHOD.to_owned());
                Fold::Later {
                    results: new.keys().map(|key| (key.clone(), result())).collect(),
                }
            }
        };
        Ok(Prepared {
            channel,
            new,
            slot,
            keys,
            fold,
        })
    }

    async fn fold_in(
        &self,
        tracker: &KeyedTracker,
        asset: &Asset,
        channel: &ChannelSummary,
        new: &BTreeMap<SegmentKey, NewSegment>,
        slot: &mut Slot,
    ) -> Result<Fold, IngestError> {
        let occurrences = self.occurrences(asset, Some(channel), slot).await?;
        if slot.points.is_none() {
            slot.points = Some(RecentPoints::new(self.newest_point(channel).await?));
        }
        let points = slot.points.get_or_insert_default();
        let (Some(first), Some(last)) = (new.keys().next(), new.keys().next_back()) else {
            return Ok(Fold::Later { results: Vec::new() });
        };
        let newest = points.newest().cloned();
        let from = match points.before(first) {
            Some(point) => Some(point.clone()),
            None => self.point_before(channel, first).await?,
        };
        let after = from.as_ref().map_or(0, |point| point.position);
        let stored_after = newest
            .as_ref()
            .map_or(channel.segments, |newest| newest.position.saturating_sub(after));
        let mut inputs = inputs_of(new);
        let is_latest = newest.as_ref().is_some_and(|newest| newest.last < *first);
        if is_latest {
            let folded = self.fold_on(tracker, from, inputs, &occurrences).await?;
            let tracker = tracker.clone();
            return Ok(Fold::From { after, folded, tracker });
        }
        let fold_all = stored_after <= FOLDED_AT_ONCE && newest.is_some();
        // All that is stored after the state, or only what lies before the last of the new ones.
        let mut cursor = from.as_ref().map(|point| point.last.clone());
        loop {
            let stored = self.inner.store.features(channel, cursor.as_ref(), 1024).await?;
            let is_end = stored.len() < 1024;
            cursor = stored.last().map(|stored| stored.key.clone());
            let beyond = stored.last().is_some_and(|stored| stored.key > *last);
            let wanted = stored.into_iter().filter(|stored| fold_all || stored.key < *last);
            inputs.extend(wanted.map(|stored| FoldInput::of(stored, &tracker.feature_key)));
            if is_end || (beyond && !fold_all) {
                break;
            }
        }
        inputs.sort_by(|a, b| a.key.cmp(&b.key));
        let mut folded = self.fold_on(tracker, from, inputs, &occurrences).await?;
        if fold_all {
            // Those before the first new one are what they were.
            folded.results.retain(|(key, _)| key >= first);
            let tracker = tracker.clone();
            return Ok(Fold::From { after, folded, tracker });
        }
        folded.results.retain(|(key, _)| new.contains_key(key));
        Ok(Fold::Later { results: folded.results })
    }

    async fn commit_prepared(&self, mut commit: Commit, prepared: Vec<(&Asset, Prepared)>) -> Result<Vec<Segment>, IngestError> {
        if prepared.is_empty() {
            return Ok(Vec::new());
        }
        let mut answer = Vec::new();
        let mut changed = Vec::with_capacity(prepared.len());
        let mut recompute = Vec::new();
        let mut notices = Vec::new();
        let now = self.inner.clock.now();
        for (asset, mut prepared) in prepared {
            let mut channel = prepared.channel;
            channel.keys = prepared.keys;
            for segment in prepared.new.values() {
                commit.insert(&mut channel, segment).await?;
            }
            let (results, points) = match prepared.fold {
                Fold::From { after, folded, tracker } => {
                    commit.set_wears(&channel, &folded.results).await?;
                    commit.set_states(&channel, after, &states_of(&folded.points)?).await?;
                    let is_append = folded.results.len() == prepared.new.len();
                    commit.set_channel(&mut channel, !is_append).await?;
                    let has_alarms = prepared.slot.occurrences.as_ref().is_none_or(|known| known.has_alarms);
                    // Where records were only added and nothing came of it, what is stored stands.
                    if !folded.alarms.is_quiet() || (has_alarms && !is_append) {
                        notices.extend(commit.set_alarms(&channel, folded.alarms.folded(&tracker, is_append), now).await?);
                        if !has_alarms {
                            prepared.slot.occurrences = None;
                        }
                    }
                    (folded.results, Some((after, folded.points)))
                }
                Fold::Later { results } => {
                    channel.must_fold = true;
                    commit.set_wears(&channel, &results).await?;
                    commit.set_channel(&mut channel, true).await?;
                    recompute.push(asset.spec.id.clone());
                    (results, None)
                }
            };
            let mut new = prepared.new;
            for (key, result) in results {
                if let Some(segment) = new.remove(&key) {
                    answer.push(segment.with_run(result));
                }
            }
            changed.push((prepared.slot, points, Basis::of(asset, Some(&channel))));
        }
        commit.finish().await?;
        for (mut slot, points, basis) in changed {
            slot.now_of(basis);
            if let Some((after, points)) = points {
                slot.points.get_or_insert_default().replace(after, points);
            }
        }
        self.announce_alarms(notices);
        if !recompute.is_empty() {
            self.recompute_in_background(recompute);
        }
        self.retain_in_background();
        Ok(answer)
    }
}

/// What is answered where the store does not answer.
const STORE_AWAY: IngestError = IngestError::Busy {
    what: "the store is away",
    retry_after_s: 5,
};

fn inputs_of(new: &BTreeMap<SegmentKey, NewSegment>) -> Vec<FoldInput> {
    new.iter()
        .map(|(key, segment)| FoldInput {
            key: key.clone(),
            features: segment.analysed.features.clone(),
            indicators: segment.analysed.indicators.clone(),
        })
        .collect()
}

/// Of the states on the way those that the store keeps, and the newest.
pub(super) fn states_of(points: &[FoldPoint]) -> Result<Vec<FoldState>, IngestError> {
    let newest = points.last().map_or(0, |point| point.position);
    points
        .iter()
        .filter(|point| point.position == newest || point.position.is_multiple_of(SEGMENTS_PER_STATE))
        .map(FoldPoint::to_stored)
        .collect()
}
