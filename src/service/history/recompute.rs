//! Histories computed again in the background: after a change of the description, the library or the method,
//! or where records came late. The old answers are served until the new ones are complete, and then all at
//! once.

use std::sync::Arc;

use super::channels::{Channels, Slot};
use super::fold::{AlarmRun, FoldInput, FoldPoint, folding, read_point, states_of};
use super::folding::Folding;
use super::progress::Progress;
use super::timeline::Timeline;
use crate::asset::{AssetId, AssetSpec, SegmentId};
use crate::service::clock::Clock;
use crate::service::error::ServiceError;
use crate::service::events::{Announcer, LiveEvent};
use crate::service::keys::analysis_keys;
use crate::service::recomputation::RecomputationState;
use crate::service::record::{StoredRecord, analyse};
use crate::service::sensor_group::described;
use crate::service::simulations::{KeyedEstimator, Simulations};
use crate::service::workers::Workers;
use crate::store::{
    Analysed, AnalysisGeneration, Asset, ChannelKeys, ChannelSummary, MadeFrom, NewSegment, SegmentKey,
    Store, StoreError, WearGeneration,
};

/// Records folded in one piece: bounds the memory and the length of a transaction.
const FOLDED_AT_ONCE: u32 = 256;

/// Records analysed in one piece.
const ANALYSED_AT_ONCE: u32 = 32;

/// Rows removed in one transaction.
const REMOVED_AT_ONCE: u32 = 500;

/// How often what other processes bring meanwhile is folded before a history is begun again later.
const MAX_TURNS: u32 = 100;

/// Who brings a history up to date.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Made {
    /// This process; it is done.
    Here,
    /// Another one, which is at it.
    Elsewhere,
    /// Nobody before the asset's library is there: this process is told then.
    WithItsLibrary,
}

/// The generations that are being made.
#[derive(Debug, Clone, Copy)]
struct Generations {
    analyses: AnalysisGeneration,
    wear: WearGeneration,
}

/// A history as far as it is folded again.
#[derive(Debug)]
struct Refolded {
    /// The state after the last record folded; none before the first one.
    point: Option<FoldPoint>,
    /// All changes of alarms so far.
    alarms: AlarmRun,
}

impl Refolded {
    fn start(estimator: &KeyedEstimator) -> Self {
        Self { point: None, alarms: AlarmRun::start(estimator) }
    }
}

/// Computes histories again.
pub(crate) struct Recomputer {
    pub(crate) store: Store,
    pub(crate) workers: Arc<Workers>,
    pub(crate) simulations: Arc<Simulations>,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) events: Announcer,
    pub(crate) channels: Arc<Channels>,
    pub(crate) folding: Folding,
    pub(crate) progress: Arc<Progress>,
}

impl Recomputer {
    /// Brings the channels of an asset up to what is asked for now.
    pub(crate) async fn recompute_asset(&self, asset: &AssetId) -> Result<Made, ServiceError> {
        let mut made = Made::Here;
        let version = match self.store.asset(asset).await {
            Ok(asset) => asset.version(),
            Err(StoreError::AssetUnknown(_)) => return Ok(Made::Here),
            Err(error) => return Err(error.into()),
        };
        for channel in self.store.channels(asset).await? {
            match self.bring_up_to_date(asset, &channel.channel).await {
                Ok(Made::Here) => {}
                Ok(not_yet) => made = not_yet,
                Err(ServiceError::Store(StoreError::AssetUnknown(_))) => return Ok(Made::Here),
                Err(error) => {
                    self.progress.update(asset, &channel.channel, |shown| {
                        shown.state = RecomputationState::Failed;
                        shown.error = Some(error.to_string());
                    });
                    return Err(error);
                }
            }
        }
        if made == Made::Here {
            self.store.settle_asset(asset, version).await?;
        }
        Ok(made)
    }

