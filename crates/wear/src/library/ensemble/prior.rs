//! The prior from which pairs are drawn: the distribution of a machine's unknown properties.
//!
//! | property | not given | given |
//! | --- | --- | --- |
//! | mesh damping ζ | log-uniform 0.03 to 0.5 | log-normal, 25 % |
//! | contact rule | loaded 0.7, threshold 0.3; loaded where rigid flanks would lose contact or vibrate without bound | the described one in at least half of the members |
//! | bore radius | × 0.5 to 1.7 (log-uniform), both gears within 10 % | × 0.75 to 1.9, as webs and hubs are softer or stiffer than a ring with that bore |
//! | support stiffness | × 0.5 to 2 | log-normal, 20 % |
//! | once-per-tooth error | 0 to twice the usual amplitude, any phase | log-normal, 30 %, any phase |
//! | torque | ± 10 % | ± 10 % |
//! | shape of wear | Archard 0.4 (hardness ratio 0.35 to 2.8, pressure exponent 0.85 to 1.25), least at the pitch point 0.6 | the given one within 15 %; in 0.7 of the members where it was not measured |
//!
//! A bore counts as given where the description has it, any other field where it differs from its default,
//! which for supports and errors scales with the size of the pair. The shape that is least at the pitch point
//! has exponents from 1.2 to 4 (log-uniform: sliding grows linearly from the pitch point, the paper draws a
//! parabola), a depth at the pitch point of 0 to 0.7 of the greatest (mostly near 0: nothing slides there), a
//! tip ratio of 0.3 to 1.2, and in 0.3 of the members one gear that wears 0.35 to 2.8 times as fast as the
//! other.

use flankwatch_gear::{
    ContactRule, DynamicsSpec, GearError, GearPair, PairSpec, WearPoint, WearShape, WearSpec,
};

/// Least ratio of root to bore radius at which a gear's body can be modelled.
const MIN_ROOT_TO_BORE: f64 = 1.45;

/// Points of a drawn shape's table on each flank.
const SHAPE_POINTS: usize = 40;

/// Greatest depth in µm of a drawn shape's table, which is scaled later.
const SHAPE_DEPTH_UM: f64 = 100.0;

/// Seed of the sequence; change it only together with the prior's version.
const SEED: u32 = 1;

/// A point of a scrambled Sobol sequence, read coordinate by coordinate: a few hundred points cover the prior
/// more evenly than random ones.
struct Draw {
    number: u32,
    coordinate: u32,
}

