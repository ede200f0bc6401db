//! The fold over an asset's records: baseline first, then a probability over wear depths that each record
//! sharpens.

mod answer;

use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::baseline::Baseline;
use super::chart::Charts;
use super::comparability::{go_together, sampled_too_slowly};
use super::depth_grid::DepthGrid;
use super::event::{Inspection, MaintenanceEvent, MaintenanceKind};
use super::filter::{Believed, Filter};
use super::growth::Growth;
use super::healthy_checks::{Drift, Drifting, HealthyChecks};
use super::healthy_lines::{HealthyLines, Measured};
use super::levels::{Levels, is_impulsive};
use super::likelihood::{Anchor, Discrepancy, Likelihood, Reference};
use super::novelty::{Circumstances, Deviation, Novelty, SensorFault, judge};
use super::prognosis::prognosis;
use super::wear::{LibraryLack, WearEstimate, WearStatus};
use crate::library::{DEPTHS, Ensemble, MESH_LINES};
use flankwatch_signal::Features;

/// Fewest lines that a comparison is made on.
const LEAST_LINES: usize = 3;

/// Longest interval between two records in units of growth: what a machine does while nobody records is not
/// known.
const MAX_UNITS: f64 = 100.0;

/// Part of the newest record in the mean of the lines that an inspection is compared with.
const NEWEST_PART: f32 = 0.3;

/// Records in a row whose own best depth lies outside the interval before the search begins anew.
const MAX_DISAGREEING: u8 = 10;

/// Fewest records of a chosen baseline; with fewer it is learnt as any other.
const LEAST_CHOSEN: usize = 8;

/// Most records of a chosen baseline.
const MOST_CHOSEN: usize = 10_000;

/// What a user decides about the estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EstimatorSettings {
    /// Records in the healthy baseline.
    pub baseline_records: u32,
    /// Wear depth in µm that the prognosis is about.
    pub limit_um: Option<f64>,
}

/// What is known after the records so far; an exact copy in JSON continues with the same bits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrackerState(Stage);

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Stage {
    Collecting {
        records: Vec<Features>,
        start: Option<Timestamp>,
        carried: Option<Carried>,
        #[serde(default)]
        meshless: Meshless,
        /// Where people say which records the baseline is.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        chosen: Option<Box<Chosen>>,
    },
    Tracking(Box<Tracking>),
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Tracking {
    baseline: Baseline,
    /// Seconds between two records of the baseline on the mean, and the time of the newest record.
    unit_s: f64,
    newest: Timestamp,
    /// Time of the newest record of all.
    seen: Timestamp,
    drift: Drift,
    filter: Option<Filter>,
    /// By member, the depth at which the baseline was taken; none for a new machine.
    reference: Option<Vec<u8>>,
    anchor: Option<Anchor>,
    /// Mean change of each line over the last records.
    recent: Vec<Option<f32>>,
    disagreeing: u8,
    #[serde(default)]
    charts: Charts,
    #[serde(default)]
    levels: Levels,
    #[serde(skip)]
    prepared: Prepared,
}

/// The records without a mesh line of a channel on which none has been found often enough for a baseline.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct Meshless {
    records: Vec<Features>,
    charts: Charts,
    #[serde(skip)]
    prepared: Prepared,
}

/// A baseline of all records before a time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Chosen {
    until: Timestamp,
    /// The latest of them so far.
    latest: Option<Timestamp>,
}

/// What goes on over a new baseline.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Carried {
    filter: Filter,
}

/// What follows from the baseline.
#[derive(Debug)]
struct Healthy {
    lines: HealthyLines,
    checks: HealthyChecks,
}

/// What follows from the baseline and is worked out again where a state was read.
#[derive(Debug, Clone, Default)]
struct Prepared(Option<Arc<Healthy>>);

