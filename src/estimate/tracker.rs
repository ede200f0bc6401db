//! The fold over an asset's records: baseline first, then a probability over wear depths that each record sharpens.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::baseline::Baseline;
use super::depth_grid::DepthGrid;
use super::likelihood::Likelihood;
use super::shape_spread::spread;
use super::transition::advance;
use super::wear::{BaselineProgress, BestState, WearEstimate, WearStatus};
use crate::library::Library;
use crate::signal::{Features, PREPROCESSING};

/// Identifier of the estimator.
pub const METHOD: &str = "grid-filter-1";

/// Weight of one record's log-likelihood. What is wrong with a library is wrong in the same way in one record after the other;
/// counting every record in full would make the interval shrink although nothing new is learnt.
const RECORD_WEIGHT: f64 = 0.1;

/// Fewest features that a comparison is made on.
const LEAST_FEATURES: usize = 3;

/// An interval wider than this part of the library says that the records do not tell.
const WIDEST_INTERVAL: f64 = 0.6;

/// What a user decides about the estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EstimatorSettings {
    /// Records in the healthy baseline.
    pub baseline_records: u32,
}

/// What is known after the records so far; an exact copy in JSON continues with the same bits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrackerState(Stage);

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Stage {
    Collecting { records: Vec<Features> },
    Tracking { baseline: Baseline, probability: Vec<f64> },
}

/// Estimates the wear of one measuring channel by folding over its records in time order.
#[derive(Debug)]
pub struct Tracker {
    settings: EstimatorSettings,
    library: Option<Arc<Library>>,
    grid: DepthGrid,
}

impl Tracker {
    /// A tracker for a library; without one, only the baseline is collected.
    pub fn new(settings: EstimatorSettings, library: Option<Arc<Library>>) -> Self {
        let grid = library.as_deref().map(DepthGrid::of).unwrap_or_default();
        Self { settings, library, grid }
    }

    /// The state before the first record.
    pub fn start(&self) -> TrackerState {
        TrackerState(Stage::Collecting { records: Vec::new() })
    }

    /// Takes one more record; records come in time order.
    pub fn update(&self, state: &mut TrackerState, features: &Features) -> WearEstimate {
        let need = self.settings.baseline_records;
        match &mut state.0 {
            Stage::Collecting { records } => {
                if !features.values.contains_key("ln_mesh_1") {
                    let have = records.len() as u32;
                    return self.no_number(
                        WearStatus::NoFeatures,
                        have,
                        "the mesh line was not found in this record, so it does not count",
                    );
                }
                records.push(features.clone());
                let have = records.len() as u32;
                if have >= need {
                    let baseline = Baseline::of(records);
                    let probability = self.grid.prior();
                    state.0 = Stage::Tracking { baseline, probability };
                }
                self.no_number(
                    WearStatus::CollectingBaseline,
                    have,
                    &format!("collecting baseline, {have} of {need}"),
                )
            }
            Stage::Tracking { baseline, probability } => match &self.library {
                None => self.no_number(
                    WearStatus::NoLibrary,
                    need,
                    "no gear pair is described for this asset, so there is no library to compare with",
                ),
                Some(library) => self.compare(library, baseline, probability, features),
            },
        }
    }

    fn compare(&self, library: &Library, baseline: &Baseline, probability: &mut Vec<f64>, features: &Features) -> WearEstimate {
        let need = self.settings.baseline_records;
        let likelihood = Likelihood::new(baseline, library, self.grid.depths_um());
        if likelihood.features() < LEAST_FEATURES {
            let reason = format!(
                "{} features stand above the noise in the baseline, expected at least {LEAST_FEATURES}: wear cannot be told from this channel",
                likelihood.features()
            );
            return self.no_number(WearStatus::NotIdentifiable, need, &reason);
        }
        let Some(log_likelihood) = likelihood.of(features) else {
            return self.no_number(WearStatus::NoFeatures, need, "this record has none of the baseline's features");
        };
        let predicted = advance(probability, self.grid.step_um());
        let best = argmax(&log_likelihood);
        let peak = log_likelihood[best];
        let evidence: f64 = predicted.iter().zip(&log_likelihood).map(|(p, l)| p * (l - peak).exp()).sum();
        let weighted: Vec<f64> = predicted
            .iter()
            .zip(&log_likelihood)
            .map(|(p, l)| p * (RECORD_WEIGHT * (l - peak)).exp())
            .collect();
        let total: f64 = weighted.iter().sum();
        // Where nothing of the prediction is left (underflow), the record contradicts the whole history; the history stays.
        *probability = if total > 0.0 {
            weighted.iter().map(|p| p / total).collect()
        } else {
            predicted
        };
        self.answer(library, &spread(probability), best, evidence.ln() + peak)
    }

