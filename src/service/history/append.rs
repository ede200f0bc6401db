//! Appends new segments to the history of their channel: folds them under the channel's lock and prepares the
//! rows to be written.

use std::collections::BTreeMap;

use jiff::Timestamp;
use tokio::sync::OwnedMutexGuard;

use super::History;
use super::channels::{ChannelCache, Revisions};
use super::fold::{FoldInput, Folded, states_to_store, while_recomputing};
use crate::asset::{AssetId, Segment};
use crate::service::error::ServiceError;
use crate::service::keys::analysis_keys;
use crate::service::record::units_conflict;
use crate::service::simulations::KeyedEstimator;
use crate::store::{
    AlarmNotice, Asset, ChannelKeys, ChannelRows, ChannelSummary, NewSegment, RunResult, SegmentKey,
    Transaction,
};

/// Maximum number of stored records that are folded again at once, since the write transaction waits for
/// them. If more follow a late record, only those between the nearest state and it are folded at once; if
/// these are more too, its estimate also follows in the background.
const MAX_FOREGROUND_RECORDS: u32 = 512;

/// A channel's new segments and the result of folding them.
pub(crate) struct Appended<'a> {
    asset: &'a Asset,
    /// The channel as read in the transaction.
    channel: ChannelSummary,
    new: BTreeMap<SegmentKey, NewSegment>,
    cache: OwnedMutexGuard<ChannelCache>,
    /// The keys of the channel's history.
    keys: ChannelKeys,
    fold: Fold,
}

/// The effect of new segments on a channel's history.
enum Fold {
    /// All estimates after position `after` are known.
    Complete { after: u64, folded: Folded, estimator: KeyedEstimator },
    /// The new segments have provisional results; the history after them is folded again in the background.
    Deferred { results: Vec<(SegmentKey, RunResult)> },
}

impl Fold {
    /// The estimates of all new segments follow in the background.
    fn while_recomputing(asset: &Asset, new: &BTreeMap<SegmentKey, NewSegment>) -> Self {
        let need = asset.spec.baseline.records;
        Self::Deferred { results: new.keys().map(|key| (key.clone(), while_recomputing(need))).collect() }
    }
}

impl History {
    /// Folds the new segments of a channel into its history as far as that is done at once, without writing
    /// anything yet; `current` is the estimator for the current description and library.
    pub(crate) async fn append<'a>(
        &self,
        asset: &'a Asset,
        current: &KeyedEstimator,
        channel: ChannelSummary,
        new: BTreeMap<SegmentKey, NewSegment>,
        mut cache: OwnedMutexGuard<ChannelCache>,
    ) -> Result<Appended<'a>, ServiceError> {
        let wanted = analysis_keys(&asset.spec);
        if new.values().any(|segment| segment.analysed.keys != wanted) {
            return Err(ServiceError::DescriptionChanged(asset.spec.id.clone()));
        }
        self.check_units(asset, &channel, &new, &mut cache).await?;
        if channel.segments == 0 {
            // The first records of a channel are folded under the current keys.
            let keys = ChannelKeys { analysed: wanted, fold: current.fold_key.clone() };
            let timeline = self.folding.timeline(asset, None, &mut cache).await?;
            let folded = self.folding.fold_with_priority(current, None, inputs_of(&new), &timeline).await?;
            let estimator = current.clone();
            return Ok(Appended {
                asset,
                channel,
                new,
                cache,
                keys,
                fold: Fold::Complete { after: 0, folded, estimator },
            });
        }
        let keys = channel.keys.clone();
        let fits = new.values().all(|segment| segment.analysed.keys.feature == keys.analysed.feature);
        // Records are folded with the estimator of the served history until another history is served.
        let estimator = self.simulations.estimator_of(&keys.fold).filter(|_| fits);
        let fold = match estimator {
            Some(estimator) => self.fold_in(&estimator, asset, &channel, &new, &mut cache).await?,
            None => Fold::while_recomputing(asset, &new),
        };
        Ok(Appended { asset, channel, new, cache, keys, fold })
    }

    /// Checks that new segments have the unit of their channel: until its first record is stored, others may
    /// have been identified without knowing it.
    async fn check_units(
        &self,
        asset: &Asset,
        channel: &ChannelSummary,
        new: &BTreeMap<SegmentKey, NewSegment>,
        cache: &mut ChannelCache,
    ) -> Result<(), ServiceError> {
        let Some(first) = new.values().next() else { return Ok(()) };
        if asset.spec.sensor.of.is_some() {
            // They have the units of the other asset.
            return Ok(());
        }
        cache.validate(Revisions::of(asset, (channel.segments > 0).then_some(channel)));
        let unit = match cache.unit.take() {
            Some(unit) => unit,
            None => {
                let stored = self.folding.store.latest_unit(channel).await?;
                stored.unwrap_or_else(|| first.unit.clone())
            }
        };
        let conflict = new.values().find(|segment| units_conflict(&segment.unit, &unit));
        cache.unit = Some(unit.clone());
        match conflict {
            Some(_) => Err(ServiceError::UnitChosen { channel: channel.channel.clone(), unit }),
            None => Ok(()),
        }
    }

    async fn fold_in(
        &self,
        estimator: &KeyedEstimator,
        asset: &Asset,
        channel: &ChannelSummary,
        new: &BTreeMap<SegmentKey, NewSegment>,
        cache: &mut ChannelCache,
    ) -> Result<Fold, ServiceError> {
        let timeline = self.folding.timeline(asset, Some(channel), cache).await?;
        let states = match cache.states.take() {
            Some(states) => states,
            None => self.folding.recent_states(estimator, channel, &timeline).await?,
        };
        let states = cache.states.insert(states);
        let (Some(first), Some(last)) = (new.keys().next(), new.keys().next_back()) else {
            return Ok(Fold::Deferred { results: Vec::new() });
        };
        let newest = states.newest().cloned();
        let from = match states.before(first) {
            Some(state) => Some(state.clone()),
            None => self.folding.state_before(channel, first).await?,
        };
        let after = from.as_ref().map_or(0, |state| state.position);
        let stored_after =
            newest.as_ref().map_or(channel.segments, |newest| newest.position.saturating_sub(after));
        let mut inputs = inputs_of(new);
        let is_latest = newest.as_ref().is_some_and(|newest| newest.last < *first);
        if is_latest {
            let folded = self.folding.fold_with_priority(estimator, from, inputs, &timeline).await?;
            let estimator = estimator.clone();
            return Ok(Fold::Complete { after, folded, estimator });
        }
        let fold_all = stored_after <= u64::from(MAX_FOREGROUND_RECORDS) && newest.is_some();
        // All stored records after the state, or only those before the last new one.
        let last_folded = from.as_ref().map(|state| &state.last);
        let mut stored = self
            .folding
            .store
            .features(channel, channel.served_analyses(), last_folded, MAX_FOREGROUND_RECORDS + 1)
            .await?;
        stored.retain(|stored| fold_all || stored.key < *last);
        if stored.len() > MAX_FOREGROUND_RECORDS as usize {
            return Ok(Fold::while_recomputing(asset, new));
        }
        inputs.extend(stored.into_iter().map(|stored| FoldInput::of(stored, &estimator.feature_key)));
        inputs.sort_by(|a, b| a.key.cmp(&b.key));
        let mut folded = self.folding.fold_with_priority(estimator, from, inputs, &timeline).await?;
        if fold_all {
            // The results before the first new record are unchanged.
            folded.results.retain(|(key, _)| key >= first);
            let estimator = estimator.clone();
            return Ok(Fold::Complete { after, folded, estimator });
        }
        folded.results.retain(|(key, _)| new.contains_key(key));
        Ok(Fold::Deferred { results: folded.results })
    }
}

