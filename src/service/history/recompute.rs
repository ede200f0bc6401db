//! Recomputation of histories in the background: after a change of the description, the library or the
//! method, or after late records. The old history is served until the new one is complete and replaces it at
//! once.

use std::sync::Arc;
use std::time::Duration;

use futures_util::{StreamExt, stream};

use super::channels::{ChannelCache, Channels};
use super::fold::{AlarmRun, FoldInput, FoldState, folding, read_state, states_to_store};
use super::folding::Folding;
use super::progress::Progress;
use super::timeline::Timeline;
use crate::asset::{AssetId, AssetSpec, SegmentId};
use crate::service::background::while_leased;
use crate::service::clock::Clock;
use crate::service::error::ServiceError;
use crate::service::events::{EventSender, LiveEvent};
use crate::service::keys::analysis_keys;
use crate::service::recomputation::RecomputationState;
use crate::service::record::{StoredRecord, analyse, raw_bytes};
use crate::service::sensor_group::described;
use crate::service::simulations::{KeyedEstimator, Simulations};
use crate::service::workers::Workers;
use crate::store::{
    Analysed, AnalysisGeneration, Asset, ChannelKeys, ChannelSummary, GenerationInputs, NewSegment,
    SegmentKey, Store, StoreError, WearGeneration,
};

/// Records folded in one batch: bounds the memory and the length of a transaction.
const FOLD_BATCH: u32 = 256;

/// Records analysed in one batch.
const ANALYSIS_BATCH: u32 = 32;

/// Interval at which a process renews its right to recompute a history.
const RENEWAL_INTERVAL: Duration = Duration::from_secs(15);

/// Rows removed in one transaction.
const REMOVAL_BATCH: u32 = 500;

/// Maximum number of times that records added by other processes are folded before the recomputation is
/// retried later.
const MAX_ROUNDS: u32 = 100;

/// The outcome of bringing a history up to date.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum UpdateOutcome {
    /// It is up to date.
    Done,
    /// Another process is computing it.
    InOtherProcess,
    /// It waits for the asset's library, whose completion triggers it again.
    AwaitsLibrary,
}

/// The generations being written.
#[derive(Debug, Clone, Copy)]
struct Generations {
    analyses: AnalysisGeneration,
    wear: WearGeneration,
}

/// The state of a history that is being folded again.
#[derive(Debug)]
struct FoldProgress {
    /// The state after the last record folded; `None` before the first one.
    state: Option<FoldState>,
    /// All changes of alarms so far.
    alarms: AlarmRun,
}

impl FoldProgress {
    fn start(estimator: &KeyedEstimator) -> Self {
        Self { state: None, alarms: AlarmRun::start(estimator) }
    }
}

/// Recomputes histories.
pub(crate) struct Recomputer {
    pub(crate) store: Store,
    pub(crate) workers: Arc<Workers>,
    pub(crate) simulations: Arc<Simulations>,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) events: EventSender,
    pub(crate) channels: Arc<Channels>,
    pub(crate) folding: Folding,
    pub(crate) progress: Arc<Progress>,
}

impl Recomputer {
    /// Brings the channels of an asset up to date.
    pub(crate) async fn recompute_asset(&self, asset: &AssetId) -> Result<UpdateOutcome, ServiceError> {
        let mut outcome = UpdateOutcome::Done;
        let version = match self.store.asset(asset).await {
            Ok(asset) => asset.version(),
            Err(StoreError::AssetUnknown(_)) => return Ok(UpdateOutcome::Done),
            Err(error) => return Err(error.into()),
        };
        for channel in self.store.channels(asset).await? {
            match self.bring_up_to_date(asset, &channel.channel).await {
                Ok(UpdateOutcome::Done) => {}
                // Unlike the library's completion, the end of another process's work starts nothing here.
                Ok(not_yet) if outcome != UpdateOutcome::InOtherProcess => outcome = not_yet,
                Ok(_) => {}
                Err(ServiceError::Store(StoreError::AssetUnknown(_))) => return Ok(UpdateOutcome::Done),
                Err(error) => {
                    self.progress.update(asset, &channel.channel, |shown| {
                        shown.state = RecomputationState::Failed;
                        shown.error = Some(error.to_string());
                    });
                    return Err(error);
                }
            }
        }
        if outcome == UpdateOutcome::Done {
            let description = described(&self.store, asset).await?;
            let served = self.store.channels(asset).await?.into_iter().map(|channel| channel.keys.fold);
            self.simulations.keep_estimators(&description.spec, served);
            self.store.mark_up_to_date(asset, version).await?;
        }
        Ok(outcome)
    }

