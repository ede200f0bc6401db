//! Figures 12 to 15 and 18: load sharing, stiffness and transmission error of the whole mesh.

use std::f64::consts::TAU;

use serde::Serialize;

use super::check::{Check, listed};
use super::flanks::ToothPair;
use super::trend::{falls, highest_at, limits, range, rises};
use flankwatch_gear::{FlankWear, GearError, GearPair, MeshCycle};

/// Points of the mesh period.
const POINTS: usize = 4000;
/// Positions at which one pair is compared with its neighbours.
const PLACES: usize = 1200;
/// Greatest relative change of an amplitude that counts as negligible.
const NEGLIGIBLE: f64 = 0.02;

/// The mesh of one wear state.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Mesh {
    /// φ₁ in rad of the positions at which a pair touches (Figs. 13 and 14).
    pub pair_phi1_rad: Vec<f64>,
    /// Δφ₂ in rad there: lead of the neighbour furthest ahead, negative where this pair leads.
    pub neighbour_lead_rad: Vec<f64>,
    /// Whether the pair carries there under the multi-tooth rule.
    pub carries: Vec<bool>,
    /// Stiffness in N/m of the pair where it touches (Fig. 14).
    pub pair_stiffness_n_per_m: Vec<f64>,
    /// φ₁ in rad over one mesh period, from the nominal start of contact (Figs. 15 and 18).
    pub phi1_rad: Vec<f64>,
    /// Multi-tooth mesh stiffness in N/m (Fig. 15).
    pub stiffness_n_per_m: Vec<f64>,
    /// e_wear in rad, Eq. (31) (Fig. 18a).
    pub e_wear_rad: Vec<f64>,
    /// Number of pairs that carry.
    pub pairs_in_contact: Vec<u32>,
}

impl Mesh {
    pub(super) fn compute(pair: &GearPair, wear: &FlankWear, single: &ToothPair) -> Result<Self, GearError> {
        let cycle = MeshCycle::compute(pair, wear, POINTS)?;
        let pitches = pair.gears.each_ref().map(|gear| gear.pitch_angle_rad());
        let (first, last) = limits(&single.phi1_rad);
        let threshold = pair.spec.dynamics.contact_threshold_rad;
        let mut mesh = Self {
            pair_phi1_rad: Vec::new(),
            neighbour_lead_rad: Vec::new(),
            carries: Vec::new(),
            pair_stiffness_n_per_m: Vec::new(),
            phi1_rad: cycle.phi1_rad,
            stiffness_n_per_m: cycle.stiffness_n_per_m,
            e_wear_rad: cycle.uste_rad,
            pairs_in_contact: cycle.pairs_in_contact,
        };
        let phi2_at = |phi1: f64| highest_at(&single.phi1_rad, &single.phi2_rad, phi1);
        for place in 0..=PLACES {
            let phi1 = first + (last - first) * place as f64 / PLACES as f64;
            let (Some(own), Some(stiffness)) = (phi2_at(phi1), single.stiffness_at(phi1)) else {
                continue;
            };
            let lead = [-2.0, -1.0, 1.0, 2.0]
                .iter()
                .filter_map(|n| Some(phi2_at(phi1 + n * pitches[0])? - n * pitches[1] - own))
                .fold(f64::NEG_INFINITY, f64::max);
            mesh.pair_phi1_rad.push(phi1);
            // Alone, a pair leads by more than any threshold.
            mesh.neighbour_lead_rad.push(lead.max(-1.0));
            mesh.carries.push(lead < threshold);
            mesh.pair_stiffness_n_per_m.push(stiffness);
        }
        Ok(mesh)
    }

    /// Part of the mesh period in which two pairs carry.
    pub(super) fn double_part(&self) -> f64 {
        self.pairs_in_contact.iter().filter(|pairs| **pairs > 1).count() as f64 / POINTS as f64
    }

    /// Range in rad of φ₁ in which a pair of teeth carries.
    fn carried_range_rad(&self) -> f64 {
        let places: Vec<f64> = self
            .pair_phi1_rad
            .iter()
            .zip(&self.carries)
            .filter(|(_, carries)| **carries)
            .map(|(phi1, _)| *phi1)
            .collect();
        range(&places)
    }

    /// Greatest stiffness in N/m where `pairs` carry.
    fn greatest_stiffness(&self, pairs: u32) -> f64 {
        let at = self.stiffness_n_per_m.iter().zip(&self.pairs_in_contact);
        at.filter(|(_, count)| **count == pairs).map(|(k, _)| *k).fold(0.0, f64::max)
    }