impl Appended<'_> {
    /// The rows to be written.
    pub(crate) fn rows(&mut self) -> Result<ChannelRows<'_>, ServiceError> {
        self.channel.keys = self.keys.clone();
        let (wears, states, is_rewritten) = match &self.fold {
            Fold::Complete { after, folded, .. } => {
                let states = Some((*after, states_to_store(&folded.states)?));
                (&folded.results, states, folded.results.len() != self.new.len())
            }
            Fold::Deferred { results } => {
                self.channel.must_fold = true;
                (results, None, true)
            }
        };
        Ok(ChannelRows {
            channel: &mut self.channel,
            new: self.new.values().collect(),
            wears,
            states,
            is_rewritten,
        })
    }

    /// Writes the channel's alarms as folded; returns the notices of new changes.
    pub(crate) async fn set_alarms(
        &mut self,
        transaction: &mut Transaction,
        now: Timestamp,
    ) -> Result<Vec<AlarmNotice>, ServiceError> {
        let Fold::Complete { folded, estimator, .. } = &self.fold else {
            return Ok(Vec::new());
        };
        let is_append = folded.results.len() == self.new.len();
        let has_alarms = self.cache.timeline.as_ref().is_none_or(|known| known.has_alarms);
        // If records were only appended and changed no alarm, the stored alarms are still right.
        if folded.alarms.is_empty() && (is_append || !has_alarms) {
            return Ok(Vec::new());
        }
        let notices =
            transaction.set_alarms(&self.channel, folded.alarms.folded(estimator, is_append), now).await?;
        if !has_alarms {
            self.cache.timeline = None;
        }
        Ok(notices)
    }
}

impl History {
    /// Updates the state of a channel in memory after the commit, and returns the stored segments.
    pub(crate) fn committed(&self, appended: Appended<'_>) -> Committed {
        let Appended { asset, channel, mut new, mut cache, fold, .. } = appended;
        cache.set_revisions(Revisions::of(asset, Some(&channel)));
        let (results, is_outdated) = match fold {
            Fold::Complete { after, folded, estimator } => {
                // Nothing else notices that the library of a new channel became ready in the meantime.
                let now = || self.simulations.estimator(&asset.spec).fold_key;
                let is_outdated = after == 0 && now() != estimator.fold_key;
                let states = cache.states.get_or_insert_default();
                states.replace(after, folded.states);
                if self.channels.are_many() {
                    states.keep_newest();
                }
                (folded.results, is_outdated)
            }
            Fold::Deferred { results } => (results, true),
        };
        let stored = results.into_iter().filter_map(|(key, result)| Some(new.remove(&key)?.with_run(result)));
        Committed { segments: stored.collect(), outdated: is_outdated.then(|| asset.spec.id.clone()) }
    }
}

/// A channel's new segments after the commit.
pub(crate) struct Committed {
    pub(crate) segments: Vec<Segment>,
    /// The asset, if its history has to be folded again in the background.
    pub(crate) outdated: Option<AssetId>,
}

fn inputs_of(new: &BTreeMap<SegmentKey, NewSegment>) -> Vec<FoldInput> {
    new.iter()
        .map(|(key, segment)| FoldInput {
            key: key.clone(),
            excluded: segment.excluded,
            features: segment.analysed.features.clone(),
            indicators: segment.analysed.indicators.clone(),
        })
        .collect()
}
