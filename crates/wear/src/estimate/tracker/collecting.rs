//! Collecting the healthy baseline.

use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::Tracker;
use super::healthy::CachedModel;
use super::tracking::Tracking;
use crate::estimate::baseline::Baseline;
use crate::estimate::comparability::can_share_baseline;
use crate::estimate::cusum::Cusums;
use crate::estimate::extrapolation::Extrapolation;
use crate::estimate::filter::Filter;
use crate::estimate::healthy_checks::Drift;
use crate::estimate::novelty::{RecordContext, SensorFault, judge};
use crate::estimate::wear::{MissingLibrary, WearEstimate, WearStatus};
use flankwatch_signal::{Features, NotComputed};

/// Fewest records of a chosen baseline; with fewer, the baseline is learnt as if none had been chosen.
const MIN_CHOSEN: usize = 8;

/// Reason given for a record without a mesh line.
const NO_MESH_LINE: &str = "no mesh line was found in this record, so it is not used";

/// Most records of a chosen baseline.
const MAX_CHOSEN: usize = 10_000;

/// The records collected for a baseline.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Collecting {
    /// Shared with the states before and after it.
    records: Vec<Arc<Features>>,
    start: Option<Timestamp>,
    /// Time of the record after the first.
    second: Option<Timestamp>,
    carried: Option<Carried>,
    #[serde(default)]
    meshless: Meshless,
    /// Number of records that the baseline cannot have although the machine ran: their speed is in doubt, or
    /// they are clipped.
    #[serde(default)]
    passed_over: u32,
    /// Set where users chose which records make the baseline.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    chosen: Option<Chosen>,
}

/// Records without a mesh line, collected before enough records with one make a baseline.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct Meshless {
    records: Vec<Arc<Features>>,
    #[serde(rename = "charts")]
    cusums: Cusums,
    #[serde(skip)]
    model: CachedModel,
}

/// A baseline that users chose: all records before `until`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Chosen {
    until: Timestamp,
    /// Time of the latest record collected.
    latest: Option<Timestamp>,
}

/// State that is carried over to a new baseline.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Carried {
    filter: Filter,
}

impl Collecting {
    /// Starts a new baseline after an event, with the filter that is carried over. Where users chose the
    /// baseline, it consists of all records before `until`.
    pub(super) fn after_event(carried: Option<Filter>, until: Option<Timestamp>) -> Self {
        Self {
            carried: carried.map(|filter| Carried { filter }),
            chosen: until.map(|until| Chosen { until, latest: None }),
            ..Self::default()
        }
    }

    /// Counts records that an earlier baseline of the same gears could not have.
    pub(super) fn passing_over(self, passed_over: u32) -> Self {
        Self { passed_over, ..self }
    }

    /// Number of records that the baseline cannot have although the machine ran.
    pub(super) fn passed_over(&self) -> u32 {
        self.passed_over
    }

    /// Carries the filter after an inspection over to the baseline: how worn the teeth are is known then.
    pub(super) fn carry_inspected(&mut self, filter: Filter) {
        self.passed_over = 0;
        self.carried = Some(Carried { filter });
    }

    /// The filter that is carried over to the baseline.
    pub(super) fn carried(&self) -> Option<&Filter> {
        self.carried.as_ref().map(|carried| &carried.filter)
    }

    /// Number of records collected.
    pub(super) fn have(&self) -> u32 {
        self.records.len() as u32
    }

    /// The records collected.
    #[cfg(test)]
    pub(super) fn records(&self) -> &[Arc<Features>] {
        &self.records
    }

    /// Takes the filter that is carried over to the baseline.
    pub(super) fn take_carried(&mut self) -> Option<Filter> {
        self.carried.take().map(|carried| carried.filter)
    }

    /// Times of the first two records, where the latest began at `latest`.
    fn first_times(&self, latest: Timestamp) -> [Timestamp; 2] {
        [self.start, self.second].map(|time| time.unwrap_or(latest))
    }

    /// Whether a record at this time is the first one after the chosen baseline.
    pub(super) fn ends_chosen_baseline(&self, at: Timestamp) -> bool {
        self.chosen.as_ref().is_some_and(|chosen| at >= chosen.until)
    }
}

impl Tracker {
    /// Starts tracking after a chosen baseline. Returns `None` where it has too few records; these then
    /// start a baseline that is learnt as if none had been chosen.
    pub(super) fn finish_chosen_baseline(
        &self,
        collecting: &mut Collecting,
        at: Timestamp,
    ) -> Option<Tracking> {
        let over = collecting.chosen.take()?;
        if collecting.records.len() < MIN_CHOSEN {
            return None;
        }
        let (first, ended) = (collecting.first_times(at), over.latest.unwrap_or(at));
        let carried = collecting.take_carried();
        Some(self.start_tracking(&collecting.records, first, ended, carried))
    }

