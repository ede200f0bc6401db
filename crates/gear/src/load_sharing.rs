//! Load sharing between the pairs of teeth within reach of each other, and the rotation of the gears under
//! load.

use super::body_compliance::BodyCompliance;
use super::pair_curve::PairCurve;
use super::plane_elasticity::PlaneElasticity;
use super::tooth_outline::ToothOutline;
use super::tooth_touch::ToothTouch;
use super::{Flank, FlankWear, GearError, GearPair};

/// Largest number of pairs of teeth that share the load.
pub(super) const MAX_PAIRS: usize = 4;
/// Largest number of iterations for the contact lines' compliance, which depends only logarithmically on the
/// force.
const MAX_ITERATIONS: usize = 60;
/// Relative change of the forces at which the iteration has converged.
const TOLERANCE: f64 = 1e-11;
/// Smallest share of the force for which a contact line's compliance is computed.
const MIN_PART: f64 = 1e-9;

/// Elastic bodies of a pair's gears with their wear: computed once for every torque.
#[derive(Debug, Clone, PartialEq)]
pub struct ElasticBodies {
    pub(super) outlines: [ToothOutline; 2],
    compliance: Compliance,
}

/// Elastic model of the teeth under contact forces.
#[derive(Debug, Clone, PartialEq)]
enum Compliance {
    /// Whole gears, in which the force on one tooth also displaces the others.
    Bodies { elasticity: PlaneElasticity, bodies: Box<[BodyCompliance; 2]> },
    /// Independent pairs of teeth, each a spring of the stiffness of Section 3.3. The table has the driving
    /// flank's radius in mm, ascending, and the compliance in mm/(N/mm).
    Teeth(Vec<[f64; 2]>),
}

/// One pair of teeth within reach.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Candidate {
    /// Index among the gear's teeth, increasing with φ.
    pub(super) tooth: i32,
    /// Its contact.
    pub(super) touch: ToothTouch,
    /// Angle in rad by which the driven tooth lags the leading pair's.
    pub(super) behind_rad: f64,
}

/// The shares of the load and the resulting rotation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sharing {
    /// Rotation θ in rad of the driving gear from first contact on.
    pub(super) rotation_rad: f64,
    /// Share of the torque on each candidate.
    pub(super) shares: [f64; MAX_PAIRS],
    /// Number of candidates that carry load.
    pub(super) carrying: u32,
}

impl ElasticBodies {
    /// Computes both gears' compliance.
    ///
    /// # Errors
    /// [`GearError::ElasticModel`] for a shape that cannot be meshed.
    pub fn new(pair: &GearPair, wear: &FlankWear) -> Result<Self, GearError> {
        let elasticity = PlaneElasticity::new(&pair.spec.material, pair.spec.dynamics.plane);
        let outlines = [0, 1].map(|i| ToothOutline::new(pair, i));
        let module = pair.spec.geometry.module_mm;
        let body = |i: usize| {
            let flank = Flank::new(&pair.gears[i], wear, i);
            BodyCompliance::new(i, &outlines[i], &flank, module, &elasticity)
        };
        Ok(Self {
            compliance: Compliance::Bodies { bodies: Box::new([body(0)?, body(1)?]), elasticity },
            outlines,
        })
    }

    /// Creates independent pairs of teeth, with the compliance of unworn teeth by the potential energy method
    /// of Section 3.3: the usual model of mesh stiffness, stiffer in double contact than whole gears.
    ///
    /// # Errors
    /// Those of the mesh relationship of unworn flanks.
    pub fn independent_teeth(pair: &GearPair) -> Result<Self, GearError> {
        let curve = PairCurve::new(pair, &FlankWear::none())?;
        let width_mm = pair.spec.geometry.face_width_mm;
        let unworn = FlankWear::none();
        let flank = Flank::new(&pair.gears[0], &unworn, 0);
        let mut table: Vec<[f64; 2]> = curve
            .contacts()
            .map(|(alpha1, stiffness_n_per_m)| {
                [flank.at(alpha1).radius_mm, width_mm / (stiffness_n_per_m * 1e-3)]
            })
            .collect();
        table.sort_by(|a, b| a[0].total_cmp(&b[0]));
        Ok(Self {
            outlines: [0, 1].map(|i| ToothOutline::new(pair, i)),
            compliance: Compliance::Teeth(table),
        })
    }

