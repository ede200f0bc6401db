//! Banks of simulated vibrations, from which many runs are drawn.
//!
//! Simulating hundreds of runs of hundreds of records each would take too long. A bank holds some hundred
//! states of one pair. Each has its own wear depth, torque and speed, evenly spread over the depths and
//! random over the operating range, and its own integrated vibration. States are not interpolated: a record
//! of a run takes a state of about its depth, and that state's depth, torque and speed are the truth.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::uneven_teeth::{self, UnevenTeeth};
use flankwatch_gear::{FlankWear, GearError, MeshCycle, PairSpec, RunSettings};

/// Positions of the mesh cycle that the dynamics use.
const CYCLE_POINTS: usize = 1000;

/// Settings of a bank.
#[derive(Debug, Clone)]
pub struct BankPlan {
    /// The gear pair that is simulated.
    pub pair: PairSpec,
    /// Number of worn states, evenly spread over the depths.
    pub worn: usize,
    /// Number of states without wear.
    pub healthy: usize,
    /// Length of each vibration in seconds.
    pub seconds: f64,
    /// Sampling rate in hertz.
    pub sample_rate_hz: f64,
    /// Greatest depth in µm.
    pub max_wear_um: f64,
    /// The speed of each state lies within this fraction of nominal.
    pub speed_variation: f64,
    /// The torque of each state lies within this fraction of nominal.
    pub torque_variation: f64,
    /// Part of its stiffness that one tooth of the driving gear has lost.
    pub weak_tooth: Option<f64>,
    /// Seed of depths, operating points and random errors.
    pub seed: u64,
}

/// One vibration at the bearings.
#[derive(Debug, Clone)]
pub(super) struct Vibration {
    pub(super) wear_um: f64,
    pub(super) torque_nm: f64,
    pub(super) shaft_speed_hz: f64,
    pub(super) samples: Vec<f32>,
}

/// Simulated vibrations of one pair.
#[derive(Debug, Clone)]
pub struct Bank {
    pub(super) plan: BankPlan,
    pub(super) healthy: Vec<Vibration>,
    /// In rising order of wear.
    pub(super) worn: Vec<Vibration>,
}

impl Bank {
    /// Simulates all states, in parallel; the result depends on the plan alone.
    pub fn build(plan: BankPlan) -> Result<Self, GearError> {
        let draw = |index: usize| {
            let mut rng = ChaCha8Rng::seed_from_u64(plan.seed);
            rng.set_stream(index as u64);
            let part = |rng: &mut ChaCha8Rng, width: f64| 1.0 + width * (2.0 * rng.random::<f64>() - 1.0);
            let speed = part(&mut rng, plan.speed_variation);
            let torque = part(&mut rng, plan.torque_variation);
            let depth = (index as f64 + rng.random::<f64>()) / plan.worn as f64 * plan.max_wear_um;
            (depth, torque, speed, rng.random::<u64>(), rng.random::<f64>())
        };
        let simulate = |index: usize, worn: bool| {
            let (depth_um, torque, speed, seed, phase) = draw(index);
            let wear_um = if worn { depth_um } else { 0.0 };
            let pair = plan.pair.with_torque(torque).resolve()?;
            let cycle =
                MeshCycle::compute(&pair, &FlankWear::from_shape(&pair, wear_um * 1e-3)?, CYCLE_POINTS)?;
            let run = RunSettings {
                sample_rate_hz: plan.sample_rate_hz,
                seconds: plan.seconds,
                shaft_speed_hz: plan.pair.operation.shaft_speed_hz * speed,
                torque_nm: pair.spec.operation.torque_nm,
                seed,
                start_phase_turns: phase,
            };
            let samples = match plan.weak_tooth {
                None => flankwatch_gear::simulate(&pair, &cycle, &run)?,
                Some(loss) => {
                    let teeth = UnevenTeeth { loss, ..UnevenTeeth::default() };
                    uneven_teeth::simulate(&pair, &cycle, &run, teeth)
                }
            };
            Ok(Vibration {
                wear_um,
                torque_nm: run.torque_nm,
                shaft_speed_hz: run.shaft_speed_hz,
                samples: samples.into_iter().map(|a| a as f32).collect(),
            })
        };
        let worn = (0..plan.worn)
            .into_par_iter()
            .map(|index| simulate(index, true))
            .collect::<Result<Vec<_>, GearError>>()?;
        let healthy = (0..plan.healthy)
            .into_par_iter()
            .map(|index| simulate(plan.worn + index, false))
            .collect::<Result<Vec<_>, GearError>>()?;
        Ok(Self { plan, healthy, worn })
    }

    /// Returns one of the states near this depth, at random, but none below `least_um`.
    pub(super) fn near(&self, wear_um: f64, least_um: f64, rng: &mut impl RngExt) -> &Vibration {
        let first = self.worn.partition_point(|state| state.wear_um < least_um);
        let at = self.worn.partition_point(|state| state.wear_um < wear_um);
        let (low, high) = (at.saturating_sub(2).max(first), (at + 2).min(self.worn.len()));
        if wear_um <= 0.0 || self.worn.is_empty() {
            return &self.healthy[rng.random_range(0..self.healthy.len())];
        }
        if low >= high {
            return &self.worn[first.min(self.worn.len() - 1)];
        }
        &self.worn[rng.random_range(low..high)]
    }
}
