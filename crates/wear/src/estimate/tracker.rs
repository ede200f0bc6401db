//! The fold over an asset's records: baseline first, then a probability over wear depths that each record sharpens.

use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::baseline::Baseline;
use super::belief::{Belief, Updated};
use super::chart::Charts;
use super::depth_grid::DepthGrid;
use super::event::{MaintenanceEvent, MaintenanceKind};
use super::hypotheses::{Beginning, Hypotheses};
use super::novelty::{Novelty, judge};
use super::prognosis::{Now, WearHistory};
use super::transition::Growth;
use super::wear::{BaselineProgress, BestState, WearEstimate, WearStatus};
use crate::library::{Ensemble, Library};
use flankwatch_signal::Features;

/// Fewest lines that a comparison is made on.
const LEAST_LINES: usize = 3;

/// An interval of the tracked depth wider than this part of the library says that the records do not tell.
const WIDEST_INTERVAL: f64 = 0.6;

/// [`EstimatorSettings::shape_deviation`] where nobody has measured the shape of the wear: exponents from 2.5 to 6 for 4, tip ratios from 0.4 for 0.7 and floors to
/// 0.3 for 0.05 look like the described shape at 0.66 to 1.4 times their greatest depth.
pub const UNKNOWN_SHAPE: f64 = 0.32;

/// The same where the shape is known.
pub const KNOWN_SHAPE: f64 = 0.0;

/// [`EstimatorSettings::shape_deviation`] of a shape that is known or not.
pub fn shape_deviation(known: bool) -> f64 {
    if known { KNOWN_SHAPE } else { UNKNOWN_SHAPE }
}

/// What a user decides about the estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EstimatorSettings {
    /// Records in the healthy baseline.
    pub baseline_records: u32,
    /// Wear depth in µm that the prognosis is about.
    pub limit_um: Option<f64>,
    /// Standard deviation of the logarithm of the true greatest depth over that of the described shape of wear which changes the vibration alike:
    /// how unsure the described shape is. Wear of another shape looks like the described one at another depth.
    pub shape_deviation: f64,
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
    },
    Tracking(Box<Tracking>),
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Tracking {
    baseline: Baseline,
    carried: Option<Carried>,
    belief: Option<Belief>,
    history: WearHistory,
    #[serde(default)]
    charts: Charts,
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

/// What goes on over a new baseline: what was believed before, and the history of wear.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Carried {
    beginning: Beginning,
    history: WearHistory,
}

/// What follows from the baseline and is worked out again where a state was read.
#[derive(Debug, Clone, Default)]
struct Prepared(Option<Arc<Hypotheses>>);

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
    grid: DepthGrid,
    growth: Growth,
}

impl Tracker {
    /// A tracker for an ensemble of libraries; without one, only the baseline is collected and novelty judged.
    pub fn new(settings: EstimatorSettings, ensemble: Option<Arc<Ensemble>>) -> Self {
        let grid = ensemble
            .as_deref()
            .map(|ensemble| DepthGrid::up_to(ensemble.described().max_wear_um()))
            .unwrap_or_default();
        let growth = Growth::on(grid.depths_um());
        Self {
            settings,
            ensemble,
            grid,
            growth,
        }
    }

    /// The state before the first record.
    pub fn start(&self) -> TrackerState {
        TrackerState(Stage::Collecting {
            records: Vec::new(),
            start: None,
            carried: None,
            meshless: Meshless::default(),
        })
    }