impl PartialEq for Prepared {
    /// It says nothing that the baseline does not say.
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

/// Estimates the wear of one measuring channel by folding over its records in time order.
#[derive(Debug)]
pub struct Tracker {
    settings: EstimatorSettings,
    ensemble: Option<Arc<Ensemble>>,
    lack: LibraryLack,
    /// Whether more members of the ensemble follow.
    is_provisional: bool,
    grid: DepthGrid,
    growth: Growth,
    discrepancy: Option<Discrepancy>,
}

impl Tracker {
    /// A tracker for an ensemble of libraries; without one, only the baseline is collected and novelty
    /// judged.
    pub fn new(settings: EstimatorSettings, ensemble: Option<Arc<Ensemble>>) -> Self {
        let grid =
            ensemble.as_deref().map(|ensemble| DepthGrid::of(ensemble.depths_um())).unwrap_or_default();
        Self {
            settings,
            growth: Growth::on(grid.depths_um()),
            discrepancy: ensemble.as_deref().map(Discrepancy::of),
            grid,
            ensemble,
            lack: LibraryLack::default(),
            is_provisional: false,
        }
    }

    /// A tracker for the first members of an ensemble whose rest is still simulated: what it answers to a
    /// record is told as provisional, and nothing is called other than wear.
    pub fn provisional(settings: EstimatorSettings, first: Arc<Ensemble>) -> Self {
        Self { is_provisional: true, ..Self::new(settings, Some(first)) }
    }

    /// A tracker while there is no library: as without one, and records are told why.
    pub fn without_library(settings: EstimatorSettings, lack: LibraryLack) -> Self {
        Self { lack, ..Self::new(settings, None) }
    }

    /// The state before the first record.
    pub fn start(&self) -> TrackerState {
        TrackerState(Stage::Collecting {
            records: Vec::new(),
            start: None,
            carried: None,
            meshless: Meshless::default(),
            chosen: None,
        })
    }

    /// Takes one more record that began at `at`; records and events come in time order.
    pub fn update(&self, state: &mut TrackerState, at: Timestamp, features: &Features) -> WearEstimate {
        let mut answer = self.take_record(state, at, features);
        self.lack.tell(&mut answer);
        if self.is_provisional {
            answer.make_provisional();
        }
        answer
    }

    /// The answer to a record that takes no part; the state stays as it is.
    pub fn excluded(&self, state: &TrackerState) -> WearEstimate {
        let have = match &state.0 {
            Stage::Collecting { records, .. } => (records.len() as u32).min(self.settings.baseline_records),
            Stage::Tracking(_) => self.settings.baseline_records,
        };
        let reason = "the record is excluded: it takes no part in the baseline, the estimate and the alarms";
        self.no_number(WearStatus::Excluded, have, reason)
    }

    fn take_record(&self, state: &mut TrackerState, at: Timestamp, features: &Features) -> WearEstimate {
        match &mut state.0 {
            Stage::Collecting { records, start, carried, meshless, chosen } => {
                if let Some(over) = chosen.take_if(|chosen| at >= chosen.until) {
                    if records.len() >= LEAST_CHOSEN {
                        let (began, ended) = (start.unwrap_or(at), over.latest.unwrap_or(at));
                        state.0 =
                            Stage::Tracking(Box::new(self.begin(records, began, ended, carried.take())));
                    }
                    return self.take_record(state, at, features);
                }
                let have = records.len() as u32;
                if self.ensemble.is_some() && !features.has_mesh() {
                    return self.without_mesh(meshless, have, features);
                }
                if let Some(reason) = self.unusable(features) {
                    return self.no_number(WearStatus::NoFeatures, have, reason);
                }
                start.get_or_insert(at);
                if let Some(chosen) = chosen {
                    if records.len() < MOST_CHOSEN {
                        records.push(features.clone());
                        chosen.latest = Some(at);
                    }
                    let reason = format!(
                        "collecting the chosen baseline, {} records of those before {}",
                        records.len(),
                        chosen.until
                    );
                    let have = (records.len() as u32).min(self.settings.baseline_records);
                    return self.no_number(WearStatus::CollectingBaseline, have, &reason);
                }
                records.push(features.clone());
                // Records whose lines and sidebands run together make a baseline of their own.
                let alike = |record: &Features| go_together(record, features);
                let (have, need) = (
                    records.iter().filter(|record| alike(record)).count() as u32,
                    self.settings.baseline_records,
                );
                if have >= need {
                    let began = start.unwrap_or(at);
                    records.retain(alike);
                    state.0 = Stage::Tracking(Box::new(self.begin(records, began, at, carried.take())));
                }
                self.no_number(
                    WearStatus::CollectingBaseline,
                    have,
                    &format!("collecting baseline, {have} of {need}"),
                )
            }
            Stage::Tracking(tracking) => self.track(tracking, at, features),
        }
    }