    /// Computes a channel again as long as it is not what is asked for.
    async fn bring_up_to_date(&self, asset: &AssetId, name: &str) -> Result<Made, ServiceError> {
        loop {
            let description = described(&self.store, asset).await?;
            let estimator = self.simulations.estimator(&description.spec);
            let Some(channel) = self.store.channel(asset, name).await? else {
                return Ok(Made::Here);
            };
            let wanted =
                ChannelKeys { analysed: analysis_keys(&description.spec), fold: estimator.fold_key.clone() };
            if channel.segments == 0 || (channel.keys == wanted && !channel.must_fold) {
                self.remove_leftovers(&channel).await?;
                return Ok(Made::Here);
            }
            let served = self.simulations.estimator_of(&channel.keys.fold);
            if estimator.awaits_library() && !served.is_some_and(|served| served.is_without_library()) {
                // What was folded with a library is served until there is another one.
                return Ok(Made::WithItsLibrary);
            }
            let is_other_fold = channel.keys.analysed == wanted.analysed && channel.keys.fold != wanted.fold;
            if is_other_fold
                && self.store.is_shared()
                && self.simulations.awaits_neighbours(&description.spec)
            {
                // Who has them already made the history with them, and would do so again.
                return Ok(Made::Elsewhere);
            }
            let Some(wear) = self.store.begin_making(&channel, self.clock.now()).await? else {
                return Ok(Made::Elsewhere);
            };
            match self.recompute(&description, &estimator, &channel, wear, wanted).await {
                Ok(()) => {}
                // Another process took its place, or its description changed: looked at from the start.
                Err(ServiceError::Store(StoreError::Outdated(what))) => {
                    tracing::debug!(%asset, channel = name, what, "restarting a recomputation");
                }
                Err(error) => {
                    // The error that counts is the first one.
                    let _ = self.store.stop_making(&channel, wear).await;
                    return Err(error);
                }
            }
        }
    }

    async fn recompute(
        &self,
        description: &Asset,
        estimator: &KeyedEstimator,
        channel: &ChannelSummary,
        wear: WearGeneration,
        wanted: ChannelKeys,
    ) -> Result<(), ServiceError> {
        let (asset, name) = (&channel.asset_id, channel.channel.as_str());
        self.progress.begin(channel, self.clock.now());
        let store = &self.store;
        let slot = self.channels.slot(asset, name);
        let is_analysed = channel.keys.analysed == wanted.analysed;
        let analyses = if is_analysed {
            channel.served_analyses()
        } else {
            store.next_analyses(channel, wear, &wanted.analysed).await?
        };
        let generations = Generations { analyses, wear };
        if !is_analysed {
            self.analyse_again(&description.spec, channel, generations).await?;
        }
        self.progress.update(asset, name, |shown| shown.state = RecomputationState::Folding);
        let mut history = Refolded::start(estimator);
        let timeline = self.timeline_now(description, channel).await?;
        while self.fold_piece(estimator, channel, generations, &timeline, &mut history).await?
            >= FOLDED_AT_ONCE as usize
        {}
        // From here on this process brings nothing new: what came meanwhile is little. What another one
        // brings is folded in another turn.
        let mut slot = slot.lock().await;
        let mut turns = 0;
        let (notices, now) = loop {
            let current_asset = described(&self.store, asset).await?;
            if analysis_keys(&current_asset.spec) != wanted.analysed {
                // Changed again meanwhile; what was made is not what is asked for.
                return Ok(store.stop_making(channel, wear).await?);
            }
            let (current, changed_from) = store.take_changes(channel, wear).await?;
            if !is_analysed {
                self.analyse_again(&current_asset.spec, channel, generations).await?;
            }
            let timeline = self.timeline_now(&current_asset, &current).await?;
            let passed = |point: &Option<FoldPoint>, key: &SegmentKey| {
                point.as_ref().is_some_and(|point| point.last >= *key)
            };
            if let Some(earliest) = changed_from
                && passed(&history.point, &earliest)
            {
                let stored = store.state_of_generation(channel, wear, &earliest).await?;
                history.point = stored.and_then(|stored| read_point(channel, stored));
            }
            // Also where no record is left: what operators did since the last one.
            while self.fold_piece(estimator, channel, generations, &timeline, &mut history).await? > 0 {}
            let alarms = history.alarms.folded(estimator, false);
            let from = MadeFrom { asset: current_asset.version(), channel: current.version() };
            let now = self.clock.now();
            match store.serve(channel, from, (analyses, wear), wanted.clone(), alarms, now).await {
                Err(error) if error.is_conflict() && turns < MAX_TURNS => turns += 1,
                served => break (served?, now),
            }
        };
        slot.clear();
        drop(slot);
        self.events.announce_alarms(notices);
        tracing::info!(%asset, channel = name, records = channel.segments, "computed a history again");
        self.progress.update(asset, name, |shown| {
            shown.state = RecomputationState::Finished;
            shown.finished_at = Some(now);
        });
        self.events.announce(LiveEvent::HistoryFolded { asset: asset.clone(), channel: name.to_owned() });
        Ok(())
    }

