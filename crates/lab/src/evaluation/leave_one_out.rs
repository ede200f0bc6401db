//! Leave-one-out validation: runs of one member of the ensemble, estimated with the other groups of members,
//! to test how well the ensemble represents a pair that it does not contain.

use std::sync::Arc;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use super::recorded::RecordedRun;
use super::run::Observation;
use flankwatch_signal::Features;
use flankwatch_wear::library::{Ensemble, MESH_LINES};

/// Healthy records at the start of a run, and the depth of the last one in parts of the greatest.
const HEALTHY: usize = 30;
const LAST_PART: f64 = 0.9;

/// Standard deviations of the logarithms of the path's gains, and of a line from record to record.
const PATH: f64 = 1.0;
const SCATTER: f64 = 0.12;

/// Logarithm of the noise beside a healthy line over the line.
const NOISE: f64 = -3.0;

/// What happens in the runs of members that are left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LeftOutRun {
    /// Records after the healthy ones at the start, at least 2.
    pub records: usize,
    /// Whether wear grows linearly over them, to 90 % of the greatest depth.
    pub is_worn: bool,
}

/// Returns runs of `count` evenly chosen members, each with the ensemble without the group of the member;
/// `count` is less than the number of groups.
pub fn leave_one_out(
    ensemble: &Ensemble,
    count: usize,
    plan: LeftOutRun,
) -> Vec<(RecordedRun, Arc<Ensemble>)> {
    let variants = ensemble.variants();
    let groups = ensemble.groups();
    let run = |index: usize| {
        let group = index * groups / count;
        let number = group * variants + index % variants;
        let run = run_of(ensemble, number, plan);
        (run, Arc::new(ensemble.without_group(group)))
    };
    (0..count).map(run).collect()
}

fn run_of(ensemble: &Ensemble, number: usize, plan: LeftOutRun) -> RecordedRun {
    let depths_um = ensemble.depths_um();
    let mut rng = ChaCha8Rng::seed_from_u64(number as u64);
    let normal = Normal::new(0.0, 1.0).expect("1 is a standard deviation");
    let path: Vec<f64> = (0..MESH_LINES).map(|_| PATH * normal.sample(&mut rng)).collect();
    let last_um = if plan.is_worn { LAST_PART * ensemble.described().max_wear_um() } else { 0.0 };
    let mut record = |index: usize| {
        let part = index.saturating_sub(HEALTHY) as f64 / (plan.records - 1) as f64;
        let wear_um = last_um * part;
        let upper = depths_um.partition_point(|um| *um <= wear_um).clamp(1, depths_um.len() - 1);
        let between = (wear_um - depths_um[upper - 1]) / (depths_um[upper] - depths_um[upper - 1]);
        let mut features = Features::default();
        for (line, gain) in path.iter().enumerate() {
            let [before, after] =
                [upper - 1, upper].map(|depth| f64::from(ensemble.change(number, line, depth)));
            let amplitude = before + between * (after - before) + SCATTER * normal.sample(&mut rng);
            // The powers of noise and line add.
            let seen = 0.5 * ((2.0 * amplitude).exp() + (2.0 * NOISE).exp()).ln();
            let name = format!("ln_mesh_{}", line + 1);
            features.background.insert(name.clone(), gain + NOISE);
            features.values.insert(name, gain + seen);
        }
        Observation { wear_um, features, single: [0.0; 3] }
    };
    let records = (0..HEALTHY + plan.records).map(&mut record).collect();
    RecordedRun { name: format!("member {number}"), records }
}
