//! Accuracy of the wear estimate on runs to failure with known true wear: with the library's physics and with
//! others, and with faults that are not wear.

mod bank;
mod case;
mod fault;
mod forecast;
mod leave_one_out;
mod recorded;
mod run;
mod score;
mod sensor;
mod single_indicators;
mod uneven_teeth;

use std::sync::Arc;

use jiff::{SignedDuration, Timestamp};
use rayon::prelude::*;

pub use bank::{Bank, BankPlan};
pub use case::{Aim, Case, CaseGroup};
pub use fault::Fault;
pub use forecast::{Forecast, ForecastScore};
pub use leave_one_out::{LeftOutRun, leave_one_out};
pub use recorded::{
    HindsightScore, RecordEstimate, RecordedRun, RunOptions, RunScore, ScoreAfter, estimate_channels,
    estimate_run, look_back, score_run,
};
pub use run::{Observation, RunShape, observe};
pub use score::{NOMINAL, Score};
pub use single_indicators::{SingleIndicators, single_indicators};

use flankwatch_gear::GearError;
use flankwatch_wear::estimate::{
    EstimatorSettings, SensorFault, SuspectedFault, Tracker, WearEstimate, WearStatus,
};
use flankwatch_wear::library::Ensemble;
use score::ScoredRecord;

/// Part of its stiffness that a cracked tooth has lost, at the middle of its mesh period.
const CRACK_LOSS: f64 = 0.5;

/// Final wear of runs with a fault, in parts of the library's greatest depth, and part of their records
/// before the fault.
const FAULT_WEAR: f64 = 0.25;
const BEFORE_FAULT: f64 = 0.6;

/// Number of records from the fault's first one on.
const AFTER_FAULT: usize = 20;

/// Settings of the evaluation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EvaluationSettings {
    /// Runs of each case.
    pub runs: usize,
    /// Records of each run.
    pub records: usize,
    /// Worn states of a case's bank.
    pub states: usize,
    /// First seed of paths and noise.
    pub seed: u64,
}

impl Default for EvaluationSettings {
    fn default() -> Self {
        Self { runs: 200, records: 300, states: 600, seed: 1 }
    }
}

/// Records in the baseline.
const BASELINE: usize = 20;

/// Length of a record in seconds, sampling rate in hertz, signal-to-noise ratio in dB, and variation of the
/// speed within a record, of the speed between records and of the torque.
const SECONDS: f64 = 1.0;
const RATE_HZ: f64 = 20_000.0;
const SNR_DB: f64 = 10.0;
const WANDER: f64 = 0.005;
const SPEED_VARIATION: f64 = 0.03;
const TORQUE_VARIATION: f64 = 0.1;

/// Simulates a case's runs and scores the estimates with an ensemble.
///
/// # Errors
/// [`GearError`] where the gear model rejects the case's pair.
pub fn evaluate(
    case: &Case,
    ensemble: &Arc<Ensemble>,
    settings: &EvaluationSettings,
) -> Result<Score, GearError> {
    let max_wear_um = ensemble.described().max_wear_um();
    let (fault, last_wear_um) = match case.aim {
        Aim::OwnPhysics | Aim::OtherPhysics => (None, max_wear_um),
        Aim::Healthy => (None, 0.0),
        Aim::Fault(fault) => (Some(fault), FAULT_WEAR * max_wear_um),
    };
    let mut plan = BankPlan {
        pair: case.pair.clone(),
        worn: if last_wear_um > 0.0 { settings.states } else { 1 },
        healthy: (settings.states / 8).max(40),
        seconds: SECONDS + sensor::SETTLING_S + sensor::MARGIN_S,
        sample_rate_hz: RATE_HZ,
        max_wear_um: if last_wear_um > 0.0 { last_wear_um } else { max_wear_um },
        speed_variation: SPEED_VARIATION,
        torque_variation: TORQUE_VARIATION,
        weak_tooth: None,
        seed: settings.seed.wrapping_mul(1_000_003),
    };
    let cracked = fault == Some(Fault::CrackedTooth);
    if cracked {
        // Use the same integrator before and after the crack.
        plan.weak_tooth = Some(0.0);
    }
    let bank = Bank::build(plan.clone())?;
    let faulty = if cracked {
        plan.weak_tooth = Some(CRACK_LOSS);
        Some(Bank::build(plan)?)
    } else {
        None
    };
    let fault_from = fault.map(|_| (BEFORE_FAULT * settings.records as f64) as usize);
    let shape = RunShape {
        records: settings.records,
        drawn: fault_from.map_or(settings.records, |first| first + AFTER_FAULT),
        seconds: SECONDS,
        snr_db: SNR_DB,
        wander: WANDER,
        last_wear_um,
        fault: fault.zip(fault_from),
    };
    let runs: Vec<Vec<ScoredRecord>> = (0..settings.runs)
        .into_par_iter()
        .map(|run| {
            let observations =
                observe(&bank, faulty.as_ref(), &shape, settings.seed.wrapping_add(7919 * (run as u64 + 1)));
            judge(&observations, ensemble, fault_from)
        })
        .collect();
    Ok(Score::of(&case.name, &runs, BASELINE, 0.5 * max_wear_um))
}

