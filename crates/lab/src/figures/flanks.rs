//! Figures 7, 8 and 11: wear, mesh relationship and stiffness of one pair of teeth.

use serde::Serialize;

use super::check::{Check, listed};
use super::trend::{departure_from_a_line, highest_at, limits, range, rises};
use flankwatch_gear::{Flank, FlankWear, GearError, GearPair, MeshRelationship, PairStiffness};

/// Number of cells of a flank.
const FLANK_CELLS: usize = 300;
/// Greatest departure from a line, in parts of the range, of an approximately linear relationship.
const NEARLY_LINEAR: f64 = 0.01;
/// Greatest relative rise of the stiffness that counts as slight.
const SLIGHT: f64 = 0.05;

/// One flank from root to tip (Fig. 7).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FlankCurve {
    /// α₁ (driving) or α₁′ (driven) in rad.
    pub alpha_rad: Vec<f64>,
    /// Radius of the unworn point in mm.
    pub radius_mm: Vec<f64>,
    /// Wear depth h along Y in µm.
    pub depth_um: Vec<f64>,
    /// Slope dh/dx.
    pub depth_slope: Vec<f64>,
}

/// One pair of teeth of one wear state.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ToothPair {
    /// Driving and driven flank (Fig. 7).
    pub flanks: [FlankCurve; 2],
    /// α₁ of the points of contact in rad (Fig. 8a).
    pub alpha1_rad: Vec<f64>,
    /// α₁′ of the same in rad.
    pub alpha1_prime_rad: Vec<f64>,
    /// φ₁ in rad (Figs. 8b and 11).
    pub phi1_rad: Vec<f64>,
    /// φ₂ in rad.
    pub phi2_rad: Vec<f64>,
    /// Single-tooth mesh stiffness in N/m (Fig. 11).
    pub stiffness_n_per_m: Vec<f64>,
}

impl ToothPair {
    pub(super) fn compute(pair: &GearPair, wear: &FlankWear) -> Result<Self, GearError> {
        let flank = |i: usize| {
            let points: Vec<_> = Flank::new(&pair.gears[i], wear, i).active_points(FLANK_CELLS).collect();
            FlankCurve {
                alpha_rad: points.iter().map(|point| point.alpha_rad).collect(),
                radius_mm: points.iter().map(|point| point.radius_mm).collect(),
                depth_um: points.iter().map(|point| point.depth_mm * 1e3).collect(),
                depth_slope: points.iter().map(|point| point.depth_slope).collect(),
            }
        };
        let solved = MeshRelationship::solve(pair, wear)?;
        let stiffness = PairStiffness::new(pair, wear);
        let contacts = solved.alpha1_rad.iter().zip(&solved.alpha1_prime_rad);
        Ok(Self {
            flanks: [flank(0), flank(1)],
            stiffness_n_per_m: contacts
                .map(|(alpha1, prime)| stiffness.single_pair_n_per_m(*alpha1, *prime))
                .collect(),
            alpha1_rad: solved.alpha1_rad,
            alpha1_prime_rad: solved.alpha1_prime_rad,
            phi1_rad: solved.phi1_rad,
            phi2_rad: solved.phi2_rad,
        })
    }

    /// Returns the stiffness of the pair alone at φ₁.
    pub(super) fn stiffness_at(&self, phi1_rad: f64) -> Option<f64> {
        highest_at(&self.phi1_rad, &self.stiffness_n_per_m, phi1_rad)
    }
}

impl FlankCurve {
    /// Whether the depth falls from the root to a minimum inside the flank and rises from there to the tip.
    fn falls_then_rises(&self) -> bool {
        let depth = &self.depth_um;
        let Some(least) = (0..depth.len()).min_by(|a, b| depth[*a].total_cmp(&depth[*b])) else {
            return false;
        };
        let inner = least > 0 && least + 1 < depth.len();
        inner
            && depth[..=least].windows(2).all(|two| two[1] <= two[0])
            && depth[least..].windows(2).all(|two| two[1] >= two[0])
    }
}