    /// The tracking after a baseline of these records, which began at `began` and ended at `ended`.
    fn begin(
        &self,
        records: &[Features],
        began: Timestamp,
        ended: Timestamp,
        carried: Option<Carried>,
    ) -> Tracking {
        let intervals = records.len().saturating_sub(1).max(1) as f64;
        let members = self.ensemble.as_ref().map_or(0, |ensemble| ensemble.members().len());
        let filter =
            carried.map(|carried| carried.filter).filter(|filter| filter.fits(members, self.variants()));
        Tracking {
            baseline: Baseline::of(records),
            unit_s: ended.duration_since(began).as_secs_f64().max(0.0) / intervals,
            newest: ended,
            seen: ended,
            drift: Drift::default(),
            reference: filter.as_ref().map(Filter::mean_depths),
            filter,
            anchor: None,
            recent: vec![None; MESH_LINES],
            disagreeing: 0,
            charts: Charts::default(),
            levels: Levels::default(),
            prepared: Prepared::default(),
        }
    }

    /// Takes an event: an inspection says how deep the wear is; else a new baseline is learnt, and unless the
    /// gear was replaced, wear goes on from where it was.
    pub fn event(&self, state: &mut TrackerState, event: &MaintenanceEvent) {
        let carried = match (&mut state.0, event.kind) {
            (Stage::Tracking(tracking), MaintenanceKind::Inspected) => {
                if let Some(inspection) = &event.inspection {
                    self.inspect(tracking, inspection);
                }
                return;
            }
            // Nothing has been compared yet that a depth could tell from.
            (Stage::Collecting { .. }, MaintenanceKind::Inspected) => return,
            (_, MaintenanceKind::GearReplaced | MaintenanceKind::BaselineChosen) => None,
            (Stage::Collecting { carried, .. }, _) => carried.take(),
            (Stage::Tracking(tracking), _) => tracking.filter.take().map(|filter| Carried { filter }),
        };
        state.0 = Stage::Collecting {
            records: Vec::new(),
            start: None,
            carried,
            meshless: Meshless::default(),
            chosen: event.until.map(|until| Box::new(Chosen { until, latest: None })),
        };
    }

    /// Takes a depth that was measured on the teeth.
    fn inspect(&self, tracking: &mut Tracking, inspection: &Inspection) {
        let Some(ensemble) = self.ensemble.as_deref() else {
            return;
        };
        let members = ensemble.members().len();
        let filter = match tracking.filter.take() {
            Some(filter) if filter.fits(members, self.variants()) => filter,
            _ => Filter::start(self.grid.depths_um(), members, self.variants()),
        };
        let filter = tracking.filter.insert(filter);
        let gear = inspection.gear.map(|gear| usize::from(gear.saturating_sub(1)));
        let at_place = |member: &crate::library::Member| member.at_place(gear, inspection.place);
        let likelihood: Vec<f32> = ensemble
            .members()
            .iter()
            .flat_map(|member| {
                let parts = at_place(member);
                let deviates = self.grid.cells().zip(parts).map(|([low, high], part)| {
                    // The error of a cell is the measured one's and the cell's own width.
                    let (middle, width) =
                        (0.5 * (low + high) * f64::from(part), (high - low) * f64::from(part));
                    let variance = inspection.error_um * inspection.error_um + width * width / 12.0;
                    (-0.5 * (inspection.depth_um - middle).powi(2) / variance).exp().max(1e-30) as f32
                });
                deviates.collect::<Vec<_>>()
            })
            .collect();
        filter.inspect(&likelihood);
        tracking.anchor = Some(Anchor {
            depths: Anchor::depths_at(ensemble, inspection.depth_um, gear, inspection.place),
            changes: tracking.recent.clone(),
        });
        tracking.disagreeing = 0;
    }

