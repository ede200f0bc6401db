//! The new mesh relationship of one pair of teeth with worn flanks, Eqs. (9)–(17) and Algorithm 1.
//!
//! With the common normal as an axis, gear i's centre lies r_i beside it and u_i along it from the point of contact (see
//! [`FlankPoint::normal_arm_mm`] and [`FlankPoint::normal_length_mm`]), so the centre distance is √((u₁ + u₂)² + (r₁ + r₂)²) and the
//! angle θ between the line of centres and the tangent is arctan((u₁ + u₂)/(r₁ + r₂)). That is step 11 of Algorithm 1 and
//! Eqs. (9)–(17) in closed form; the one equation left is the centre distance in α₁′.

use super::{Flank, FlankPoint, FlankWear, GearError, GearPair, root};

/// Points of contact that are solved for.
const POINTS: usize = 601;
/// Cells of the driven flank in which a root is looked for.
const CELLS: usize = 128;
/// Accuracy of α₁ and α₁′ in rad.
const TOLERANCE_RAD: f64 = 1e-14;
/// Part of the squared centre distance that is rounding: the perfect pair's ends lie exactly on the limits of both flanks.
const ROUNDING: f64 = 1e-12;

/// Where and at which rotations the flanks of one pair of teeth touch, from the start to the end of its contact.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshRelationship {
    /// α₁: angle of the point of contact on the driving flank in rad, rising.
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
    /// Points of the driven flank at the cells' ends, from its root to its tip.
    driven: Vec<FlankPoint>,
    centre_squared: f64,
    ratio: f64,
}

impl MeshRelationship {
    /// Solves Algorithm 1 for one pair of teeth, at 601 points evenly over the driving flank between the first and the last contact.
    ///
    /// # Errors
    /// [`GearError::NoContact`] where the flanks do not touch at all within their active profiles.
    pub fn solve(pair: &GearPair, wear: &FlankWear) -> Result<Self, GearError> {
        let flanks = [Flank::new(&pair.gears[0], wear, 0), Flank::new(&pair.gears[1], wear, 1)];
        let solver = Solver {
            driven: flanks[1].active_points(CELLS).collect(),
            flanks,
            centre_squared: pair.centre_distance_mm.powi(2),
            ratio: pair.gears[0].base_radius_mm / pair.gears[1].base_radius_mm,
        };
        let driving: Vec<FlankPoint> = solver.flanks[0].active_points(CELLS).collect();
        let no_contact = || GearError::NoContact {
            phi1_rad: pair.start_of_contact_rad(),
        };
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

/// φ₁ and φ₂ of a contact: θ₁ = λ₁ − φ₁ and θ₂ = λ₂ + φ₂, Eqs. (11)–(17).
fn rotations((driving, driven): &Contact) -> (f64, f64) {
    let along = driving.normal_length_mm() + driven.normal_length_mm();
    let beside = driving.normal_arm_mm() + driven.normal_arm_mm();
    let theta = along.atan2(beside);
    (driving.lambda_rad - theta, theta - driven.lambda_rad)
}

impl Solver<'_> {
    /// Squared centre distance at which the two points touch with a common tangent, less the pair's.
    fn residual(&self, driving: &FlankPoint, driven: &FlankPoint) -> f64 {
        let along = driving.normal_length_mm() + driven.normal_length_mm();
        let beside = driving.normal_arm_mm() + driven.normal_arm_mm();
        along * along + beside * beside - self.centre_squared
    }

    /// The driven point that touches `driving`. Wear with a concave depth can offer several: the one that pushes the driven gear
    /// furthest is the one that touches.
    fn mate(&self, driving: &FlankPoint) -> Option<FlankPoint> {
        let mut best: Option<(f64, FlankPoint)> = None;
        let mut before = self.residual(driving, &self.driven[0]);
        for two in self.driven.windows(2) {
            let after = self.residual(driving, &two[1]);
            if (before <= 0.0) != (after <= 0.0) {
                let residual = |alpha| self.residual(driving, &self.flanks[1].at(alpha));
                let alpha = root::find(residual, (two[0].alpha_rad, before), (two[1].alpha_rad, after), TOLERANCE_RAD);
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

    /// Driving root with the driven tip: the driving flank starts at its own end, or later where the driven tip ends first.
    fn first_contact(&self, driving: &[FlankPoint]) -> Option<Contact> {
        let tip = *self.driven.last()?;
        self.at_limit(driving[0], tip, |residual, rounding| residual >= -rounding)
            .or_else(|| self.crossing(driving.windows(2).map(|two| (two[0], two[1])), tip))
    }

    /// Driving tip with the driven root.
    fn last_contact(&self, driving: &[FlankPoint]) -> Option<Contact> {
        let root = *self.driven.first()?;
        self.at_limit(*driving.last()?, root, |residual, rounding| residual <= rounding)
            .or_else(|| self.crossing(driving.windows(2).rev().map(|two| (two[0], two[1])), root))
    }

    /// The contact of the driving flank's end, where the driven flank reaches it.
    fn at_limit(&self, driving: FlankPoint, limit: FlankPoint, reaches: impl Fn(f64, f64) -> bool) -> Option<Contact> {
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

    /// The first of the driving flank's cells in which `limit`, an end of the driven flank, touches.
    fn crossing(&self, cells: impl Iterator<Item = Contact>, limit: FlankPoint) -> Option<Contact> {
        for (low, high) in cells {
            let (before, after) = (self.residual(&low, &limit), self.residual(&high, &limit));
            if before <= 0.0 && after > 0.0 {
                let residual = |alpha| self.residual(&self.flanks[0].at(alpha), &limit);
                let alpha = root::find(residual, (low.alpha_rad, before), (high.alpha_rad, after), TOLERANCE_RAD);
                return Some((self.flanks[0].at(alpha), limit));
            }
        }
        None
    }
}