/// Checks Figs. 7, 8 and 11; the first state is unworn, each further one is more worn.
pub(super) fn checks(states: &[ToothPair]) -> Vec<Check> {
    let worn = &states[1..];
    let column = |values: fn(&ToothPair) -> &[f64]| {
        states.iter().map(|state| range(values(state))).collect::<Vec<_>>()
    };
    let rad = |values: &[f64]| listed(values, |value| format!("{value:.5}")) + " rad";
    let below_first = |values: &[f64]| values[1..].iter().all(|value| *value < values[0]);
    let above_first = |values: &[f64]| values[1..].iter().all(|value| *value > values[0]);
    let mut checks = Vec::new();

    let deepest = worn.iter().map(|state| {
        let [driving, driven] = state.flanks.each_ref().map(|flank| {
            let least = limits(&flank.depth_um).0;
            let last = flank.depth_um.len() - 1;
            format!("{:.1}/{:.1}/{:.1}", flank.depth_um[0], least, flank.depth_um[last])
        });
        format!("{driving} and {driven}")
    });
    checks.push(Check::new(
        7,
        "From root to tip the wear depth first falls, then rises.",
        "on both flanks of every worn state",
        format!("root/least/tip {} µm", listed(deepest, |text| text)),
        worn.iter().flat_map(|state| &state.flanks).all(FlankCurve::falls_then_rises),
    ));

    let bent: Vec<f64> = states
        .iter()
        .map(|state| departure_from_a_line(&state.alpha1_rad, &state.alpha1_prime_rad))
        .collect();
    checks.push(Check::new(
        8,
        "α₁′ is no longer linear in α₁ once the flanks are worn.",
        "greatest departure from a line above 1 % of the range where worn, below it where not",
        listed(&bent, |part| format!("{:.2} %", part * 100.0)),
        bent[0] < NEARLY_LINEAR && bent[1..].iter().all(|part| *part > NEARLY_LINEAR),
    ));
    let alpha1 = column(|state| &state.alpha1_rad);
    checks.push(Check::new(
        8,
        "The range of α₁ that meshes shrinks with respect to perfect flanks.",
        "every worn state below the unworn one",
        rad(&alpha1),
        below_first(&alpha1),
    ));
    let prime = column(|state| &state.alpha1_prime_rad);
    checks.push(Check::new(
        8,
        "The range of α₁′ that meshes shrinks with respect to perfect flanks.",
        "every worn state below the unworn one",
        rad(&prime),
        below_first(&prime),
    ));
    let straight: Vec<f64> =
        states.iter().map(|state| departure_from_a_line(&state.phi1_rad, &state.phi2_rad)).collect();
    checks.push(Check::new(
        8,
        "φ₂ stays approximately linear in φ₁.",
        "greatest departure from a line below 1 % of the range",
        listed(&straight, |part| format!("{:.3} %", part * 100.0)),
        straight.iter().all(|part| *part < NEARLY_LINEAR),
    ));
    let phi1 = column(|state| &state.phi1_rad);
    checks.push(Check::new(
        8,
        "The range of φ₁ over which one pair touches grows with respect to perfect flanks.",
        "every worn state above the unworn one",
        rad(&phi1),
        above_first(&phi1),
    ));
    let phi2 = column(|state| &state.phi2_rad);
    checks.push(Check::new(
        8,
        "The range of φ₂ over which one pair touches grows with respect to perfect flanks.",
        "every worn state above the unworn one",
        rad(&phi2),
        above_first(&phi2),
    ));

    let gains: Vec<f64> = states.iter().map(|state| mean_gain(&states[0], state)).collect();
    checks.push(Check::new(
        11,
        "The single-tooth stiffness over φ₁ rises slightly with wear.",
        "its mean over the unworn pair's φ₁ rises from state to state, by at most 5 % in all",
        listed(&gains, |gain| format!("{:+.2} %", gain * 100.0)),
        rises(&gains) && gains.iter().all(|gain| *gain < SLIGHT),
    ));
    checks.push(Check::new(
        11,
        "The range of φ₁ over which the single pair meshes grows with wear.",
        "from state to state",
        rad(&phi1),
        rises(&phi1),
    ));
    checks
}

/// Relative change of the mean stiffness, over the positions where the unworn pair touches.
fn mean_gain(unworn: &ToothPair, state: &ToothPair) -> f64 {
    let both: Vec<(f64, f64)> = unworn
        .phi1_rad
        .iter()
        .zip(&unworn.stiffness_n_per_m)
        .filter_map(|(phi1, stiffness)| Some((state.stiffness_at(*phi1)?, *stiffness)))
        .collect();
    both.iter().map(|pair| pair.0).sum::<f64>() / both.iter().map(|pair| pair.1).sum::<f64>() - 1.0
}