    /// Numbers of carrying pairs in their order over the period, without repeats.
    fn sequence(&self) -> Vec<u32> {
        let mut sequence = self.pairs_in_contact.clone();
        sequence.dedup();
        sequence
    }
}

/// Returns turns of the driving shaft over one turn, and the total transmission error in µm along the line of
/// action without its random part (Fig. 18b).
pub(super) fn transmission_error_um(pair: &GearPair, mesh: &Mesh) -> (Vec<f64>, Vec<f64>) {
    let teeth = f64::from(pair.gears[0].teeth);
    let count = 100 * pair.gears[0].teeth as usize;
    let base_um = pair.gears[1].base_radius_mm * 1e3;
    let turns: Vec<f64> = (0..=count).map(|i| i as f64 / count as f64).collect();
    let errors = turns
        .iter()
        .map(|turn| {
            let period = turn * teeth;
            let place = (period.rem_euclid(1.0) * POINTS as f64).round() as usize % POINTS;
            let periodic =
                pair.errors.long_period_um * (TAU * turn).sin() + 1e6 * pair.errors.short_period_m(period);
            periodic + base_um * mesh.e_wear_rad[place]
        })
        .collect();
    (turns, errors)
}

/// Checks Figs. 12 to 15 and 18; the first state is unworn, each further one is more worn.
pub(super) fn checks(pair: &GearPair, states: &[ToothPair], meshes: &[Mesh]) -> Vec<Check> {
    let threshold = pair.spec.dynamics.contact_threshold_rad;
    let period_rad = pair.gears[0].pitch_angle_rad();
    let percent = |values: &[f64]| listed(values, |part| format!("{:.2} %", part * 100.0));
    let mut checks = Vec::new();

    let level = shared(&meshes[0]).map(f64::abs).fold(0.0, f64::max);
    checks.push(Check::new(
        12,
        "With perfect flanks a pair passes through double, single and double contact; in double contact both pairs require the same φ₂.",
        "two parts in the period, and Δφ₂ below a thousandth of the threshold",
        format!(
            "pairs that carry over the period {:?}, Δφ₂ at most {level:.1e} rad",
            meshes[0].sequence()
        ),
        meshes[0].sequence() == [2, 1] && level < 1e-3 * threshold,
    ));

    let apart = shared(&meshes[1]).map(f64::abs).fold(0.0, f64::max);
    checks.push(Check::new(
        13,
        "With wear two pairs that touch at once differ by Δφ₂ (Wear01).",
        "greatest Δφ₂ above the threshold",
        format!("{apart:.2e} rad against {threshold:.0e} rad"),
        apart > threshold,
    ));
    let doubles: Vec<f64> = meshes.iter().map(Mesh::double_part).collect();
    let singles: Vec<f64> = doubles.iter().map(|double| 1.0 - double).collect();
    checks.push(Check::new(
        13,
        "The rule shortens double contact and lengthens single contact (Wear01).",
        "against perfect flanks, as parts of the mesh period",
        format!("double {}; single {}", percent(&doubles[..2]), percent(&singles[..2])),
        doubles[1] < doubles[0],
    ));

    let carried: Vec<f64> = meshes.iter().map(Mesh::carried_range_rad).collect();
    let alone: Vec<f64> = states.iter().map(|state| range(&state.phi1_rad)).collect();
    checks.push(Check::new(
        13,
        "The range of φ₁ in which a pair carries becomes shorter than the one in which it touches (Wear01).",
        "shorter",
        format!("{:.5} of {:.5} rad", carried[1], alone[1]),
        carried[1] < alone[1],
    ));
    let unchanged =
        meshes[1..].iter().zip(&states[1..]).map(|(mesh, state)| greatest_difference(mesh, state));
    let unchanged = unchanged.fold(0.0, f64::max);
    checks.push(Check::new(
        14,
        "The rule changes only the range in which a pair's stiffness counts, not the stiffness.",
        "carried range below the touching one in every worn state; in single contact the mesh is as stiff as the pair to 0.1 %",
        format!(
            "{} rad of {} rad; stiffness differs by {:.4} %",
            listed(&carried[1..], |value| format!("{value:.5}")),
            listed(&alone[1..], |value| format!("{value:.5}")),
            100.0 * unchanged
        ),
        carried[1..].iter().zip(&alone[1..]).all(|(carried, alone)| carried < alone) && unchanged < 1e-3,
    ));

    checks.push(Check::new(
        15,
        "Wear shortens double contact and lengthens single contact.",
        "from state to state, as parts of the mesh period",
        format!(
            "double {} ({} rad of φ₁)",
            percent(&doubles),
            listed(&doubles, |part| format!("{:.4}", part * period_rad))
        ),
        falls(&doubles),
    ));
    let change = |pairs| {
        let unworn = meshes[0].greatest_stiffness(pairs);
        meshes[1..].iter().map(move |mesh| mesh.greatest_stiffness(pairs) / unworn - 1.0).collect::<Vec<_>>()
    };
    let (single, double) = (change(1), change(2));
    let signed = |values: &[f64]| listed(values, |part| format!("{:+.2} %", part * 100.0));
    checks.push(Check::new(
        15,
        "Wear hardly changes the amplitude of the stiffness.",
        "greatest stiffness in single and in double contact within 2 % of perfect flanks",
        format!("single {}; double {}", signed(&single), signed(&double)),
        single.iter().chain(&double).all(|part| part.abs() < NEGLIGIBLE),
    ));

    let joins = meshes[1..].iter().map(join_of_error).fold(0.0, f64::max);
    checks.push(Check::new(
        18,
        "The transmission error of wear repeats with the mesh frequency.",
        "the step from the period's last point to the next one's first is no greater than between any two points",
        format!("step at the join {joins:.2} times the greatest within the period"),
        joins <= 1.0,
    ));
    let swings: Vec<f64> = meshes.iter().map(|mesh| range(&mesh.e_wear_rad)).collect();
    checks.push(Check::new(
        18,
        "Its amplitude grows with wear.",
        "peak to peak, from state to state",
        listed(&swings, |swing| format!("{:.1}", swing * 1e6))
            + " µrad ("
            + &listed(&swings, |swing| format!("{:.1}", swing * pair.gears[1].base_radius_mm * 1e3))
            + " µm along the line of action)",
        rises(&swings),
    ));
    checks
}

