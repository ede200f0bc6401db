//! Stiffness of one pair of teeth, Eq. (27).

use std::f64::consts::PI;

use super::tooth::{Tooth, ToothCompliance};
use super::{Flank, FlankPoint, FlankWear, GearPair};

/// Stiffness of single pairs of teeth of a gear pair with its wear.
#[derive(Debug)]
pub struct PairStiffness<'a> {
    flanks: [Flank<'a>; 2],
    teeth: [Tooth<'a>; 2],
    /// Compliance 1/k_h of the contact.
    hertz_mm_per_n: f64,
}

impl<'a> PairStiffness<'a> {
    /// Computes the sections' integrals once, for any number of contact points.
    pub fn new(pair: &'a GearPair, wear: &'a FlankWear) -> Self {
        let flanks = [Flank::new(&pair.gears[0], wear, 0), Flank::new(&pair.gears[1], wear, 1)];
        let material = &pair.spec.material;
        let width = pair.spec.geometry.face_width_mm;
        Self {
            teeth: flanks.clone().map(|flank| Tooth::new(flank, material, width)),
            flanks,
            // k_h = π E L / (4 (1 − ν²)), for two gears of one material.
            hertz_mm_per_n: 4.0 * (1.0 - material.poisson_ratio.powi(2))
                / (PI * material.youngs_modulus_pa * 1e-6 * width),
        }
    }

    /// Returns the stiffness in N/m of the pair of teeth in contact at α₁ = `alpha1_rad` and α₁′ =
    /// `alpha1_prime_rad`.
    pub fn single_pair_n_per_m(&self, alpha1_rad: f64, alpha1_prime_rad: f64) -> f64 {
        let [driving, driven] = self.teeth_compliances(alpha1_rad, alpha1_prime_rad);
        1e3 / (self.hertz_mm_per_n + driving.total_mm_per_n() + driven.total_mm_per_n())
    }

    /// Returns the compliances of the driving and the driven tooth.
    pub fn teeth_compliances(&self, alpha1_rad: f64, alpha1_prime_rad: f64) -> [ToothCompliance; 2] {
        let loads: [FlankPoint; 2] = [self.flanks[0].at(alpha1_rad), self.flanks[1].at(alpha1_prime_rad)];
        [self.teeth[0].compliance(&loads[0]), self.teeth[1].compliance(&loads[1])]
    }
}