    /// Recomputes a channel until it is up to date.
    async fn bring_up_to_date(&self, asset: &AssetId, name: &str) -> Result<UpdateOutcome, ServiceError> {
        loop {
            let description = described(&self.store, asset).await?;
            let estimator = self.simulations.estimator(&description.spec);
            let Some(channel) = self.store.channel(asset, name).await? else {
                return Ok(UpdateOutcome::Done);
            };
            let wanted =
                ChannelKeys { analysed: analysis_keys(&description.spec), fold: estimator.fold_key.clone() };
            if channel.leftovers {
                // Before another generation is written: those that were abandoned would add up.
                self.remove_leftovers(&channel).await?;
            }
            if channel.segments == 0 || (channel.keys == wanted && !channel.must_fold) {
                return Ok(UpdateOutcome::Done);
            }
            let served = self.simulations.estimator_of(&channel.keys.fold);
            if estimator.awaits_library() && !served.is_some_and(|served| served.is_without_library()) {
                // The history folded with a library is served until the new library is ready.
                return Ok(UpdateOutcome::AwaitsLibrary);
            }
            let is_other_fold = channel.keys.analysed == wanted.analysed && channel.keys.fold != wanted.fold;
            if is_other_fold && self.store.is_shared() && self.simulations.awaits_ensemble(&description.spec)
            {
                // A process that has the ensemble already has computed the history with it, and would do
                // so again.
                return Ok(UpdateOutcome::InOtherProcess);
            }
            let Some(wear) = self.store.begin_generation(&channel, self.clock.now()).await? else {
                return Ok(UpdateOutcome::InOtherProcess);
            };
            let recomputed = self.recompute(&description, &estimator, &channel, wear, wanted);
            match while_leased(RENEWAL_INTERVAL, recomputed, || self.renew(&channel, wear)).await {
                Ok(()) => {}
                // Another process took over, or the description changed: start again.
                Err(ServiceError::Store(StoreError::Outdated(what))) => {
                    tracing::debug!(%asset, channel = name, what, "restarting a recomputation");
                    self.progress.forget_channel(asset, name);
                }
                Err(error) => {
                    if let Err(again) = self.abandon(&channel, wear, &error).await {
                        tracing::debug!(%asset, channel = name, error = %again, "failed to remove an abandoned generation; retrying later");
                    }
                    return Err(error);
                }
            }
        }
    }

    /// Renews the right to recompute a channel's history. Without it the next write fails.
    async fn renew(&self, channel: &ChannelSummary, wear: WearGeneration) {
        if let Err(error) = self.store.renew_generation(channel, wear, self.clock.now()).await {
            let (asset, channel) = (&channel.asset_id, &channel.channel);
            tracing::debug!(%asset, channel, %error, "failed to renew the right to recompute a history");
        }
    }

    /// Removes what was written of a generation. The analyses are kept for the next one, unless the disk is
    /// full.
    async fn abandon(
        &self,
        channel: &ChannelSummary,
        wear: WearGeneration,
        because: &ServiceError,
    ) -> Result<(), ServiceError> {
        let is_full = matches!(because, ServiceError::Store(error) if error.is_full());
        self.store.abandon_generation(channel, wear, !is_full).await?;
        self.remove_leftovers(channel).await
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
        let cache = self.channels.cache(asset, name);
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
        let mut history = FoldProgress::start(estimator);
        let timeline = self.timeline_now(description, channel).await?;
        while self.fold_piece(estimator, channel, generations, &timeline, &mut history).await?
            >= FOLD_BATCH as usize
        {}
        // Under the lock this process adds no records, and few have arrived since. Those that another process
        // adds are folded in another round.
        let mut cache = cache.lock().await;
        let mut rounds = 0;
        let (notices, now) = loop {
            let current_asset = described(&self.store, asset).await?;
            if analysis_keys(&current_asset.spec) != wanted.analysed {
                // The description changed again in the meantime: this history is outdated already.
                return Ok(store.abandon_generation(channel, wear, true).await?);
            }
            let (current, changed_from) = store.take_changes(channel, wear).await?;
            if !is_analysed {
                self.analyse_again(&current_asset.spec, channel, generations).await?;
            }
            let timeline = self.timeline_now(&current_asset, &current).await?;
            let passed = |state: &Option<FoldState>, key: &SegmentKey| {
                state.as_ref().is_some_and(|state| state.last >= *key)
            };
            if let Some(earliest) = changed_from
                && passed(&history.state, &earliest)
            {
                let stored = store.state_before(channel, wear, &earliest).await?;
                history.state = stored.and_then(|stored| read_state(channel, stored));
            }
            // Also if no record is left: operator actions after the last one.
            while self.fold_piece(estimator, channel, generations, &timeline, &mut history).await? > 0 {}
            let alarms = history.alarms.folded(estimator, false);
            let from = GenerationInputs { asset: current_asset.version(), channel: current.version() };
            let now = self.clock.now();
            match store.serve(channel, from, (analyses, wear), wanted.clone(), alarms, now).await {
                Err(error) if error.is_conflict() && rounds < MAX_ROUNDS => rounds += 1,
                served => break (served?, now),
            }
        };
        cache.clear();
        drop(cache);
        self.events.send_alarms(notices);
        tracing::info!(%asset, channel = name, records = channel.segments, "recomputed a history");
        self.progress.update(asset, name, |shown| {
            shown.state = RecomputationState::Finished;
            shown.finished_at = Some(now);
        });
        self.events.send(LiveEvent::HistoryFolded { asset: asset.clone(), channel: name.to_owned() });
        Ok(())
    }

