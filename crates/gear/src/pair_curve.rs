//! One pair of teeth over the rotation: the mesh relationship and the stiffness, interpolated between the
//! solved points.

use super::{FlankWear, GearError, GearPair, MeshRelationship, PairStiffness};

/// Rounding of φ₁ in rad at the ends of a pair's contact.
const ROUNDING_RAD: f64 = 1e-12;

/// φ₂ and stiffness of one pair of teeth over φ₁, wherever it is in contact.
#[derive(Debug)]
pub(super) struct PairCurve {
    relationship: MeshRelationship,
    stiffness_n_per_m: Vec<f64>,
    /// Smallest and largest φ₁.
    range: (f64, f64),
    /// Whether φ₁ increases throughout.
    rising: bool,
}

impl PairCurve {
    pub(super) fn new(pair: &GearPair, wear: &FlankWear) -> Result<Self, GearError> {
        let relationship = MeshRelationship::solve(pair, wear)?;
        let stiffness = PairStiffness::new(pair, wear);
        let contacts = relationship.alpha1_rad.iter().zip(&relationship.alpha1_prime_rad);
        let phi1 = &relationship.phi1_rad;
        Ok(Self {
            stiffness_n_per_m: contacts
                .map(|(alpha1, prime)| stiffness.single_pair_n_per_m(*alpha1, *prime))
                .collect(),
            range: phi1.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), phi1| {
                (least.min(*phi1), most.max(*phi1))
            }),
            rising: phi1.windows(2).all(|two| two[0] < two[1]),
            relationship,
        })
    }

    /// Returns the smallest and largest φ₁ in rad at which the pair is in contact.
    pub(super) fn range(&self) -> (f64, f64) {
        self.range
    }

    /// Returns α₁ in rad and stiffness in N/m of every solved contact.
    pub(super) fn contacts(&self) -> impl Iterator<Item = (f64, f64)> {
        let alphas = self.relationship.alpha1_rad.iter();
        alphas.copied().zip(self.stiffness_n_per_m.iter().copied())
    }

    /// Returns φ₂ in rad and stiffness in N/m of the single pair at φ₁, if it is in contact.
    pub(super) fn at(&self, phi1: f64) -> Option<(f64, f64)> {
        self.cell(phi1).map(|(i, phi1)| self.interpolate(i, phi1))
    }

    /// Returns the node below φ₁, and φ₁ clamped to the range, if the pair is in contact.
    fn cell(&self, phi1: f64) -> Option<(usize, f64)> {
        if phi1 < self.range.0 - ROUNDING_RAD || phi1 > self.range.1 + ROUNDING_RAD {
            return None;
        }
        let phi1 = phi1.clamp(self.range.0, self.range.1);
        let nodes = &self.relationship.phi1_rad;
        if self.rising {
            let after = nodes.partition_point(|node| *node <= phi1).clamp(1, nodes.len() - 1);
            return Some((after - 1, phi1));
        }
        // Worn flanks can have several branches: the one that advances the driven gear most is in contact.
        (0..nodes.len() - 1)
            .filter(|i| nodes[*i] <= phi1 && phi1 <= nodes[i + 1] && nodes[*i] < nodes[i + 1])
            .max_by(|a, b| self.interpolate(*a, phi1).0.total_cmp(&self.interpolate(*b, phi1).0))
            .map(|i| (i, phi1))
    }

    /// Interpolates between nodes `i` and `i` + 1: φ₂ by the cubic with the exact slopes at both, the
    /// stiffness linearly.
    fn interpolate(&self, i: usize, phi1: f64) -> (f64, f64) {
        let MeshRelationship { phi1_rad: x, phi2_rad: y, phi2_slope: slope, .. } = &self.relationship;
        let width = x[i + 1] - x[i];
        let t = (phi1 - x[i]) / width;
        let rise = y[i + 1] - y[i];
        let (m0, m1) = (slope[i] * width, slope[i + 1] * width);
        let phi2 = y[i] + t * (m0 + t * (3.0 * rise - 2.0 * m0 - m1 + t * (m0 + m1 - 2.0 * rise)));
        let k = &self.stiffness_n_per_m;
        (phi2, k[i] + t * (k[i + 1] - k[i]))
    }
}
