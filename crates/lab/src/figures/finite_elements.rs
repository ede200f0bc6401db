//! Figure 17: the mesh stiffness of perfect flanks compared with a finite-element table of the same pair.

use serde::Serialize;

use super::check::Check;
use super::mesh::Mesh;
use flankwatch_gear::PairSpec;

/// 2-D plane-strain model of the pair of Table 1: a copy of
/// `fixtures/reference/mesh-stiffness-fe/K_perfect.csv`, since a published crate cannot contain files from
/// outside its folder.
const TABLE: &str = include_str!("finite_elements.csv");
/// Greatest relative difference of two stiffnesses that count as equal.
const SAME: f64 = 0.05;
/// Share of the torque above which a pair counts as carrying.
const CARRYING_SHARE: f64 = 1e-6;

/// One row of the finite-element table.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FiniteElementPoint {
    /// φ₁ in rad.
    pub phi1_rad: f64,
    /// Mesh stiffness K = T/(R_b1² θ) in N/m, Eq. (30), with θ from first contact.
    pub stiffness_n_per_m: f64,
    /// Pairs that carry part of the torque.
    pub pairs_in_contact: u32,
}

/// Returns the table's points over one mesh period, both ends included; empty for any pair but the table's.
pub(super) fn points(spec: &PairSpec) -> Vec<FiniteElementPoint> {
    let geometry = &spec.geometry;
    let of_the_table = geometry.teeth == [24, 26]
        && geometry.bore_radius_mm == Some([20.0, 20.0])
        && geometry.addendum == [1.0, 1.0]
        && (geometry.module_mm, geometry.face_width_mm, geometry.pressure_angle_deg) == (6.0, 50.0, 20.0)
        && spec.material.youngs_modulus_pa == 2.05e11;
    if !of_the_table {
        return Vec::new();
    }
    TABLE.lines().skip(1).filter_map(point).collect()
}

fn point(line: &str) -> Option<FiniteElementPoint> {
    let numbers: Vec<f64> = line.split(',').map_while(|field| field.trim().parse().ok()).collect();
    Some(FiniteElementPoint {
        phi1_rad: *numbers.first()?,
        stiffness_n_per_m: *numbers.get(1)?,
        pairs_in_contact: numbers.get(6..9)?.iter().filter(|share| **share > CARRYING_SHARE).count() as u32,
    })
}

/// Checks Fig. 17 for perfect flanks; empty without a table.
pub(super) fn checks(mesh: &Mesh, points: &[FiniteElementPoint]) -> Vec<Check> {
    if points.is_empty() {
        return Vec::new();
    }
    // The last point is the first of the next period.
    let period = &points[..points.len().saturating_sub(1)];
    let double =
        period.iter().filter(|point| point.pairs_in_contact > 1).count() as f64 / period.len() as f64;
    // The middles of the model's own single and double contact.
    let middle = |pairs: u32| {
        let places: Vec<usize> =
            (0..mesh.phi1_rad.len()).filter(|i| mesh.pairs_in_contact[*i] == pairs).collect();
        let at = *places.get(places.len() / 2)?;
        let distance = |point: &FiniteElementPoint| (point.phi1_rad - mesh.phi1_rad[at]).abs();
        let nearest = points.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        Some((mesh.stiffness_n_per_m[at], nearest.stiffness_n_per_m))
    };
    let deviation = |pairs| middle(pairs).map_or(f64::NAN, |(model, reference)| model / reference - 1.0);
    let text = |pairs| {
        middle(pairs).map_or_else(String::new, |(model, reference)| {
            format!(
                "{:.3}e8 against {:.3}e8 N/m ({:+.1} %)",
                model * 1e-8,
                reference * 1e-8,
                100.0 * (model / reference - 1.0)
            )
        })
    };
    vec![
        Check::new(
            17,
            "Model and finite elements have the same ranges of double and single contact.",
            "double contact within 0.02 mesh periods of each other",
            format!("{:.3} against {double:.3} mesh periods", mesh.double_part()),
            (mesh.double_part() - double).abs() < 0.02,
        ),
        Check::new(
            17,
            "In single contact model and finite elements are equally stiff.",
            "within 5 % in its middle",
            text(1),
            deviation(1).abs() < SAME,
        ),
        Check::new(
            17,
            "In double contact they differ.",
            "by more than 5 % in its middle",
            text(2),
            deviation(2).abs() > SAME,
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::{TABLE, points};
    use flankwatch_gear::PairSpec;

    #[test]
    fn the_table_is_that_of_the_fixtures() {
        assert_eq!(TABLE, include_str!("../../../../fixtures/reference/mesh-stiffness-fe/K_perfect.csv"));
    }

    #[test]
    fn the_table_is_read_completely_and_only_for_its_own_pair() {
        let mut spec = PairSpec::from_toml(include_str!("../../../../fixtures/pairs/shen2022.toml")).unwrap();
        let points = points(&spec);
        assert_eq!(points.len(), 97);
        assert!((points[0].phi1_rad + 0.277_624_056).abs() < 1e-9);
        assert!(points.iter().all(|point| (5e8..7.5e8).contains(&point.stiffness_n_per_m)));
        // The table's README: loaded contact ratio 1.73.
        let double = points[..96].iter().filter(|point| point.pairs_in_contact == 2).count();
        assert!((double as f64 / 96.0 - 0.73).abs() < 0.02, "{double} of 96");
        spec.geometry.bore_radius_mm = Some([30.0, 30.0]);
        assert!(super::points(&spec).is_empty());
    }
}