    /// Why a record cannot be part of the baseline.
    fn unusable(&self, features: &Features) -> Option<&'static str> {
        if features.fault.is_some() {
            return Some("the samples of this record are not what the sensor felt, so it does not count");
        }
        let mesh_line = features.has_mesh();
        if !mesh_line && (self.ensemble.is_some() || features.checks.is_empty()) {
            return Some(match self.lack {
                LibraryLack::NoMesh => "the record is too short to be compared, so it does not count",
                _ => "the mesh line was not found in this record, so it does not count",
            });
        }
        None
    }

    /// A record without a mesh line while the baseline is collected: such records are no wear's, but as many
    /// of them as a baseline has show what is usual among them.
    fn without_mesh(&self, meshless: &mut Meshless, have: u32, features: &Features) -> WearEstimate {
        let usable = features.fault.is_none() && !features.checks.is_empty();
        let known = meshless.records.len() >= self.settings.baseline_records as usize;
        let mut answer =
            self.no_mesh(features, have, "the mesh line was not found in this record, so it does not count");
        if known {
            let Meshless { records, charts, prepared } = meshless;
            let healthy = prepared.0.get_or_insert_with(|| self.healthy(&Baseline::of(records)));
            let circumstances =
                Circumstances { impulsive: healthy.is_impulsive(features), ..Circumstances::default() };
            let checks = healthy.checks_at(features, 0, Drift::default().at(0.0, 1.0));
            let novelty =
                judge(features, &[Vec::new(), checks], healthy.checks.freedom(), circumstances, charts);
            self.tell_novelty(&mut answer, novelty);
        } else if usable {
            meshless.records.push(features.clone());
        }
        answer
    }

    fn healthy(&self, baseline: &Baseline) -> Arc<Healthy> {
        let nominal = match self.ensemble.as_deref() {
            Some(ensemble) => {
                let operation = &ensemble.described().pair().operation;
                [operation.shaft_speed_hz, operation.torque_nm]
            }
            None => [0, 1].map(|i| baseline.points.iter().find_map(|point| point[i]).unwrap_or(1.0)),
        };
        let lines = HealthyLines::new(baseline, nominal);
        let log_speeds = lines.log_speeds(baseline);
        Arc::new(Healthy {
            checks: HealthyChecks::new(baseline, log_speeds, self.ensemble.as_deref(), self.grid.depths_um()),
            lines,
        })
    }