/// Leads of the neighbours at positions where one touches too.
fn shared(mesh: &Mesh) -> impl Iterator<Item = f64> {
    mesh.neighbour_lead_rad.iter().copied().filter(|lead| *lead > -1.0)
}

/// Greatest relative difference of the mesh stiffness in single contact from that of the pair alone.
fn greatest_difference(mesh: &Mesh, pair: &ToothPair) -> f64 {
    let start = limits(&mesh.phi1_rad).0;
    let pitch = (limits(&mesh.phi1_rad).1 - start) * POINTS as f64 / (POINTS - 1) as f64;
    let single = (0..POINTS).filter(|i| mesh.pairs_in_contact[*i] == 1);
    single
        .map(|i| {
            let own = [0.0, 1.0].map(|n| pair.stiffness_at(mesh.phi1_rad[i] + n * pitch));
            let nearest = own.iter().flatten().map(|k| (mesh.stiffness_n_per_m[i] / k - 1.0).abs());
            nearest.fold(f64::INFINITY, f64::min)
        })
        .fold(0.0, f64::max)
}

/// Ratio of the step of e_wear from the end of the period to its start to the greatest step within it.
fn join_of_error(mesh: &Mesh) -> f64 {
    let error = &mesh.e_wear_rad;
    let within = error.windows(2).map(|two| (two[1] - two[0]).abs()).fold(0.0, f64::max);
    (error[0] - error[POINTS - 1]).abs() / within
}

#[cfg(test)]
mod tests {
    use flankwatch_gear::PairSpec;

    use super::*;

    #[test]
    fn the_error_of_a_tooth_begins_at_its_phase() {
        let mut spec = PairSpec::from_toml(include_str!("../../../../fixtures/pairs/shen2022.toml")).unwrap();
        (spec.errors.short_period_um, spec.errors.short_period_phase) = (Some(15.0), 0.25);
        let mesh = Mesh {
            pair_phi1_rad: Vec::new(),
            neighbour_lead_rad: Vec::new(),
            carries: Vec::new(),
            pair_stiffness_n_per_m: Vec::new(),
            phi1_rad: vec![0.0; POINTS],
            stiffness_n_per_m: vec![1.0; POINTS],
            e_wear_rad: vec![0.0; POINTS],
            pairs_in_contact: vec![1; POINTS],
        };
        let (turns, errors) = transmission_error_um(&spec.resolve().unwrap(), &mesh);
        assert!((errors[0] - 15.0).abs() < 1e-9, "{} µm at {} turns", errors[0], turns[0]);
    }
}