    /// What happened between the records of a channel, without what is held of it.
    async fn timeline_now(
        &self,
        asset: &Asset,
        channel: &ChannelSummary,
    ) -> Result<Arc<Timeline>, ServiceError> {
        self.folding.timeline(asset, Some(channel), &mut Slot::default()).await
    }

    /// Analyses again what is not analysed yet in a generation.
    async fn analyse_again(
        &self,
        spec: &AssetSpec,
        channel: &ChannelSummary,
        Generations { analyses: generation, wear }: Generations,
    ) -> Result<(), ServiceError> {
        let store = &self.store;
        let mut after: Option<SegmentKey> = None;
        loop {
            let segments = store.not_analysed(channel, generation, after.as_ref(), ANALYSED_AT_ONCE).await?;
            let Some(last) = segments.last() else {
                return Ok(());
            };
            after = Some(last.key());
            // One task for each record, so that records that come in meanwhile have their turn in between.
            let mut tasks = tokio::task::JoinSet::new();
            for segment in segments {
                let (store, workers, spec) = (self.store.clone(), Arc::clone(&self.workers), spec.clone());
                tasks.spawn(async move {
                    let samples = usize::try_from(segment.samples).unwrap_or(usize::MAX);
                    let again = move || analyse_one(&store, &spec, segment);
                    workers.run_analysis("analyse a record again", samples, again).await
                });
            }
            let mut analyses: Vec<(SegmentId, Analysed)> = Vec::new();
            let mut without_raw = 0;
            while let Some(done) = tasks.join_next().await {
                let (id, analysed, is_new) =
                    done.map_err(|_| ServiceError::WorkerLost("analyse a record again"))??;
                without_raw += u64::from(!is_new);
                analyses.push((id, analysed));
            }
            let now = self.clock.now();
            store.add_analyses(channel, wear, generation, &analyses, now).await?;
            self.progress.update(&channel.asset_id, &channel.channel, |shown| {
                shown.analysed += analyses.len() as u64 - without_raw;
                shown.without_raw += without_raw;
            });
        }
    }

    /// Folds the records after what is folded so far, at most so many at once, and returns how many they
    /// were.
    async fn fold_piece(
        &self,
        estimator: &KeyedEstimator,
        channel: &ChannelSummary,
        Generations { analyses, wear }: Generations,
        timeline: &Arc<Timeline>,
        history: &mut Refolded,
    ) -> Result<usize, ServiceError> {
        let store = &self.store;
        let Refolded { point, alarms } = history;
        let after = point.as_ref().map(|point| &point.last);
        let stored = store.features_of_generation(channel, analyses, after, FOLDED_AT_ONCE).await?;
        let count = stored.len();
        let inputs = stored.into_iter().map(|stored| FoldInput::of(stored, &estimator.feature_key)).collect();
        let position = point.as_ref().map_or(0, |point| point.position);
        let fold = folding(estimator, point.clone(), inputs, timeline);
        let mut folded = self.workers.run("estimate the wear", fold).await?;
        alarms.go_on(folded.alarms);
        if count == 0 {
            return Ok(0);
        }
        let states = states_of(&folded.points)?;
        let now = self.clock.now();
        store.add_wears(channel, wear, &folded.results, (position, &states), now).await?;
        *point = folded.points.pop();
        self.progress
            .update(&channel.asset_id, &channel.channel, |shown| shown.folded = position + count as u64);
        Ok(count)
    }

    async fn remove_leftovers(&self, channel: &ChannelSummary) -> Result<(), ServiceError> {
        if !channel.leftovers {
            return Ok(());
        }
        let mut after = None;
        loop {
            let now = self.clock.now();
            after = self.store.remove_leftovers(channel, after.as_ref(), REMOVED_AT_ONCE, now).await?;
            if after.is_none() {
                return Ok(());
            }
        }
    }
}

/// What a stored record says when it is asked again; what it said before where its raw bytes cannot be had.
fn analyse_one(store: &Store, spec: &AssetSpec, segment: NewSegment) -> (SegmentId, Analysed, bool) {
    if segment.analysed.keys == analysis_keys(spec) {
        return (segment.id, segment.analysed, true);
    }
    match StoredRecord::from(&segment).read(store) {
        Ok(record) => (segment.id, analyse(&record, spec), true),
        Err(error) => {
            tracing::debug!(segment = %segment.id, %error, "failed to analyse a record again: keeping its results");
            (segment.id, segment.analysed, false)
        }
    }
}