    fn answer(&self, library: &Library, probability: &[f64], best: usize, log_evidence: f64) -> WearEstimate {
        let quantile = |level| self.grid.quantile_um(probability, level);
        let (p05, median, p95) = (quantile(0.05), quantile(0.5), quantile(0.95));
        let mean = self.grid.mean_um(probability);
        let told = p95 - p05 <= WIDEST_INTERVAL * library.max_wear_um();
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
        let index = DepthGrid::nearest_state(best);
        let need = self.settings.baseline_records;
        WearEstimate {
            status,
            reason,
            baseline: BaselineProgress { have: need, need },
            median_um: Some(median),
            mean_um: Some(mean),
            p05_um: Some(p05),
            p95_um: Some(p95),
            log_evidence: log_evidence.is_finite().then_some(log_evidence),
            best_state: Some(BestState {
                index,
                wear_um: library.states()[index].wear_um,
            }),
            library_id: Some(library.id().to_owned()),
            method: method(),
            posterior: Some(DepthGrid::by_library_state(library, probability)),
        }
    }

    fn no_number(&self, status: WearStatus, have: u32, reason: &str) -> WearEstimate {
        WearEstimate {
            status,
            reason: reason.to_owned(),
            baseline: BaselineProgress {
                have,
                need: self.settings.baseline_records,
            },
            median_um: None,
            mean_um: None,
            p05_um: None,
            p95_um: None,
            log_evidence: None,
            best_state: None,
            library_id: self.library.as_ref().map(|library| library.id().to_owned()),
            method: method(),
            posterior: None,
        }
    }
}

fn method() -> String {
    format!("{METHOD}/{PREPROCESSING}")
}

fn argmax(values: &[f64]) -> usize {
    values
        .iter()
        .enumerate()
        .fold(0, |best, (i, value)| if *value > values[best] { i } else { best })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    use super::*;
    use crate::library::testing::made_up_library;

    const NEED: u32 = 20;

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
        Features { values, background }
    }

    fn tracker(library: &Arc<Library>) -> Tracker {
        Tracker::new(EstimatorSettings { baseline_records: NEED }, Some(library.clone()))
    }

    /// A run from 0 to 240 µm: the estimates after the baseline, with the truth.
    fn run(library: &Arc<Library>, records: usize, seed: u64) -> Vec<(WearEstimate, f64)> {
        let tracker = tracker(library);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut state = tracker.start();
        for _ in 0..NEED {
            tracker.update(&mut state, &seen(library, 0.0, 0.05, &mut rng));
        }
        (0..records)
            .map(|i| {
                let truth = 240.0 * i as f64 / (records - 1) as f64;
                (tracker.update(&mut state, &seen(library, truth, 0.05, &mut rng)), truth)
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
            let wear = tracker.update(&mut state, &seen(&library, 0.0, 0.05, &mut rng));
            assert_eq!((wear.status, wear.median_um), (WearStatus::CollectingBaseline, None));
            assert_eq!(wear.reason, format!("collecting baseline, {have} of {NEED}"));
        }
        let wear = tracker.update(&mut state, &seen(&library, 0.0, 0.05, &mut rng));
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
            let expected = tracker.update(&mut state, &features);
            assert_eq!(tracker.update(&mut copy, &features), expected);
            assert_eq!(copy, state);
        }
    }

    #[test]
    fn a_record_without_its_mesh_line_is_not_counted_into_the_baseline() {
        let tracker = Tracker::new(EstimatorSettings { baseline_records: NEED }, None);
        let mut state = tracker.start();
        let wear = tracker.update(&mut state, &Features::default());
        assert_eq!((wear.status, wear.baseline.have), (WearStatus::NoFeatures, 0));
    }

    #[test]
    fn without_a_library_the_answer_says_so() {
        let library = made_up_library();
        let tracker = Tracker::new(EstimatorSettings { baseline_records: NEED }, None);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut state = tracker.start();
        for _ in 0..NEED {
            tracker.update(&mut state, &seen(&library, 0.0, 0.05, &mut rng));
        }
        assert_eq!(
            tracker.update(&mut state, &seen(&library, 0.0, 0.05, &mut rng)).status,
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
            tracker.update(&mut state, &drowned(&mut rng));
        }
        let wear = tracker.update(&mut state, &drowned(&mut rng));
        assert_eq!((wear.status, wear.median_um), (WearStatus::NotIdentifiable, None));
    }
}
