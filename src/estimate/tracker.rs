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
use crate::signal::{Features, PREPROCESSING};

/// Identifier of the estimator.
pub const METHOD: &str = "path-filter-1";

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
                if self.ensemble.is_some() && !features.values.contains_key("ln_mesh_1") {
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
        let mesh_line = features.values.contains_key("ln_mesh_1");
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
                Some(_) => "no wear of the library explains this record",
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
            ..WearEstimate::without_number(status, reason.to_owned(), baseline, format!("{METHOD}/{PREPROCESSING}"))
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
mod tests {
    use std::collections::BTreeMap;

    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    use super::super::novelty::MachineSign;
    use super::*;
    use crate::library::testing::made_up_library;

    const NEED: u32 = 20;

    fn settings() -> EstimatorSettings {
        EstimatorSettings {
            baseline_records: NEED,
            limit_um: Some(200.0),
            shape_deviation: KNOWN_SHAPE,
        }
    }

    /// Features that the made-up library gives at a wear depth, seen through a path with its own gain per line, with noise.
    fn seen(library: &Library, wear_um: f64, noise: f64, rng: &mut ChaCha8Rng) -> Features {
        let states = library.states();
        let step = library.max_wear_um() / (states.len() - 1) as f64;
        let lower = ((wear_um / step) as usize).min(states.len() - 2);
        let part = wear_um / step - lower as f64;
        let scatter = Normal::new(0.0, noise).unwrap();
        let values: BTreeMap<String, f64> = states[lower]
            .features
            .values
            .iter()
            .enumerate()
            .map(|(i, (name, low))| {
                let high = states[lower + 1].features.values[name];
                let path_gain = (i as f64 * 1.7).sin();
                (name.clone(), low + part * (high - low) + path_gain + scatter.sample(rng))
            })
            .collect();
        let background = values.keys().map(|name| (name.clone(), -6.0)).collect();
        Features {
            values,
            background,
            ..Features::default()
        }
    }

    fn tracker(library: &Arc<Library>) -> Tracker {
        Tracker::new(settings(), Some(Arc::new(Ensemble::of(library.clone()))))
    }

    /// A run from 0 to 240 µm: the estimates after the baseline, with the truth.
    fn run(library: &Arc<Library>, records: usize, seed: u64) -> Vec<(WearEstimate, f64)> {
        let tracker = tracker(library);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut state = tracker.start();
        for _ in 0..NEED {
            tracker.update(&mut state, Timestamp::UNIX_EPOCH, &seen(library, 0.0, 0.05, &mut rng));
        }
        (0..records)
            .map(|i| {
                let truth = 240.0 * i as f64 / (records - 1) as f64;
                (
                    tracker.update(&mut state, Timestamp::UNIX_EPOCH, &seen(library, truth, 0.05, &mut rng)),
                    truth,
                )
            })
            .collect()
    }

    #[test]
    fn the_baseline_is_counted_and_no_number_is_claimed_meanwhile() {
        let library = Arc::new(made_up_library());
        let tracker = tracker(&library);
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut state = tracker.start();
        for have in 1..=NEED {
            let wear = tracker.update(&mut state, Timestamp::UNIX_EPOCH, &seen(&library, 0.0, 0.05, &mut rng));
            assert_eq!((wear.status, wear.median_um), (WearStatus::CollectingBaseline, None));
            assert_eq!(wear.reason, format!("collecting baseline, {have} of {NEED}"));
        }
        let wear = tracker.update(&mut state, Timestamp::UNIX_EPOCH, &seen(&library, 0.0, 0.05, &mut rng));
        assert_eq!(wear.status, WearStatus::Estimated);
        assert!(wear.p05_um.unwrap() <= 2.0 && wear.p95_um.unwrap() < 40.0, "{}", wear.reason);
    }

    #[test]
    fn a_run_through_an_unknown_path_is_followed_and_its_interval_holds_the_truth() {
        let library = Arc::new(made_up_library());
        let mut error_um = 0.0;
        let mut covered = 0;
        let mut count = 0;
        for seed in 0..5 {
            for (wear, truth) in run(&library, 200, seed) {
                error_um += (wear.median_um.unwrap() - truth).abs();
                covered += usize::from((wear.p05_um.unwrap()..=wear.p95_um.unwrap()).contains(&truth));
                count += 1;
            }
        }
        let (error_um, coverage) = (error_um / f64::from(count), covered as f64 / f64::from(count));
        assert!(error_um < 10.0, "mean error {error_um} µm");
        assert!(coverage >= 0.85, "the 90 % interval holds the truth in {coverage} of the records");
    }

    #[test]
    fn a_copy_in_json_goes_on_with_the_same_bits() {
        let library = Arc::new(made_up_library());
        let tracker = tracker(&library);
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut state = tracker.start();
        for i in 0..60 {
            let features = seen(&library, f64::from(i), 0.05, &mut rng);
            let mut copy: TrackerState = serde_json::from_str(&serde_json::to_string(&state).unwrap()).unwrap();
            let expected = tracker.update(&mut state, Timestamp::UNIX_EPOCH, &features);
            assert_eq!(tracker.update(&mut copy, Timestamp::UNIX_EPOCH, &features), expected);
            assert_eq!(copy, state);
        }
    }

    #[test]
    fn a_record_without_its_mesh_line_is_not_counted_into_the_baseline() {
        let tracker = Tracker::new(settings(), None);
        let mut state = tracker.start();
        let wear = tracker.update(&mut state, Timestamp::UNIX_EPOCH, &Features::default());
        assert_eq!((wear.status, wear.baseline.have), (WearStatus::NoFeatures, 0));
    }

    #[test]
    fn without_a_library_the_answer_says_so() {
        let library = made_up_library();
        let tracker = Tracker::new(settings(), None);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut state = tracker.start();
        for _ in 0..NEED {
            tracker.update(&mut state, Timestamp::UNIX_EPOCH, &seen(&library, 0.0, 0.05, &mut rng));
        }
        assert_eq!(
            tracker
                .update(&mut state, Timestamp::UNIX_EPOCH, &seen(&library, 0.0, 0.05, &mut rng))
                .status,
            WearStatus::NoLibrary
        );
    }

    #[test]
    fn lines_in_the_noise_give_no_number() {
        let library = Arc::new(made_up_library());
        let tracker = tracker(&library);
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut state = tracker.start();
        let drowned = |rng: &mut ChaCha8Rng| {
            let mut features = seen(&library, 0.0, 0.05, rng);
            features.background = features.values.clone();
            features
        };
        for _ in 0..NEED {
            tracker.update(&mut state, Timestamp::UNIX_EPOCH, &drowned(&mut rng));
        }
        let wear = tracker.update(&mut state, Timestamp::UNIX_EPOCH, &drowned(&mut rng));
        assert_eq!((wear.status, wear.median_um), (WearStatus::NotIdentifiable, None));
    }

    #[test]
    fn a_replaced_gear_begins_again_and_a_replaced_sensor_goes_on() {
        let library = Arc::new(made_up_library());
        let tracker = tracker(&library);
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let mut state = tracker.start();
        let at = |state: &mut TrackerState, um: f64, rng: &mut ChaCha8Rng| {
            tracker.update(state, Timestamp::UNIX_EPOCH, &seen(&library, um, 0.03, rng))
        };
        for _ in 0..NEED {
            at(&mut state, 0.0, &mut rng);
        }
        let before = (0..120)
            .map(|i| at(&mut state, f64::from(i), &mut rng))
            .last()
            .unwrap()
            .median_um
            .unwrap();
        let event = |kind| MaintenanceEvent {
            time: Timestamp::UNIX_EPOCH,
            kind,
            by: "Ada".to_owned(),
            comment: String::new(),
        };
        for (kind, truth) in [(MaintenanceKind::SensorReplaced, 119.0), (MaintenanceKind::GearReplaced, 0.0)] {
            let mut state = state.clone();
            tracker.event(&mut state, &event(kind));
            for have in 1..=NEED {
                let wear = at(&mut state, truth, &mut rng);
                assert_eq!((wear.status, wear.baseline.have), (WearStatus::CollectingBaseline, have));
            }
            let after = at(&mut state, truth, &mut rng);
            let (low, high) = (after.p05_um.unwrap(), after.p95_um.unwrap());
            assert!(low <= truth && truth <= high, "{kind:?} before {before}: {}", after.reason);
        }
    }

    #[test]
    fn what_wear_does_not_explain_moves_nothing() {
        let library = Arc::new(made_up_library());
        let tracker = tracker(&library);
        let mut rng = ChaCha8Rng::seed_from_u64(13);
        let mut state = tracker.start();
        let record = |shift: f64, rng: &mut ChaCha8Rng| {
            let mut features = seen(&library, 0.0, 0.03, rng);
            let scatter = Normal::new(0.0, 0.03).unwrap();
            for band in 1..=4 {
                features.checks.insert(format!("ln_floor_{band}"), -3.0 + scatter.sample(rng));
                features
                    .checks
                    .insert(format!("ln_rest_{band}"), -2.0 + shift + scatter.sample(rng));
            }
            features
        };
        let belief = |state: &TrackerState| match &state.0 {
            Stage::Tracking(tracking) => (tracking.belief.clone(), tracking.history.clone()),
            Stage::Collecting { .. } => panic!("the baseline is there"),
        };
        let mut take = |state: &mut TrackerState, shift: f64| tracker.update(state, Timestamp::UNIX_EPOCH, &record(shift, &mut rng));
        for _ in 0..NEED {
            take(&mut state, 0.0);
        }
        let calm = take(&mut state, 0.0);
        assert!(!calm.novelty.unwrap().outside);
        let before = belief(&state);
        let other = take(&mut state, 0.8);
        assert_eq!((other.status, other.median_um), (WearStatus::OutsideLibrary, None));
        let novelty = other.novelty.unwrap();
        assert!(
            novelty.score > 4.0 && novelty.machine_sign == Some(MachineSign::BesideMesh),
            "{novelty:?}"
        );
        assert_eq!(belief(&state), before);
    }
}