    /// Takes one more record that began at `at`; records and events come in time order.
    pub fn update(&self, state: &mut TrackerState, at: Timestamp, features: &Features) -> WearEstimate {
        match &mut state.0 {
            Stage::Collecting {
                records,
                start,
                carried,
                meshless,
            } => {
                let have = records.len() as u32;
                if self.ensemble.is_some() && !features.has_mesh() {
                    return self.without_mesh(meshless, have, features);
                }
                if let Some(reason) = self.unusable(features) {
                    return self.no_number(WearStatus::NoFeatures, have, reason);
                }
                start.get_or_insert(at);
                records.push(features.clone());
                let (have, need) = (records.len() as u32, self.settings.baseline_records);
                if have >= need {
                    let history = carried
                        .as_ref()
                        .map_or_else(|| WearHistory::from(start.unwrap_or(at)), |carried| carried.history.clone());
                    state.0 = Stage::Tracking(Box::new(Tracking {
                        baseline: Baseline::of(records),
                        carried: carried.take(),
                        belief: None,
                        history,
                        charts: Charts::default(),
                        prepared: Prepared::default(),
                    }));
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

    /// Takes an event: a new baseline is learnt, and unless the gear was replaced, wear goes on from where it was.
    pub fn event(&self, state: &mut TrackerState, event: &MaintenanceEvent) {
        let carried = match (&mut state.0, event.kind) {
            (_, MaintenanceKind::GearReplaced) => None,
            (Stage::Collecting { carried, .. }, _) => carried.take(),
            (Stage::Tracking(tracking), _) => self.carried(tracking),
        };
        state.0 = Stage::Collecting {
            records: Vec::new(),
            start: None,
            carried,
            meshless: Meshless::default(),
        };
    }

    fn carried(&self, tracking: &mut Tracking) -> Option<Carried> {
        let hypotheses = self.prepare(tracking);
        let belief = tracking.belief.as_ref()?;
        Some(Carried {
            beginning: belief.carried(&hypotheses, &self.grid),
            history: tracking.history.clone(),
        })
    }

    /// Why a record cannot be part of the baseline.
    fn unusable(&self, features: &Features) -> Option<&'static str> {
        if features.fault.is_some() {
            return Some("the samples of this record are not what the sensor felt, so it does not count");
        }
        let mesh_line = features.has_mesh();
        if !mesh_line && (self.ensemble.is_some() || features.checks.is_empty()) {
            return Some("the mesh line was not found in this record, so it does not count");
        }
        None
    }

    /// A record without a mesh line while the baseline is collected: such records are no wear's, but as many of them as a baseline has
    /// show what is usual among them.
    fn without_mesh(&self, meshless: &mut Meshless, have: u32, features: &Features) -> WearEstimate {
        let usable = features.fault.is_none() && !features.checks.is_empty();
        let known = meshless.records.len() >= self.settings.baseline_records as usize;
        let mut answer = self.no_number(
            WearStatus::NoFeatures,
            have,
            "the mesh line was not found in this record, so it does not count",
        );
        if known {
            let Meshless { records, charts, prepared } = meshless;
            let make = || Arc::new(Hypotheses::new(&Baseline::of(records), None, &[], None));
            let hypotheses = prepared.0.get_or_insert_with(make);
            let novelty = judge(features, &hypotheses.deviations(features, None), hypotheses.freedom(), charts);
            self.tell_novelty(&mut answer, novelty);
        } else if usable {
            meshless.records.push(features.clone());
        }
        answer
    }

    fn prepare(&self, tracking: &mut Tracking) -> Arc<Hypotheses> {
        let Tracking {
            baseline,
            carried,
            prepared,
            ..
        } = tracking;
        let make = || {
            let beginning = carried.as_ref().map(|carried| &carried.beginning);
            Arc::new(Hypotheses::new(
                baseline,
                self.ensemble.as_deref(),
                self.grid.depths_um(),
                beginning,
            ))
        };
        Arc::clone(prepared.0.get_or_insert_with(make))
    }

    fn track(&self, tracking: &mut Tracking, at: Timestamp, features: &Features) -> WearEstimate {
        let need = self.settings.baseline_records;
        let hypotheses = self.prepare(tracking);
        let Some(ensemble) = self.ensemble.as_deref() else {
            let deviations = hypotheses.deviations(features, None);
            let novelty = judge(features, &deviations, hypotheses.freedom(), &mut tracking.charts);
            let mut answer = self.no_number(
                WearStatus::NoLibrary,
                need,
                "no gear pair is described for this asset, so there is no library to compare with",
            );
            self.tell_novelty(&mut answer, novelty);
            return answer;
        };
        if hypotheses.lines() < LEAST_LINES {
            let reason = format!(
                "{} lines stand above the noise in the baseline, expected at least {LEAST_LINES}: wear cannot be told from this channel",
                hypotheses.lines()
            );
            return self.no_number(WearStatus::NotIdentifiable, need, &reason);
        }
        let belief = match &mut tracking.belief {
            Some(belief) if belief.fits(&hypotheses, &self.grid) => belief,
            other => other.insert(Belief::start(&hypotheses, &self.grid)),
        };
        let compared = hypotheses.compare(features, ensemble, belief.path());
        if compared.lines == 0 {
            let mut answer = self.no_number(WearStatus::NoFeatures, need, "this record has none of the baseline's lines");
            // Less than usual without a mesh line is a machine that stands still.
            let mut deviations = hypotheses.deviations(features, None);
            deviations[1].retain(|deviation| deviation.residual > 0.0);
            let novelty = judge(features, &deviations, hypotheses.freedom(), &mut tracking.charts);
            self.tell_novelty(&mut answer, novelty);
            return answer;
        }
        let best = compared.best(self.grid.depths_um().len());
        let deviations = hypotheses.deviations(features, Some((&compared, best)));
        let novelty = judge(features, &deviations, hypotheses.freedom(), &mut tracking.charts);
        if novelty.outside {
            // What is not wear does not move the estimate of wear.
            let mut answer = self.no_number(WearStatus::OutsideLibrary, need, "");
            self.tell_novelty(&mut answer, novelty);
            return answer;
        }
        let updated = belief.update(&compared, &hypotheses, &self.grid, &self.growth);
        let tracked = belief.probability(&self.grid);
        let probability = belief.spread_probability(&self.grid, self.settings.shape_deviation);
        let member = hypotheses.all[updated.best.0].member;
        let resolved = hypotheses.resolved(&compared, belief.likeliest(&self.grid));
        let [low, median, high] = [0.05, 0.5, 0.95].map(|level| self.grid.quantile_um(&tracked, level));
        let told = high - low <= WIDEST_INTERVAL * ensemble.described().max_wear_um();
        let mut answer = self.answer(ensemble, &probability, &updated, member, told);
        answer.resolved_um = Some(resolved.map(|point| self.grid.depths_um()[point]));
        let half_width = 0.5 * (high - low);
        tracking.history.push(at, median, half_width);
        if let Some(limit_um) = self.settings.limit_um {
            let now = Now {
                at,
                depth_um: median,
                half_width_um: half_width,
            };
            answer.prognosis = tracking.history.prognosis(now, limit_um, self.settings.shape_deviation);
            answer.above_limit = Some(self.grid.probability_above(&probability, limit_um));
        }
        answer.novelty = Some(novelty);
        answer
    }

    /// Puts a record's novelty into an answer without a number.
    fn tell_novelty(&self, answer: &mut WearEstimate, novelty: Novelty) {
        if let Some(fault) = novelty.sensor_fault {
            answer.status = WearStatus::SensorFault;
            answer.reason = fault.words().to_owned();
        } else if let Some(sign) = novelty.machine_sign {
            answer.status = WearStatus::OutsideLibrary;
            answer.reason = match &novelty.lasting {
                Some(check) => format!("{} ({check} has deviated for several records)", sign.words()),
                None => format!("{}: off are {}", sign.words(), most_deviating(&novelty)),
            };
        } else if novelty.outside {
            answer.status = WearStatus::OutsideLibrary;
            let what = match &self.ensemble {
                Some(_) if novelty.lasting.is_some() => "no wear of the library has explained several records well",
                Some(_) => "no wear of the library explains this record",
                None if novelty.lasting.is_some() => "several records have been unlike the healthy ones",
                None => "this record is unlike the healthy ones",
            };
            answer.reason = format!("{what}: off are {}", most_deviating(&novelty));
        }
        answer.novelty = Some(novelty);
    }

    fn answer(&self, ensemble: &Ensemble, probability: &[f64], updated: &Updated, member: usize, told: bool) -> WearEstimate {
        let library = ensemble.described();
        let quantile = |level| self.grid.quantile_um(probability, level);
        let (p05, median, p95) = (quantile(0.05), quantile(0.5), quantile(0.95));
        let (status, reason) = if told {
            (
                WearStatus::Estimated,
                format!("wear {median:.0} µm, between {p05:.0} and {p95:.0} µm with 90 % probability"),
            )
        } else {
            (
                WearStatus::NotIdentifiable,
                format!("wear anywhere between {p05:.0} and {p95:.0} µm explains the records"),
            )
        };
        let mut answer = self.no_number(status, self.settings.baseline_records, &reason);
        answer.median_um = Some(median);
        answer.mean_um = Some(self.grid.mean_um(probability));
        answer.p05_um = Some(p05);
        answer.p25_um = Some(quantile(0.25));
        answer.p75_um = Some(quantile(0.75));
        answer.p95_um = Some(p95);
        answer.log_evidence = updated.log_evidence.is_finite().then_some(updated.log_evidence);
        answer.best_state = Some(best_state(library, self.grid.depths_um()[updated.best.1], member));
        answer.posterior = Some(self.grid.posterior(probability));
        answer
    }

    fn no_number(&self, status: WearStatus, have: u32, reason: &str) -> WearEstimate {
        let baseline = BaselineProgress {
            have,
            need: self.settings.baseline_records,
        };
        let ensemble = self.ensemble.as_ref();
        WearEstimate {
            library_id: ensemble.map(|ensemble| ensemble.described().id().to_owned()),
            ensemble_id: ensemble.map(|ensemble| ensemble.id().to_owned()),
            ..WearEstimate::without_number(status, reason.to_owned(), baseline)
        }
    }
}

/// The features that deviate most, in words.
fn most_deviating(novelty: &Novelty) -> String {
    let most = novelty.most.iter();
    let most = most.map(|d| format!("{} by a factor of {:.2}", d.feature, d.ln_ratio.exp()));
    most.collect::<Vec<_>>().join(", ")
}

/// The library state nearest to a depth.
fn best_state(library: &Library, wear_um: f64, member: usize) -> BestState {
    let far = |index: &usize| (library.states()[*index].wear_um - wear_um).abs();
    let index = (0..library.states().len()).min_by(|a, b| far(a).total_cmp(&far(b))).unwrap_or(0);
    BestState {
        index,
        wear_um: library.states()[index].wear_um,
        member,
    }
}

#[cfg(test)]
mod tests;