impl Draw {
    fn uniform(&mut self) -> f64 {
        self.coordinate += 1;
        f64::from(sobol_burley::sample(self.number, self.coordinate - 1, SEED))
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    fn log_between(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    /// A factor whose logarithm is uniform with this standard deviation.
    fn factor(&mut self, deviation: f64) -> f64 {
        (deviation * 3.0_f64.sqrt() * self.between(-1.0, 1.0)).exp()
    }

    fn chance(&mut self, probability: f64) -> bool {
        self.uniform() < probability
    }
}

/// Drawn pairs with the same gears and wear; they differ in properties that the mesh cycles do not need.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Drawn {
    pub(super) specs: Vec<PairSpec>,
    /// Whether, under load, every pair of teeth deflects independently.
    pub(super) independent_teeth: bool,
}

impl Drawn {
    /// Returns the contact rule, which all of them share.
    pub(super) fn contact(&self) -> Option<ContactRule> {
        self.specs.first().map(|spec| spec.dynamics.contact)
    }
}

/// Makes draw number `draw` around a described pair, with `variants` pairs.
pub(super) fn draw(described: &PairSpec, draw: u32, variants: u32) -> Result<Drawn, GearError> {
    let mut dice = Draw { number: draw, coordinate: 0 };
    let mut spec = described.clone();
    // Neither affects a mesh line while the teeth are in contact.
    spec.errors.long_period_um = Some(0.0);
    spec.errors.random_um = Some(0.0);
    let loaded = match described.dynamics.contact {
        ContactRule::Loaded => 0.7,
        ContactRule::Threshold => 0.5,
    };
    spec.dynamics.contact = if dice.chance(loaded) { ContactRule::Loaded } else { ContactRule::Threshold };
    let independent_teeth = dice.chance(0.5);
    let wear = wear(&mut dice, &described.wear);
    spec = spec.with_torque(dice.between(0.9, 1.1));
    spec.geometry.bore_radius_mm = Some(bores(&mut dice, described)?);
    spec.wear = wear.spec(&spec.resolve()?);
    let coordinate = dice.coordinate;
    let variant = |variant| {
        let mut dice = Draw { number: draw * variants + variant, coordinate };
        let mut spec = spec.clone();
        dynamics(&mut dice, described, &mut spec);
        errors(&mut dice, described, &mut spec);
        spec
    };
    Ok(Drawn { specs: (0..variants).map(variant).collect(), independent_teeth })
}

/// Draws the bore radius of each gear in mm. If it is not given, the root radius is 1.8 to 6 times as large,
/// nearly the range that the fillet foundation's polynomials were fitted for.
fn bores(dice: &mut Draw, described: &PairSpec) -> Result<[f64; 2], GearError> {
    let gears = described.resolve()?.gears;
    let bore = match described.geometry.bore_radius_mm {
        Some(_) => dice.between(0.75, 1.9),
        None => dice.log_between(0.5, 1.7),
    };
    let factors = [bore, bore * dice.between(0.9, 1.1)];
    Ok([0, 1].map(|i| (gears[i].bore_radius_mm * factors[i]).min(gears[i].root_radius_mm / MIN_ROOT_TO_BORE)))
}

fn dynamics(dice: &mut Draw, described: &PairSpec, spec: &mut PairSpec) {
    let usual = DynamicsSpec::default();
    let given = described.dynamics.mesh_damping_ratio;
    let (wide, narrow) = (dice.log_between(0.03, 0.5), given * dice.factor(0.25));
    spec.dynamics.mesh_damping_ratio = if given == usual.mesh_damping_ratio { wide } else { narrow.min(1.0) };
    let stiffness = described.supports().stiffness_n_per_m;
    let (wide, narrow) = (dice.log_between(0.5, 2.0), dice.factor(0.2));
    let is_usual = stiffness == described.usual_supports().stiffness_n_per_m;
    spec.supports.stiffness_n_per_m = Some(stiffness * if is_usual { wide } else { narrow });
}

fn errors(dice: &mut Draw, described: &PairSpec, spec: &mut PairSpec) {
    let given = described.errors().short_period_um;
    let (wide, narrow) = (dice.between(0.0, 2.0), dice.factor(0.3));
    let is_usual = given == described.usual_errors().short_period_um;
    spec.errors.short_period_um = Some(given * if is_usual { wide } else { narrow });
    spec.errors.short_period_phase = dice.between(0.0, 1.0);
}

/// A drawn shape of wear.
enum Wear {
    Given(WearSpec),
    Drawn {
        shape: Shape,
        /// Depth on the driven gear over that on the driving one.
        ratio: f64,
    },
}

impl Wear {
    fn spec(self, pair: &GearPair) -> WearSpec {
        match self {
            Self::Given(spec) => spec,
            Self::Drawn { shape, ratio } => {
                let gears = [1.0, ratio].into_iter().enumerate();
                WearSpec {
                    shape: WearShape::Table,
                    table: gears.flat_map(|(i, scale)| shape.table(pair, i, scale)).collect(),
                    ..WearSpec::default()
                }
            }
        }
    }
}

/// Draws a shape of wear. Every kind of shape uses the same coordinates of the sequence.
fn wear(dice: &mut Draw, described: &WearSpec) -> Wear {
    let is_usual = *described == WearSpec::default();
    let (given, archard, gears_differ) = (dice.chance(0.7), dice.chance(0.4), dice.chance(0.3));
    let ratio = dice.log_between(0.35, 2.8);
    let perturbed = perturbed(dice, described);
    dice.coordinate -= PERTURBED_COORDINATES;
    let floor = 0.7 * dice.between(0.0, 1.0).powi(3);
    // Archard's shape has a pressure exponent instead of tip ratio and floor.
    let third = dice.uniform();
    let shape = Shape { floor, tip_ratio: 0.3 + 0.9 * third, exponent: dice.log_between(1.2, 4.0) };
    if described.measured || (!is_usual && given) {
        let mut spec = perturbed;
        // A given hardness ratio varies by about a tenth.
        spec.hardness_pa[1] *= ratio.powf(0.1);
        return Wear::Given(spec);
    }
    if archard {
        let hardness = described.hardness_pa[0];
        return Wear::Given(WearSpec {
            shape: WearShape::Archard,
            hardness_pa: [hardness, hardness * ratio],
            pressure_exponent: 0.85 + 0.4 * third,
            ..WearSpec::default()
        });
    }
    Wear::Drawn { shape, ratio: if gears_differ { ratio } else { 1.0 } }
}

/// Coordinates that a given shape uses.
const PERTURBED_COORDINATES: u32 = 3;

/// Perturbs the given shape within its measurement error.
fn perturbed(dice: &mut Draw, described: &WearSpec) -> WearSpec {
    let mut wear = described.clone();
    wear.floor = (wear.floor + dice.between(-0.03, 0.03)).clamp(0.0, 1.0);
    wear.tip_ratio = (wear.tip_ratio * dice.factor(0.15)).min(1.0);
    wear.exponent = (wear.exponent * dice.factor(0.15)).max(1.05);
    wear
}

/// Shape with the least wear at the pitch point, growing as a power towards root and tip.
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
            let (end, distance) = if radius_mm < pitch {
                (1.0, (pitch - radius_mm) / (pitch - root))
            } else {
                (self.tip_ratio, (radius_mm - pitch) / (tip - pitch))
            };
            let part = self.floor + (end - self.floor) * distance.clamp(0.0, 1.0).powf(self.exponent);
            WearPoint { gear: index as u32 + 1, radius_mm, depth_um: SHAPE_DEPTH_UM * scale * part.max(0.0) }
        };
        (0..=SHAPE_POINTS).map(point).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::testing::synthetic_library;
    use super::*;

    fn draws(described: &PairSpec) -> Vec<PairSpec> {
        (0..50).flat_map(|i| draw(described, i, 4).unwrap().specs).collect()
    }

    #[test]
    fn properties_not_given_are_drawn_widely() {
        let described = synthetic_library().pair().clone();
        let all = draws(&described);
        let damping: Vec<f64> = all.iter().map(|spec| spec.dynamics.mesh_damping_ratio).collect();
        assert!(damping.iter().any(|z| *z < 0.05) && damping.iter().any(|z| *z > 0.35));
        let loaded = all.iter().filter(|spec| spec.dynamics.contact == ContactRule::Loaded).count();
        assert!((110..170).contains(&loaded), "{loaded}");
        let archard = all.iter().filter(|spec| spec.wear.shape == WearShape::Archard).count();
        assert!((55..105).contains(&archard), "{archard}");
    }

    #[test]
    fn given_properties_are_drawn_around_their_value() {
        let mut described = synthetic_library().pair().clone();
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
    fn a_bore_that_is_not_given_is_drawn_more_widely() {
        let mut described = synthetic_library().pair().clone();
        let spread = |described: &PairSpec| {
            let bores = draws(described).into_iter().filter_map(|spec| spec.geometry.bore_radius_mm);
            let (low, high) =
                bores.fold((f64::MAX, 0.0_f64), |(low, high), [bore, _]| (low.min(bore), high.max(bore)));
            high / low
        };
        let given = spread(&described);
        described.geometry.bore_radius_mm = None;
        let not_given = spread(&described);
        assert!(given < 1.9 / 0.75 && not_given > 3.0, "{given} {not_given}");
    }

    #[test]
    fn a_draw_is_a_function_of_pair_and_number() {
        let described = synthetic_library().pair().clone();
        assert_eq!(draw(&described, 7, 2).unwrap(), draw(&described, 7, 2).unwrap());
        assert_ne!(draw(&described, 7, 2).unwrap(), draw(&described, 8, 2).unwrap());
    }
}
