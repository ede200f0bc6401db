//! Which pairs are drawn: the prior over what nobody knows of a machine.
//!
//! | of the pair | not given | given |
//! | --- | --- | --- |
//! | mesh damping ζ | log-uniform 0.03 to 0.5 | log-normal, 25 % |
//! | contact rule | loaded 0.7, threshold 0.3 | half of the members the described one at least |
//! | bore radius | × 0.75 to 1.9, both gears within 10 % | – |
//! | support stiffness | × 0.5 to 2 | log-normal, 20 % |
//! | once-per-tooth error | 0 to twice the usual amplitude, any phase | log-normal, 30 %, any phase |
//! | torque | ± 10 % | ± 10 % |
//! | shape of wear | Archard 0.4 (hardness ratio ½ to 2), least at the pitch point 0.6 | the given one within 10 %; where it was not measured, in 0.7 of the members |
//!
//! A field counts as given where it differs from its default. The shape that is least at the pitch point has exponents from 1.2 to 4
//! (log-uniform: sliding grows linearly from the pitch point, the paper draws a parabola), a depth at the pitch point of 0 to
//! 0.7 of the greatest (mostly near 0: nothing slides there), a tip ratio of 0.3 to 1.2, and in 0.3 of the members one
//! gear that wears ½ to 2 times as fast as the other.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use flankwatch_gear::{ContactRule, DynamicsSpec, ErrorSpec, GearError, GearPair, PairSpec, SupportSpec, WearPoint, WearShape, WearSpec};

/// Ratio of root to bore radius above which a gear's body can be modelled.
const LEAST_ROOT_TO_BORE: f64 = 1.45;

/// Points of a drawn shape's table on each flank.
const SHAPE_POINTS: usize = 40;

/// Depth in µm of a drawn shape's greatest point: tables are scaled anyway.
const SHAPE_DEPTH_UM: f64 = 100.0;

struct Dice(ChaCha8Rng);