    fn track(&self, tracking: &mut Tracking, at: Timestamp, features: &Features) -> WearEstimate {
        let need = self.settings.baseline_records;
        let Tracking { baseline, prepared, .. } = &mut *tracking;
        let healthy = Arc::clone(prepared.0.get_or_insert_with(|| self.healthy(baseline)));
        let freedom = healthy.checks.freedom();
        if let Some(reason) = tracking.baseline.comparability.refuses(features) {
            return self.no_number(WearStatus::NotComparable, need, &reason);
        }
        let scatter = tracking.baseline.comparability.scatter(features);
        let unmoved = Drift::default();
        let kurtosis = healthy.checks.kurtosis(features, healthy.lines.log_speed(features));
        let impulsive = kurtosis.as_ref().is_some_and(is_impulsive);
        let (Some(ensemble), Some(discrepancy)) = (self.ensemble.as_deref(), &self.discrepancy) else {
            let [healthy_checks, shared] = healthy.checks.shared(features);
            if features.fault.is_none() && 2 * shared < healthy_checks {
                if features.speed_doubt.is_some() {
                    return self.no_mesh(features, need, "");
                }
                let reason = format!(
                    "not comparable with the baseline: it has {shared} of the baseline's {healthy_checks} bands and lines, as another sampling rate or length gives"
                );
                return self.no_number(WearStatus::NotComparable, need, &reason);
            }
            let gained = healthy.checks.gained(features, healthy.lines.log_speed(features));
            let gain = tracking.levels.gain(&gained, kurtosis.as_ref(), freedom);
            let novelty = judge(
                features,
                &[Vec::new(), healthy.checks_at(features, 0, unmoved.at(0.0, 1.0))],
                freedom,
                Circumstances { gain, impulsive, lines_fell: None },
                &mut tracking.charts,
            );
            tracking.learn(&novelty, gain, &gained, kurtosis.as_ref());
            let mut answer = self.no_number(
                WearStatus::NoLibrary,
                need,
                "no gear pair is described for this asset, so there is no library to compare with",
            );
            self.tell_novelty(&mut answer, novelty);
            return answer;
        };
        if healthy.lines.len() < LEAST_LINES {
            let reason = format!(
                "{} lines stand above the noise in the baseline, expected at least {LEAST_LINES}: this channel cannot show wear",
                healthy.lines.len()
            );
            return self.no_number(WearStatus::NotIdentifiable, need, &reason);
        }
        let measured = healthy.lines.measured(features, scatter);
        if measured.lines.len() < LEAST_LINES
            && let Some(speed_hz) = features.operating_point.shaft_speed_hz
        {
            let teeth = f64::from(ensemble.described().pair().geometry.teeth[0]);
            let needed_hz = healthy.lines.rate_needed_hz(LEAST_LINES, teeth * speed_hz);
            if let Some(reason) = sampled_too_slowly(features, needed_hz) {
                return self.no_number(WearStatus::NotComparable, need, &reason);
            }
        }
        if measured.lines.is_empty() {
            let mut answer = self.no_mesh(features, need, "this record has none of the baseline's lines");
            // Less than usual without a mesh line is a machine that stands still.
            let mut checks = healthy.checks_at(features, 0, unmoved.at(0.0, 1.0));
            checks.retain(|deviation| deviation.residual > 0.0);
            let circumstances = Circumstances { impulsive, ..Circumstances::default() };
            let novelty =
                judge(features, &[Vec::new(), checks], freedom, circumstances, &mut tracking.charts);
            self.tell_novelty(&mut answer, novelty);
            return answer;
        }
        let mut gained = healthy.checks.gained(features, healthy.lines.log_speed(features));
        gained.extend(measured.deviations());
        let gain = tracking.levels.gain(&gained, kurtosis.as_ref(), freedom);
        let reference = Reference { depths: tracking.reference.as_deref(), anchor: tracking.anchor.as_ref() };
        let likelihood = discrepancy.compare(ensemble, &measured, reference);
        let apart = measured.apart();
        let unseen = self.units(tracking, tracking.seen, at).max(1.0);
        let lines = discrepancy.deviations(ensemble, &measured, likelihood.best, reference);
        tracking.seen = at.max(tracking.seen);
        let checks = healthy.checks_at(features, likelihood.best.1, tracking.drift.at(apart, unseen));
        let drift = tracking.drift.after(apart, unseen, &checks);
        let mesh_hz = f64::from(ensemble.described().pair().geometry.teeth[0])
            * features.operating_point.shaft_speed_hz.unwrap_or(0.0);
        let circumstances = Circumstances {
            gain,
            impulsive,
            lines_fell: tracking.levels.lines_fell(&gained, &measured.frequencies_hz(mesh_hz)),
        };
        let novelty = judge(features, &[lines, checks], freedom, circumstances, &mut tracking.charts);
        tracking.learn(&novelty, gain, &gained, kurtosis.as_ref());
        if novelty.outside {
            // What is not wear does not move the estimate of wear.
            let mut answer = self.no_number(WearStatus::OutsideLibrary, need, "");
            self.tell_novelty(&mut answer, novelty);
            return answer;
        }
        tracking.drift = drift;
        let believed = self.take(tracking, at, &measured, &likelihood);
        let mut answer = self.answer(ensemble, &believed, &likelihood);
        let median_outside = self.disagrees(&answer, &likelihood);
        tracking.disagreeing = if median_outside { tracking.disagreeing.saturating_add(1) } else { 0 };
        if tracking.disagreeing >= MAX_DISAGREEING && answer.status == WearStatus::Estimated {
            answer.status = WearStatus::NotIdentifiable;
            answer.reason = format!("{}: the last records say otherwise than those before", answer.reason);
        }
        if let Some(limit_um) = self.settings.limit_um {
            answer.prognosis =
                prognosis(&believed.by_rate, self.grid.depths_um(), limit_um, at, tracking.unit_s);
            answer.above_limit = Some(self.grid.probability_above(&believed.by_depth(), limit_um));
        }
        answer.novelty = Some(novelty);
        answer
    }

