//! The new mesh relationship of one pair of teeth with worn flanks, Eqs. (9)–(17) and Algorithm 1.
//!
//! With the common normal as an axis, gear i's centre lies r_i beside it and u_i along it from the point of
//! contact (see [`FlankPoint::normal_arm_mm`] and [`FlankPoint::normal_length_mm`]), so the centre distance
//! is √((u₁ + u₂)² + (r₁ + r₂)²), and the angle θ between the line of centres and the tangent is arctan((u₁ +
//! u₂)/(r₁ + r₂)). This is step 11 of Algorithm 1 and Eqs. (9)–(17) in closed form; one equation remains, the
//! centre distance in α₁′.

use super::{Flank, FlankPoint, FlankWear, GearError, GearPair, root};

/// Number of points of contact solved.
const POINTS: usize = 601;
/// Number of cells of the driven flank in which a root is searched.
const CELLS: usize = 128;
/// Accuracy of α₁ and α₁′ in rad.
const TOLERANCE_RAD: f64 = 1e-14;
/// Relative rounding of the squared centre distance: the perfect pair's ends lie exactly on the limits of
/// both flanks.
const ROUNDING: f64 = 1e-12;

/// Contact points and rotations of the flanks of one pair of teeth, from the start to the end of its contact.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshRelationship {
    /// α₁: angle of the point of contact on the driving flank in rad, ascending.
    pub alpha1_rad: Vec<f64>,
    /// α₁′: the same on the driven flank.
    pub alpha1_prime_rad: Vec<f64>,
    /// φ₁: rotational angle of the driving gear in rad.
    pub phi1_rad: Vec<f64>,
    /// φ₂: rotational angle of the driven gear in rad.
    pub phi2_rad: Vec<f64>,
    /// dφ₂/dφ₁, exact: the ratio of the normal's distances from the centres.
    pub phi2_slope: Vec<f64>,
}

/// The driving and the driven point of one contact.
type Contact = (FlankPoint, FlankPoint);

struct Solver<'a> {
    flanks: [Flank<'a>; 2],
    /// Points of the driven flank at the cell boundaries, from its root to its tip.
    driven: Vec<FlankPoint>,
    centre_squared: f64,
    ratio: f64,
}

impl MeshRelationship {
    /// Solves Algorithm 1 for one pair of teeth, at 601 points at equal steps over the driving flank between
    /// the first and the last contact.
    ///
    /// # Errors
    /// [`GearError::NoContact`] if the flanks do not touch at all within their active profiles.
    pub fn solve(pair: &GearPair, wear: &FlankWear) -> Result<Self, GearError> {
        let flanks = [Flank::new(&pair.gears[0], wear, 0), Flank::new(&pair.gears[1], wear, 1)];
        let solver = Solver {
            driven: flanks[1].active_points(CELLS).collect(),
            flanks,
            centre_squared: pair.centre_distance_mm.powi(2),
            ratio: pair.gears[0].base_radius_mm / pair.gears[1].base_radius_mm,
        };
        let driving: Vec<FlankPoint> = solver.flanks[0].active_points(CELLS).collect();
        let no_contact = || GearError::NoContact { phi1_rad: pair.start_of_contact_rad() };
        let first = solver.first_contact(&driving).ok_or_else(no_contact)?;
        let last = solver.last_contact(&driving).ok_or_else(no_contact)?;
        let (start, end) = (first.0.alpha_rad, last.0.alpha_rad);
        if end <= start {
            return Err(no_contact());
        }

        let mut relationship = Self::with_capacity(POINTS);
        relationship.push(&first);
        for i in 1..POINTS - 1 {
            let point = solver.flanks[0].at(start + (end - start) * i as f64 / (POINTS - 1) as f64);
            if let Some(mate) = solver.mate(&point) {
                relationship.push(&(point, mate));
            }
        }
        relationship.push(&last);
        Ok(relationship)
    }

    fn with_capacity(points: usize) -> Self {
        let empty = || Vec::with_capacity(points);
        Self {
            alpha1_rad: empty(),
            alpha1_prime_rad: empty(),
            phi1_rad: empty(),
            phi2_rad: empty(),
            phi2_slope: empty(),
        }
    }