    /// The current timeline of a channel, read from the store instead of from the cache.
    async fn timeline_now(
        &self,
        asset: &Asset,
        channel: &ChannelSummary,
    ) -> Result<Arc<Timeline>, ServiceError> {
        self.folding.timeline(asset, Some(channel), &mut ChannelCache::default()).await
    }

    /// Analyses the records that have no analysis in a generation yet.
    async fn analyse_again(
        &self,
        spec: &AssetSpec,
        channel: &ChannelSummary,
        Generations { analyses: generation, wear }: Generations,
    ) -> Result<(), ServiceError> {
        let store = &self.store;
        let mut after: Option<SegmentKey> = None;
        loop {
            let segments = store.not_analysed(channel, generation, after.as_ref(), ANALYSIS_BATCH).await?;
            let Some(last) = segments.last() else {
                return Ok(());
            };
            after = Some(last.key());
            // One task for each record, so that new records are processed in between. As many as keep the
            // worker threads busy, because each holds its raw bytes.
            let tasks = segments.into_iter().map(|segment| self.analyse_one(spec, segment));
            let mut tasks = stream::iter(tasks).buffer_unordered(self.workers.threads() + 1);
            let mut analyses: Vec<(SegmentId, Analysed)> = Vec::new();
            let mut without_raw = 0;
            while let Some(done) = tasks.next().await {
                let (id, analysed, is_new) = done?;
                without_raw += u64::from(!is_new);
                analyses.push((id, analysed));
            }
            store.add_analyses(channel, wear, generation, &analyses).await?;
            self.progress.update(&channel.asset_id, &channel.channel, |shown| {
                shown.analysed += analyses.len() as u64 - without_raw;
                shown.without_raw += without_raw;
            });
        }
    }

    /// Analyses a stored record again; keeps its old analysis if its raw bytes are lost. The flag says
    /// whether the analysis is up to date.
    async fn analyse_one(
        &self,
        spec: &AssetSpec,
        segment: NewSegment,
    ) -> Result<(SegmentId, Analysed, bool), ServiceError> {
        if segment.analysed.keys == analysis_keys(spec) {
            return Ok((segment.id, segment.analysed, true));
        }
        match self.analyse_raw(spec, &segment).await {
            Ok(analysed) => Ok((segment.id, analysed, true)),
            Err(error) if error.is_record_lost() => {
                tracing::debug!(segment = %segment.id, %error, "failed to reanalyse a record; keeping its results");
                Ok((segment.id, segment.analysed, false))
            }
            // The raw bytes may be read later: old results would be taken for the only ones possible.
            Err(error) => Err(error),
        }
    }

    async fn analyse_raw(&self, spec: &AssetSpec, segment: &NewSegment) -> Result<Analysed, ServiceError> {
        let bytes = raw_bytes(&self.store, &segment.raw.sha256).await?;
        let (stored, spec) = (StoredRecord::from(segment), spec.clone());
        let samples = usize::try_from(segment.samples).unwrap_or(usize::MAX);
        let again = move || Ok(analyse(&stored.decode(&bytes)?, &spec));
        self.workers.run_analysis("reanalyse a record", samples, again).await?
    }

    /// Folds the next batch of records and returns its size; 0 at the end of the history.
    async fn fold_piece(
        &self,
        estimator: &KeyedEstimator,
        channel: &ChannelSummary,
        Generations { analyses, wear }: Generations,
        timeline: &Arc<Timeline>,
        history: &mut FoldProgress,
    ) -> Result<usize, ServiceError> {
        let store = &self.store;
        let FoldProgress { state, alarms } = history;
        let after = state.as_ref().map(|state| &state.last);
        let stored = store.features(channel, analyses, after, FOLD_BATCH).await?;
        let count = stored.len();
        let inputs = stored.into_iter().map(|stored| FoldInput::of(stored, &estimator.feature_key)).collect();
        let position = state.as_ref().map_or(0, |state| state.position);
        let fold = folding(estimator, state.clone(), inputs, timeline);
        let mut folded = self.workers.run("estimate the wear", fold).await?;
        alarms.splice(folded.alarms);
        if count == 0 {
            return Ok(0);
        }
        let states = states_to_store(&folded.states)?;
        store.add_wears(channel, wear, &folded.results, (position, &states)).await?;
        *state = folded.states.pop();
        self.progress
            .update(&channel.asset_id, &channel.channel, |shown| shown.folded = position + count as u64);
        Ok(count)
    }

    async fn remove_leftovers(&self, channel: &ChannelSummary) -> Result<(), ServiceError> {
        let mut after = None;
        loop {
            let now = self.clock.now();
            after = self.store.remove_leftovers(channel, after.as_ref(), REMOVAL_BATCH, now).await?;
            if after.is_none() {
                return Ok(());
            }
        }
    }
}