impl Dice {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    fn log_between(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    /// A factor whose logarithm has this standard deviation.
    fn factor(&mut self, deviation: f64) -> f64 {
        let z: f64 = StandardNormal.sample(&mut self.0);
        (deviation * z).exp()
    }

    fn chance(&mut self, probability: f64) -> bool {
        self.0.random::<f64>() < probability
    }
}

/// Draw number `draw` around a described pair.
pub(super) fn draw(described: &PairSpec, draw: u64) -> Result<PairSpec, GearError> {
    let mut dice = Dice(ChaCha8Rng::seed_from_u64(draw));
    let mut spec = described.clone();
    // Neither moves a mesh line while the teeth touch.
    spec.errors.long_period_um = 0.0;
    spec.errors.random_um = 0.0;
    dynamics(&mut dice, described, &mut spec);
    errors(&mut dice, described, &mut spec);
    let torque = dice.between(0.9, 1.1);
    spec.operation.torque_nm *= torque;
    spec.operation.output_torque_nm = spec.operation.output_torque_nm.map(|output| output * torque);
    let roots = described.resolve()?.gears.map(|gear| gear.root_radius_mm);
    let (bore, other) = (dice.between(0.75, 1.9), dice.between(0.9, 1.1));
    for (i, factor) in [bore, bore * other].into_iter().enumerate() {
        let radius = &mut spec.geometry.bore_radius_mm[i];
        *radius = (*radius * factor).min(roots[i] / LEAST_ROOT_TO_BORE);
    }
    let pair = spec.resolve()?;
    spec.wear = wear(&mut dice, &described.wear, &pair);
    Ok(spec)
}

fn dynamics(dice: &mut Dice, described: &PairSpec, spec: &mut PairSpec) {
    let usual = DynamicsSpec::default();
    let given = described.dynamics.mesh_damping_ratio;
    let (wide, narrow) = (dice.log_between(0.03, 0.5), given * dice.factor(0.25));
    spec.dynamics.mesh_damping_ratio = if given == usual.mesh_damping_ratio { wide } else { narrow.min(1.0) };
    let loaded = match described.dynamics.contact {
        ContactRule::Loaded => 0.7,
        ContactRule::Threshold => 0.5,
    };
    spec.dynamics.contact = if dice.chance(loaded) {
        ContactRule::Loaded
    } else {
        ContactRule::Threshold
    };
    let stiffness = described.supports.stiffness_n_per_m;
    let (wide, narrow) = (dice.log_between(0.5, 2.0), dice.factor(0.2));
    let is_usual = stiffness == SupportSpec::default().stiffness_n_per_m;
    spec.supports.stiffness_n_per_m = stiffness * if is_usual { wide } else { narrow };
}

fn errors(dice: &mut Dice, described: &PairSpec, spec: &mut PairSpec) {
    let given = described.errors.short_period_um;
    let (wide, narrow) = (dice.between(0.0, 2.0), dice.factor(0.3));
    let is_usual = given == ErrorSpec::default().short_period_um;
    spec.errors.short_period_um = given * if is_usual { wide } else { narrow };
    spec.errors.short_period_phase = dice.between(0.0, 1.0);
}

fn wear(dice: &mut Dice, described: &WearSpec, pair: &GearPair) -> WearSpec {
    let is_usual = *described == WearSpec::default();
    let keep = dice.chance(0.7);
    if described.measured || (!is_usual && keep) {
        return like(dice, described);
    }
    if dice.chance(0.4) {
        let ratio = dice.log_between(0.5, 2.0);
        let hardness = described.hardness_pa[0];
        return WearSpec {
            shape: WearShape::Archard,
            hardness_pa: [hardness, hardness * ratio],
            ..WearSpec::default()
        };
    }
    let floor = 0.7 * dice.between(0.0, 1.0).powi(3);
    let tip_ratio = dice.between(0.3, 1.2);
    let exponent = dice.log_between(1.2, 4.0);
    let ratio = dice.log_between(0.5, 2.0);
    let ratio = if dice.chance(0.3) { ratio } else { 1.0 };
    let shape = Shape {
        floor,
        tip_ratio,
        exponent,
    };
    WearSpec {
        shape: WearShape::Table,
        table: [1.0, ratio]
            .into_iter()
            .enumerate()
            .flat_map(|(i, scale)| shape.table(pair, i, scale))
            .collect(),
        ..WearSpec::default()
    }
}

/// The given shape, as well as it was measured.
fn like(dice: &mut Dice, described: &WearSpec) -> WearSpec {
    let mut wear = described.clone();
    wear.floor = (wear.floor + dice.between(-0.03, 0.03)).clamp(0.0, 1.0);
    wear.tip_ratio = (wear.tip_ratio * dice.factor(0.08)).min(1.0);
    wear.exponent = (wear.exponent * dice.factor(0.08)).max(1.05);
    wear.hardness_pa[1] *= dice.factor(0.1);
    wear
}

/// Least wear at the pitch point, growing with a power to root and tip.
struct Shape {
    floor: f64,
    tip_ratio: f64,
    exponent: f64,
}

impl Shape {
    fn table(&self, pair: &GearPair, index: usize, scale: f64) -> Vec<WearPoint> {
        let gear = &pair.gears[index];
        let (root, pitch, tip) = (gear.sap_radius_mm, gear.pitch_radius_mm, gear.tip_radius_mm);
        let point = |i: usize| {
            let radius_mm = root + (tip - root) * i as f64 / SHAPE_POINTS as f64;
            let (end, way) = if radius_mm < pitch {
                (1.0, (pitch - radius_mm) / (pitch - root))
            } else {
                (self.tip_ratio, (radius_mm - pitch) / (tip - pitch))
            };
            let part = self.floor + (end - self.floor) * way.clamp(0.0, 1.0).powf(self.exponent);
            WearPoint {
                gear: index as u32 + 1,
                radius_mm,
                depth_um: SHAPE_DEPTH_UM * scale * part.max(0.0),
            }
        };
        (0..=SHAPE_POINTS).map(point).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::testing::made_up_library;
    use super::*;

    fn draws(described: &PairSpec) -> Vec<PairSpec> {
        (0..200).map(|i| draw(described, i).unwrap()).collect()
    }

    #[test]
    fn what_is_not_given_is_drawn_widely() {
        let described = made_up_library().pair().clone();
        let all = draws(&described);
        let damping: Vec<f64> = all.iter().map(|spec| spec.dynamics.mesh_damping_ratio).collect();
        assert!(damping.iter().any(|z| *z < 0.05) && damping.iter().any(|z| *z > 0.35));
        let loaded = all.iter().filter(|spec| spec.dynamics.contact == ContactRule::Loaded).count();
        assert!((110..170).contains(&loaded), "{loaded}");
        let archard = all.iter().filter(|spec| spec.wear.shape == WearShape::Archard).count();
        assert!((55..105).contains(&archard), "{archard}");
    }

    #[test]
    fn what_is_given_is_drawn_around_it() {
        let mut described = made_up_library().pair().clone();
        described.dynamics.mesh_damping_ratio = 0.1;
        described.wear.exponent = 2.0;
        described.wear.measured = true;
        for spec in draws(&described) {
            assert!((0.03..0.3).contains(&spec.dynamics.mesh_damping_ratio));
            assert_eq!(spec.wear.shape, WearShape::Parabolic);
            assert!((1.4..2.8).contains(&spec.wear.exponent));
        }
    }

    #[test]
    fn a_draw_is_a_function_of_pair_and_number() {
        let described = made_up_library().pair().clone();
        assert_eq!(draw(&described, 7).unwrap(), draw(&described, 7).unwrap());
        assert_ne!(draw(&described, 7).unwrap(), draw(&described, 8).unwrap());
    }
}