    /// Returns the displacement in mm/(N/mm) at the contact of `place` along its normal for a force in the
    /// contact of `load`, another pair.
    fn coupling(&self, load: &Candidate, place: &Candidate) -> f64 {
        let Compliance::Bodies { bodies, .. } = &self.compliance else {
            return 0.0;
        };
        // Teeth of rising φ are towards positive Y of the driving gear and negative Y of the driven one.
        let offset = place.tooth - load.tooth;
        let side = |i: usize, offset: i32| {
            let at = |candidate: &Candidate| (candidate.touch.radii_mm[i], candidate.touch.normals[i]);
            bodies[i].across(offset, at(load), at(place))
        };
        side(0, offset) + side(1, -offset)
    }

    /// Returns approach over force of one pair's own contact, bodies and contact line, in mm/(N/mm).
    fn own(&self, touch: &ToothTouch, force_n_per_mm: f64) -> f64 {
        let (elasticity, bodies) = match &self.compliance {
            Compliance::Bodies { elasticity, bodies } => (elasticity, bodies),
            Compliance::Teeth(table) => return at_radius(table, touch.radii_mm[0]),
        };
        let approach = touch.line.approach(force_n_per_mm, elasticity.contact_modulus_mpa());
        let body = |i: usize| {
            let radius = touch.radii_mm[i];
            // Under a tip edge the centre of pressure is loaded, not the edge itself.
            let inside =
                if touch.edge == i { bodies[i].radius_at(approach.centre_mm) } else { f64::INFINITY };
            bodies[i].own(radius.min(inside), touch.normals[i])
        };
        approach.depth_mm / force_n_per_mm + body(0) + body(1)
    }

    /// Solves the balance of the candidates' forces with a torque in N·mm per mm of width on the driving
    /// gear. The first candidate is the leading one.
    pub(super) fn share(&self, candidates: &[Candidate], torque_n: f64) -> Sharing {
        let count = candidates.len().min(MAX_PAIRS);
        let candidates = &candidates[..count];
        let gaps = candidates.iter().map(|candidate| candidate.behind_rad * candidate.touch.arms_mm[1]);
        let mut system = Balance {
            count,
            compliance: [[0.0; MAX_PAIRS]; MAX_PAIRS],
            gaps: collect(gaps),
            arms: collect(candidates.iter().map(|candidate| candidate.touch.arms_mm[0])),
            torque: torque_n,
        };
        let whole = torque_n / system.arms[0];
        let mut forces = [whole / count as f64; MAX_PAIRS];
        for (i, load) in candidates.iter().enumerate() {
            for (j, place) in candidates.iter().enumerate().skip(i + 1) {
                let coupling = self.coupling(load, place);
                (system.compliance[i][j], system.compliance[j][i]) = (coupling, coupling);
            }
        }
        let mut rotation_rad = 0.0;
        for _ in 0..MAX_ITERATIONS {
            for (i, candidate) in candidates.iter().enumerate() {
                system.compliance[i][i] = self.own(&candidate.touch, forces[i].max(MIN_PART * whole));
            }
            let (next, rotation) = system.solve();
            let change = (0..count).map(|i| (next[i] - forces[i]).abs()).fold(0.0, f64::max);
            (forces, rotation_rad) = (next, rotation);
            if change <= TOLERANCE * whole {
                break;
            }
        }
        Sharing {
            rotation_rad,
            shares: std::array::from_fn(
                |i| {
                    if i < count { forces[i] * system.arms[i] / torque_n } else { 0.0 }
                },
            ),
            carrying: forces[..count].iter().filter(|force| **force > 0.0).count() as u32,
        }
    }