/// Estimates wear over one run; `fault_from` is its first record with a fault.
fn judge(
    observations: &[Observation],
    ensemble: &Arc<Ensemble>,
    fault_from: Option<usize>,
) -> Vec<ScoredRecord> {
    let limit_um = 0.8 * ensemble.described().max_wear_um();
    let settings = EstimatorSettings { baseline_records: BASELINE as u32, limit_um: Some(limit_um) };
    let tracker = Tracker::new(settings, Some(Arc::clone(ensemble)));
    let mut state = tracker.start();
    let at = |index: usize| Timestamp::UNIX_EPOCH + SignedDuration::from_hours(index as i64);
    let crossing = observations.iter().position(|observation| observation.wear_um >= limit_um);
    observations
        .iter()
        .enumerate()
        .map(|(index, observation)| {
            let estimate = tracker.update(&mut state, at(index), &observation.features);
            let holds = |crossing: usize| {
                let prognosis = estimate
                    .prognosis
                    .as_ref()
                    .filter(|_| 2 * index >= observations.len() && index < crossing)?;
                Some(prognosis.p05 <= at(crossing) && prognosis.p95.is_none_or(|late| late >= at(crossing)))
            };
            ScoredRecord {
                truth_um: observation.wear_um,
                estimate: median_and_interval(&estimate),
                below_truth: below(&estimate, observation.wear_um),
                verdict: verdict(&estimate),
                faulty: fault_from.is_some_and(|first| index >= first),
                prognosis_holds: crossing.and_then(holds),
                single: observation.single,
            }
        })
        .collect()
}

/// Returns the name of the fault that a flagged record was attributed to.
fn verdict(estimate: &WearEstimate) -> Option<&'static str> {
    if !matches!(estimate.status, WearStatus::OutsideLibrary | WearStatus::SensorFault) {
        return None;
    }
    let novelty = estimate.novelty.as_ref()?;
    let sensor = novelty.sensor_fault.map(|fault| match fault {
        SensorFault::Dead => "dead",
        SensorFault::Clipped => "clipped",
        SensorFault::Gaps => "gaps",
        SensorFault::GainChanged => "gain changed",
        SensorFault::LooseMount => "loose mount",
    });
    let machine = novelty.suspected_fault.map(|fault| match fault {
        SuspectedFault::OneTooth => "one tooth",
        SuspectedFault::ShaftLines => "shaft lines",
        SuspectedFault::ImpulsiveEnergy => "impulses",
        SuspectedFault::BandEnergy => "energy in a band",
    });
    Some(sensor.or(machine).unwrap_or("outside the library"))
}

fn median_and_interval(estimate: &WearEstimate) -> Option<[f64; 3]> {
    Some([estimate.median_um?, estimate.low_um?, estimate.high_um?])
}

/// Returns the probability of less wear than the truth, with each point's probability spread over its cell.
fn below(estimate: &WearEstimate, truth_um: f64) -> Option<f64> {
    let posterior = estimate.posterior.as_ref()?;
    let depths = &posterior.wear_um;
    let mut below = 0.0;
    for (i, p) in posterior.probability.iter().enumerate() {
        let low = if i == 0 { 0.0 } else { 0.5 * (depths[i - 1] + depths[i]) };
        let high = if i + 1 == depths.len() { depths[i] } else { 0.5 * (depths[i] + depths[i + 1]) };
        if high <= truth_um {
            below += p;
        } else if low < truth_um {
            below += p * (truth_um - low) / (high - low);
        }
    }
    Some(below)
}