    /// Whether the depth that explains a record best by itself lies outside the interval.
    fn disagrees(&self, answer: &WearEstimate, likelihood: &Likelihood) -> bool {
        let best_um = self.grid.depths_um()[likelihood.best.1];
        match (answer.p05_um, answer.p95_um) {
            (Some(low), Some(high)) => !(low..=high).contains(&best_um),
            _ => false,
        }
    }

    fn variants(&self) -> usize {
        self.ensemble.as_deref().map_or(1, Ensemble::variants)
    }

    /// Units of growth between two times.
    fn units(&self, tracking: &Tracking, from: Timestamp, to: Timestamp) -> f64 {
        if tracking.unit_s > 0.0 {
            (to.duration_since(from).as_secs_f64() / tracking.unit_s).clamp(0.0, MAX_UNITS)
        } else {
            1.0
        }
    }

    /// Lets wear grow up to a record, and takes it.
    fn take(
        &self,
        tracking: &mut Tracking,
        at: Timestamp,
        measured: &Measured,
        likelihood: &Likelihood,
    ) -> Believed {
        let members = likelihood.log.len() / DEPTHS;
        let units = self.units(tracking, tracking.newest, at);
        tracking.newest = at.max(tracking.newest);
        for line in &measured.lines {
            let recent = &mut tracking.recent[line.index];
            let change = line.change as f32;
            *recent = Some(recent.map_or(change, |mean| mean + NEWEST_PART * (change - mean)));
        }
        let filter = match tracking.filter.take() {
            Some(filter) if filter.fits(members, self.variants()) => filter,
            _ => Filter::start(self.grid.depths_um(), members, self.variants()),
        };
        tracking.filter.insert(filter).update(&self.growth, units * measured.load, likelihood)
    }
}

impl Tracking {
    /// Takes where a record's values stand.
    fn learn(
        &mut self,
        novelty: &Novelty,
        gain: Option<f64>,
        gained: &[Deviation],
        kurtosis: Option<&Deviation>,
    ) {
        if novelty.outside {
            let named = novelty.sensor_fault == Some(SensorFault::GainChanged);
            self.levels.unexplained(gain.filter(|_| named));
        } else {
            self.levels.explained(gained.iter().chain(kurtosis));
        }
    }
}

impl Healthy {
    /// How the values that wear hardly moves deviate from what is expected at a depth of the grid and a
    /// drift.
    fn checks_at(&self, record: &Features, depth: usize, drifting: Drifting<'_>) -> Vec<Deviation> {
        self.checks.deviations(record, self.lines.log_speed(record), depth, drifting)
    }

    /// Whether a record is more impulsive than the healthy ones.
    fn is_impulsive(&self, record: &Features) -> bool {
        let kurtosis = self.checks.kurtosis(record, self.lines.log_speed(record));
        kurtosis.is_some_and(|kurtosis| is_impulsive(&kurtosis))
    }
}

#[cfg(test)]
mod tests;