    /// Returns the rotation in rad with the leading pair alone: a pair that lags more cannot touch.
    pub(super) fn alone_rad(&self, touch: &ToothTouch, torque_n: f64) -> f64 {
        let force = torque_n / touch.arms_mm[0];
        self.own(touch, force) * force / touch.arms_mm[0]
    }
}

/// Interpolates linearly between the table's radii, constant beyond its ends: a tip edge carries load like
/// the flank beside it.
fn at_radius(table: &[[f64; 2]], radius_mm: f64) -> f64 {
    let after = table.partition_point(|row| row[0] <= radius_mm).clamp(1, table.len() - 1);
    let ([r0, c0], [r1, c1]) = (table[after - 1], table[after]);
    let part = if r1 > r0 { ((radius_mm - r0) / (r1 - r0)).clamp(0.0, 1.0) } else { 0.0 };
    c0 + part * (c1 - c0)
}

fn collect(values: impl Iterator<Item = f64>) -> [f64; MAX_PAIRS] {
    let mut array = [0.0; MAX_PAIRS];
    array.iter_mut().zip(values).for_each(|(place, value)| *place = value);
    array
}

/// Forces F ≥ 0 with C F + g = θ a where they push and C F + g ≥ θ a elsewhere, and a·F the torque.
struct Balance {
    count: usize,
    compliance: [[f64; MAX_PAIRS]; MAX_PAIRS],
    gaps: [f64; MAX_PAIRS],
    arms: [f64; MAX_PAIRS],
    torque: f64,
}

impl Balance {
    /// Returns forces and θ by an active-set method.
    fn solve(&self) -> ([f64; MAX_PAIRS], f64) {
        let mut active: u32 = (1 << self.count) - 1;
        let mut seen = 0_u32;
        loop {
            let (forces, rotation) = self.with(active);
            seen |= 1 << active;
            let weakest = (0..self.count)
                .filter(|i| active >> i & 1 == 1 && forces[*i] < 0.0)
                .min_by(|a, b| forces[*a].total_cmp(&forces[*b]));
            let closed = |i: usize| {
                let displaced: f64 = (0..self.count).map(|j| self.compliance[i][j] * forces[j]).sum();
                rotation * self.arms[i] - self.gaps[i] - displaced
            };
            let next = weakest.map(|i| active & !(1 << i)).or_else(|| {
                (0..self.count)
                    .filter(|i| active >> i & 1 == 0 && closed(*i) > 0.0)
                    .map(|i| active | 1 << i)
                    .next()
            });
            match next {
                Some(set) if set != 0 && seen >> set & 1 == 0 => active = set,
                _ => return (forces.map(|force| force.max(0.0)), rotation),
            }
        }
    }

    /// Returns forces and θ with exactly the pairs of a set pushing.
    fn with(&self, active: u32) -> ([f64; MAX_PAIRS], f64) {
        // Symmetric elimination of C [p q] = [a g] on the set; C is positive definite.
        let mut matrix = [[0.0; MAX_PAIRS + 2]; MAX_PAIRS];
        let set: [bool; MAX_PAIRS] = std::array::from_fn(|i| active >> i & 1 == 1);
        for i in 0..MAX_PAIRS {
            for j in 0..MAX_PAIRS {
                matrix[i][j] = if set[i] && set[j] {
                    self.compliance[i][j]
                } else if i == j {
                    1.0
                } else {
                    0.0
                };
            }
            if set[i] {
                matrix[i][MAX_PAIRS] = self.arms[i];
                matrix[i][MAX_PAIRS + 1] = self.gaps[i];
            }
        }
        for pivot in 0..MAX_PAIRS {
            let row = matrix[pivot].map(|value| value / matrix[pivot][pivot]);
            for (i, other) in matrix.iter_mut().enumerate() {
                if i == pivot {
                    *other = row;
                } else {
                    let factor = other[pivot];
                    other.iter_mut().zip(row).for_each(|(value, part)| *value -= factor * part);
                }
            }
        }
        let dot = |column: usize| (0..MAX_PAIRS).map(|i| self.arms[i] * matrix[i][column]).sum::<f64>();
        let rotation = (self.torque + dot(MAX_PAIRS + 1)) / dot(MAX_PAIRS);
        (std::array::from_fn(|i| rotation * matrix[i][MAX_PAIRS] - matrix[i][MAX_PAIRS + 1]), rotation)
    }
}