    /// Adds a record to the baseline. Returns the estimate, and the tracking once the baseline is complete.
    pub(super) fn collect(
        &self,
        collecting: &mut Collecting,
        at: Timestamp,
        features: &Features,
    ) -> (WearEstimate, Option<Tracking>) {
        let (have, need) = (collecting.have(), self.settings.baseline_records);
        let has_no_lines = self.ensemble.is_some() && !features.has_mesh();
        if has_no_lines || features.speed_doubt.is_some() {
            collecting.passed_over += u32::from(features.speed_doubt.is_some());
            return (self.collect_meshless(&mut collecting.meshless, have, features), None);
        }
        if let Some(reason) = self.unusable_reason(features) {
            collecting.passed_over += u32::from(features.fault == Some(NotComputed::Clipped));
            return (self.without_depth(WearStatus::NoFeatures, have, &reason), None);
        }
        let ensemble = self.ensemble.as_deref();
        let rejection = ensemble.and_then(|ensemble| Extrapolation::of(ensemble, features).rejection());
        if let Some(rejection) = rejection {
            return (self.not_comparable(have, rejection), None);
        }
        match collecting.start {
            Some(_) => _ = collecting.second.get_or_insert(at),
            None => collecting.start = Some(at),
        }
        if let Some(chosen) = &mut collecting.chosen {
            if collecting.records.len() < MAX_CHOSEN {
                collecting.records.push(Arc::new(features.clone()));
                chosen.latest = Some(at);
            }
            let have = collecting.records.len();
            let until = chosen.until;
            let reason = format!("collecting the chosen baseline: {have} of the records before {until}");
            let have = (have as u32).min(need);
            return (self.without_depth(WearStatus::CollectingBaseline, have, &reason), None);
        }
        collecting.records.push(Arc::new(features.clone()));
        // Records too short to separate lines from sidebands need a baseline of their own.
        let alike = |record: &Arc<Features>| can_share_baseline(record, features);
        let have = collecting.records.iter().filter(|record| alike(record)).count() as u32;
        let tracking = (have >= need).then(|| {
            collecting.records.retain(alike);
            let (first, carried) = (collecting.first_times(at), collecting.take_carried());
            let mut tracking = self.start_tracking(&collecting.records, first, at, carried);
            tracking.passed_over = Some(collecting.passed_over).filter(|passed_over| *passed_over > have);
            tracking
        });
        let reason = format!("collecting baseline, {have} of {need}");
        (self.without_depth(WearStatus::CollectingBaseline, have, &reason), tracking)
    }

    /// Returns why a record cannot be part of the baseline.
    fn unusable_reason(&self, features: &Features) -> Option<String> {
        if let Some(fault) = features.fault.and_then(SensorFault::of_samples) {
            return Some(format!("{}, so this record is not used", fault.words()));
        }
        if features.fault == Some(NotComputed::TooShort) {
            return Some("the record is too short, so it is not used".to_owned());
        }
        let mesh_line = features.has_mesh();
        if !mesh_line && (self.ensemble.is_some() || features.checks.is_empty()) {
            let reason = match self.missing_library {
                MissingLibrary::NoMesh => "the record is too short to be compared, so it is not used",
                _ => NO_MESH_LINE,
            };
            return Some(reason.to_owned());
        }
        None
    }

    /// Handles a record without a mesh line while the baseline is collected. Wear cannot be read from such
    /// records; once there are as many as a baseline has, they serve as a baseline for novelty.
    fn collect_meshless(&self, meshless: &mut Meshless, have: u32, features: &Features) -> WearEstimate {
        let usable = features.fault.is_none() && !features.checks.is_empty();
        let is_complete = meshless.records.len() >= self.settings.baseline_records as usize;
        let mut estimate = self.without_mesh_lines(features, have, NO_MESH_LINE);
        if is_complete {
            let Meshless { records, cusums, model } = meshless;
            let healthy = model.get(|| self.healthy_model(&Baseline::of(records)));
            let context =
                RecordContext { impulsive: healthy.is_impulsive(features), ..RecordContext::default() };
            let checks = healthy.checks_at(features, 0, Drift::default().at(0.0, 1.0));
            let novelty = judge(features, &[Vec::new(), checks], healthy.checks.freedom(), context, cusums);
            self.apply_novelty(&mut estimate, novelty, features);
        } else if usable {
            meshless.records.push(Arc::new(features.clone()));
        }
        estimate
    }
}