    fn push(&mut self, contact: &Contact) {
        let (phi1, phi2) = rotations(contact);
        self.alpha1_rad.push(contact.0.alpha_rad);
        self.alpha1_prime_rad.push(contact.1.alpha_rad);
        self.phi1_rad.push(phi1);
        self.phi2_rad.push(phi2);
        self.phi2_slope.push(contact.0.normal_arm_mm() / contact.1.normal_arm_mm());
    }
}

/// Returns φ₁ and φ₂ of a contact: θ₁ = λ₁ − φ₁ and θ₂ = λ₂ + φ₂, Eqs. (11)–(17).
fn rotations((driving, driven): &Contact) -> (f64, f64) {
    let along = driving.normal_length_mm() + driven.normal_length_mm();
    let beside = driving.normal_arm_mm() + driven.normal_arm_mm();
    let theta = along.atan2(beside);
    (driving.lambda_rad - theta, theta - driven.lambda_rad)
}

impl Solver<'_> {
    /// Returns the squared centre distance at which the two points touch with a common tangent, less the
    /// pair's.
    fn residual(&self, driving: &FlankPoint, driven: &FlankPoint) -> f64 {
        let along = driving.normal_length_mm() + driven.normal_length_mm();
        let beside = driving.normal_arm_mm() + driven.normal_arm_mm();
        along * along + beside * beside - self.centre_squared
    }

    /// Returns the driven point that touches `driving`. Wear with a concave depth can have several solutions:
    /// the one that advances the driven gear most is the contact.
    fn mate(&self, driving: &FlankPoint) -> Option<FlankPoint> {
        let mut best: Option<(f64, FlankPoint)> = None;
        let mut before = self.residual(driving, &self.driven[0]);
        for two in self.driven.windows(2) {
            let after = self.residual(driving, &two[1]);
            if (before <= 0.0) != (after <= 0.0) {
                let residual = |alpha| self.residual(driving, &self.flanks[1].at(alpha));
                let alpha = root::find(
                    residual,
                    (two[0].alpha_rad, before),
                    (two[1].alpha_rad, after),
                    TOLERANCE_RAD,
                );
                let point = self.flanks[1].at(alpha);
                let (phi1, phi2) = rotations(&(*driving, point));
                let lead = phi2 - self.ratio * phi1;
                if best.as_ref().is_none_or(|(most, _)| lead > *most) {
                    best = Some((lead, point));
                }
            }
            before = after;
        }
        best.map(|(_, point)| point)
    }

    /// Returns the contact of the driving root with the driven tip. The driving flank starts at its own end,
    /// or later if the driven tip ends first.
    fn first_contact(&self, driving: &[FlankPoint]) -> Option<Contact> {
        let tip = *self.driven.last()?;
        self.at_limit(driving[0], tip, |residual, rounding| residual >= -rounding)
            .or_else(|| self.crossing(driving.windows(2).map(|two| (two[0], two[1])), tip))
    }

    /// Returns the contact of the driving tip with the driven root.
    fn last_contact(&self, driving: &[FlankPoint]) -> Option<Contact> {
        let root = *self.driven.first()?;
        self.at_limit(*driving.last()?, root, |residual, rounding| residual <= rounding)
            .or_else(|| self.crossing(driving.windows(2).rev().map(|two| (two[0], two[1])), root))
    }

    /// Returns the contact of the driving flank's end, if the driven flank reaches it.
    fn at_limit(
        &self,
        driving: FlankPoint,
        limit: FlankPoint,
        reaches: impl Fn(f64, f64) -> bool,
    ) -> Option<Contact> {
        let rounding = ROUNDING * self.centre_squared;
        let residual = self.residual(&driving, &limit);
        if residual.abs() <= rounding {
            return Some((driving, limit));
        }
        if reaches(residual, rounding) {
            return self.mate(&driving).map(|mate| (driving, mate));
        }
        None
    }

    /// Searches the first of the driving flank's cells in which `limit`, an end of the driven flank, touches.
    fn crossing(&self, cells: impl Iterator<Item = Contact>, limit: FlankPoint) -> Option<Contact> {
        for (low, high) in cells {
            let (before, after) = (self.residual(&low, &limit), self.residual(&high, &limit));
            if before <= 0.0 && after > 0.0 {
                let residual = |alpha| self.residual(&self.flanks[0].at(alpha), &limit);
                let alpha =
                    root::find(residual, (low.alpha_rad, before), (high.alpha_rad, after), TOLERANCE_RAD);
                return Some((self.flanks[0].at(alpha), limit));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{shen2022, shen2022_spec, typical_wear};
    use super::{CELLS, Flank, MeshRelationship, Solver};
    use crate::{FlankWear, GearPair};

    fn range(values: &[f64]) -> f64 {
        values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
            - values.iter().copied().fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn perfect_flanks_turn_as_they_roll() {
        let pair = shen2022();
        let solved = MeshRelationship::solve(&pair, &FlankWear::none()).unwrap();
        assert_eq!(solved.phi1_rad.len(), 601);
        for i in 0..601 {
            assert!((solved.phi1_rad[i] - (solved.alpha1_rad[i] - 20.0_f64.to_radians())).abs() < 1e-13);
            assert!(
                (solved.phi2_rad[i] - (20.0_f64.to_radians() - solved.alpha1_prime_rad[i])).abs() < 1e-13
            );
            assert!((solved.phi2_slope[i] - 24.0 / 26.0).abs() < 1e-13);
        }
        assert!((solved.phi1_rad[0] + 0.277_624_056).abs() < 1e-9);
        assert!((solved.phi1_rad[600] - 0.144_238_753).abs() < 1e-9);
        assert!((range(&solved.phi1_rad) / pair.gears[0].pitch_angle_rad() - 1.6114).abs() < 5e-5);
    }

    #[test]
    fn wear_shrinks_the_flanks_range_and_widens_the_rotations() {
        // Fig. 8's two findings; the ranges of α₁ and φ₁ are among the reference numbers.
        let (pair, wear) = typical_wear();
        let solved = MeshRelationship::solve(&pair, &wear).unwrap();
        assert!(range(&solved.alpha1_rad) < pair.gears[0].tip_angle_rad - pair.gears[0].root_angle_rad);
        assert!(range(&solved.phi1_rad) > 0.42186);
        assert!(range(&solved.alpha1_prime_rad) < pair.gears[1].tip_angle_rad - pair.gears[1].root_angle_rad);
        // φ₂'s exact slope is that of the points.
        for i in 1..600 {
            let width = solved.phi1_rad[i + 1] - solved.phi1_rad[i - 1];
            let slope = (solved.phi2_rad[i + 1] - solved.phi2_rad[i - 1]) / width;
            assert!((slope - solved.phi2_slope[i]).abs() < 1e-4, "{slope} {}", solved.phi2_slope[i]);
        }
    }

    #[test]
    fn every_contact_obeys_equations_9_to_17() {
        let (pair, wear) = typical_wear();
        let flanks = [Flank::new(&pair.gears[0], &wear, 0), Flank::new(&pair.gears[1], &wear, 1)];
        let solved = MeshRelationship::solve(&pair, &wear).unwrap();
        for i in 0..solved.phi1_rad.len() {
            let (one, two) = (flanks[0].at(solved.alpha1_rad[i]), flanks[1].at(solved.alpha1_prime_rad[i]));
            let psi1 = one.gamma_rad() + solved.phi1_rad[i];
            let psi2 = solved.phi2_rad[i] - two.gamma_rad();
            let across = one.worn_radius_mm() * psi1.cos() + two.worn_radius_mm() * psi2.cos();
            assert!((across - pair.centre_distance_mm).abs() < 1e-9, "Eq. (9): {across}");
            assert!(
                (one.worn_radius_mm() * psi1.sin() - two.worn_radius_mm() * psi2.sin()).abs() < 1e-9,
                "Eq. (10)"
            );
            let theta1 = one.lambda_rad + one.gamma_rad() - psi1;
            let theta2 = two.lambda_rad + two.gamma_rad() + psi2;
            assert!((theta1 - theta2).abs() < 1e-12, "Eq. (11)");
        }
    }

    /// α₁, γ, R_A and λ of a point as Algorithm 1 takes them.
    fn algorithm_points(flank: &Flank, from: f64, to: f64, count: usize) -> Vec<[f64; 4]> {
        let at = |i: usize| flank.at(from + (to - from) * i as f64 / (count - 1) as f64);
        let point = |i| {
            let point = at(i);
            [point.alpha_rad, point.gamma_rad(), point.worn_radius_mm(), point.lambda_rad]
        };
        (0..count).map(point).collect()
    }

    /// Algorithm 1 as printed: for every α₁ the α₁′ of a grid that comes nearest to the centre distance, kept
    /// where it is nearer than `tolerance_mm`. Gives (α₁, α₁′, φ₁, φ₂).
    fn double_scan(pair: &GearPair, wear: &FlankWear, count: usize, tolerance_mm: f64) -> Vec<[f64; 4]> {
        let [gear1, gear2] = &pair.gears;
        let driving =
            algorithm_points(&Flank::new(gear1, wear, 0), gear1.root_angle_rad, gear1.tip_angle_rad, count);
        let driven =
            algorithm_points(&Flank::new(gear2, wear, 1), gear2.tip_angle_rad, gear2.root_angle_rad, count);
        let mut found = Vec::new();
        for [alpha1, gamma1, r1, lambda1] in driving {
            let mut best = (f64::INFINITY, [0.0; 4]);
            for [prime, gamma2, r2, lambda2] in &driven {
                let (sin, cos) = (lambda1 - lambda2 - gamma2).sin_cos();
                let phi1 = ((r2 * sin - r1 * gamma1.sin()) / (r1 * gamma1.cos() + r2 * cos)).atan();
                let phi2 = lambda1 - lambda2 - phi1;
                let error =
                    (r1 * (gamma1 + phi1).cos() + r2 * (phi2 - gamma2).cos() - pair.centre_distance_mm).abs();
                if error < best.0 {
                    best = (error, [alpha1, *prime, phi1, phi2]);
                }
            }
            if best.0 < tolerance_mm {
                found.push(best.1);
            }
        }
        found
    }

    #[test]
    fn the_papers_double_scan_agrees_within_its_grid() {
        let (pair, wear) = typical_wear();
        let [gear1, gear2] = &pair.gears;
        let count = 1611;
        let cell = (gear2.tip_angle_rad - gear2.root_angle_rad) / 1610.0;
        // Half a cell moves the centre distance by about R_b2 sin α half a cell; wear adds a little to it.
        let tolerance_mm = 1.5 * 0.5 * cell * gear2.base_radius_mm * pair.pressure_angle_rad.sin();
        let scanned = double_scan(&pair, &wear, count, tolerance_mm);

        let flanks = [Flank::new(gear1, &wear, 0), Flank::new(gear2, &wear, 1)];
        let solver = Solver {
            driven: flanks[1].active_points(CELLS).collect(),
            flanks,
            centre_squared: pair.centre_distance_mm.powi(2),
            ratio: gear1.base_radius_mm / gear2.base_radius_mm,
        };
        let solved = MeshRelationship::solve(&pair, &wear).unwrap();
        let (start, end) = (solved.alpha1_rad[0], solved.alpha1_rad[600]);
        let wanted = ((end - start) / (gear1.tip_angle_rad - gear1.root_angle_rad) * 1610.0).round() as usize;
        assert!(scanned.len().abs_diff(wanted) <= 3, "{} contacts scanned, {wanted} expected", scanned.len());
        for [alpha1, prime, phi1, phi2] in scanned {
            if alpha1 < start || alpha1 > end {
                continue;
            }
            let point = solver.flanks[0].at(alpha1);
            let mate = solver.mate(&point).unwrap();
            let (exact1, exact2) = super::rotations(&(point, mate));
            assert!((mate.alpha_rad - prime).abs() <= 0.51 * cell, "{} {prime}", mate.alpha_rad);
            assert!((exact1 - phi1).abs() <= cell && (exact2 - phi2).abs() <= cell);
        }
    }

    #[test]
    fn a_shifted_pair_at_its_own_centre_distance_is_conjugate() {
        let mut spec = shen2022_spec();
        spec.geometry.teeth = [19, 47];
        spec.geometry.module_mm = 2.5;
        spec.geometry.profile_shift = [0.35, 0.1];
        spec.geometry.bore_radius_mm = Some([8.0, 15.0]);
        spec.geometry.centre_distance_mm = Some(83.7);
        let pair = spec.resolve().unwrap();
        let solved = MeshRelationship::solve(&pair, &FlankWear::none()).unwrap();
        for (phi1, phi2) in solved.phi1_rad.iter().zip(&solved.phi2_rad) {
            assert!((phi1 * 19.0 / 47.0 - phi2 - pair.perfect_lag_rad()).abs() < 1e-13);
        }
        assert!(
            (range(&solved.phi1_rad) / pair.gears[0].pitch_angle_rad() - pair.contact_ratio()).abs() < 1e-12
        );
    }
}