#[cfg(test)]
mod tests {
    use super::{Candidate, ElasticBodies};
    use crate::FlankWear;
    use crate::testing::shen2022;
    use crate::tooth_touch::ToothPair;

    /// `fixtures/reference/mesh-stiffness-fe/K_perfect_pair0_only.csv`: one pair alone along its whole path,
    /// tip edges at both ends.
    #[test]
    fn a_single_pair_matches_the_finite_element_reference() {
        let (pair, wear) = (shen2022(), FlankWear::none());
        let bodies = ElasticBodies::new(&pair, &wear).unwrap();
        let teeth = ToothPair::new(&pair, &wear, &bodies.outlines);
        let torque_n = 1300e3 / 50.0;
        let mut greatest = (0.0, 0.0);
        for line in include_str!("../../../fixtures/reference/mesh-stiffness-fe/K_perfect_pair0_only.csv")
            .lines()
            .skip(1)
        {
            let numbers: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
            let (phi1, wanted) = (numbers[0], numbers[1]);
            let alone = Candidate { tooth: 0, touch: teeth.touch(phi1).unwrap(), behind_rad: 0.0 };
            let sharing = bodies.share(&[alone], torque_n);
            assert_eq!(sharing.carrying, 1);
            let base_m = pair.gears[0].base_radius_mm * 1e-3;
            let error = (1300.0 / (base_m * base_m * sharing.rotation_rad) / wanted - 1.0_f64).abs();
            if error > greatest.0 {
                greatest = (error, phi1);
            }
        }
        println!("one pair alone: {:.2} % at {:.4} rad", 100.0 * greatest.0, greatest.1);
        assert!(greatest.0 < 0.02);
    }

    /// The shares of `K_perfect.csv` at φ₁ = −0.2122 rad, the middle of double contact, and −0.0240 rad,
    /// where a tip's edge carries: 0.4819 and 0.2751 of the torque on the entering pair.
    #[test]
    fn shares_match_the_finite_element_reference() {
        let (pair, wear) = (shen2022(), FlankWear::none());
        let bodies = ElasticBodies::new(&pair, &wear).unwrap();
        let teeth = ToothPair::new(&pair, &wear, &bodies.outlines);
        let pitches = pair.gears.each_ref().map(|gear| gear.pitch_angle_rad());
        for (phi1, wanted) in [(-0.212_174_209, 0.4819), (-0.024_005_899 - pitches[0], 0.2751)] {
            let touches = [0.0, 1.0].map(|ahead| (ahead, teeth.touch(phi1 + ahead * pitches[0]).unwrap()));
            let [entering, following] = touches.map(|(ahead, touch)| touch.phi2_rad - ahead * pitches[1]);
            let lead = entering.max(following);
            let candidates = touches.map(|(ahead, touch)| Candidate {
                tooth: ahead as i32,
                touch,
                behind_rad: lead - touch.phi2_rad + ahead * pitches[1],
            });
            let sharing = bodies.share(&candidates, 1300e3 / 50.0);
            assert!((sharing.shares[0] - wanted).abs() < 0.01, "{phi1}: {}", sharing.shares[0]);
            assert!((sharing.shares[0] + sharing.shares[1] - 1.0).abs() < 1e-9);
        }
    }
}
