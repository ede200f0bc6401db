//! Approach of two flanks along their contact line: Hertz's, and that of a tip edge on the other flank.
//!
//! Both bodies are half-planes here. The smaller body may end at an edge, from which the gap is g(t) = β t +
//! κ t²/2. The pressure on 0 < t < c that closes it is √((1 − ξ)/(1 + ξ)) (A + B ξ) with t = c (1 + ξ)/2,
//! which gives everything below in closed form. At β = −κ c/2 the pressure at the edge is no longer singular:
//! from there on the edge has no effect and the contact is Hertz's.

use std::f64::consts::PI;

/// Geometry of one contact line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LineContact {
    /// Relative curvature κ of the flanks in 1/mm, above zero.
    pub(super) curvature_per_mm: f64,
    /// Angle β in rad between the flanks at the nearest tip edge: positive if the edge itself touches first,
    /// else −κ times its distance from the first point of contact.
    pub(super) edge_angle_rad: f64,
}

/// Effect of a force on the contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Approach {
    /// Displacement in mm of the bodies relative to the half-planes' own at 1 mm.
    pub(super) depth_mm: f64,
    /// Distance in mm of the centre of pressure from the edge.
    pub(super) centre_mm: f64,
}

impl LineContact {
    /// Returns the approach under a force in N/mm, with E* in MPa.
    pub(super) fn approach(&self, force_n_per_mm: f64, contact_modulus_mpa: f64) -> Approach {
        let (curvature, angle) = (self.curvature_per_mm, self.edge_angle_rad);
        // P/(π E*): the unit of both displacement and width.
        let unit = force_n_per_mm / (PI * contact_modulus_mpa);
        let half_width = (4.0 * unit / curvature).sqrt();
        let from_edge = -angle / curvature;
        if from_edge >= half_width {
            return Approach { depth_mm: 2.0 * unit * ((2.0 / half_width).ln() + 0.5), centre_mm: from_edge };
        }
        // P = π E* c/4 (β + 3 κ c/4); the form without cancellation for β > 0.
        let root = (angle * angle + 12.0 * curvature * unit).sqrt();
        let width =
            if angle > 0.0 { 8.0 * unit / (root + angle) } else { (root - angle) / (1.5 * curvature) };
        // In units of E*.
        let linear = 0.25 * curvature * width;
        let constant = 0.5 * (angle + 0.5 * curvature * width) + linear;
        // Measured from the point that touches first, which is beside the edge for β < 0.
        let beside = if angle < 0.0 { 0.5 * angle * angle / curvature } else { 0.0 };
        Approach {
            depth_mm: 2.0 * unit * (4.0 / width).ln() + width * (constant - 1.25 * linear) + beside,
            centre_mm: 0.25 * width * constant / (constant - 0.5 * linear),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::LineContact;

    /// Johnson, Contact Mechanics, Eq. (5.57): each body's compression between surface and depth d under
    /// Hertz's pressure is P (1 − ν²)/(πE) (2 ln(2d/b) − ν/(1 − ν)), and the half-plane's displacement at
    /// depth d is P (1 + ν)/(πE) (1 − 2(1 − ν) ln d).
    #[test]
    fn contact_far_from_the_edge_is_hertzian() {
        let (young, poisson, force, curvature) = (205e3, 0.3, 400.0, 0.09);
        let modulus = young / (2.0 * (1.0 - poisson * poisson));
        let contact = LineContact { curvature_per_mm: curvature, edge_angle_rad: -1.0 };
        let half_width = (4.0 * force / (std::f64::consts::PI * modulus * curvature)).sqrt();
        let depth: f64 = 1.7;
        let compression = force * (1.0 - poisson * poisson) / (std::f64::consts::PI * young)
            * (2.0 * (2.0 * depth / half_width).ln() - poisson / (1.0 - poisson));
        let at_depth = force * (1.0 + poisson) / (std::f64::consts::PI * young)
            * (1.0 - 2.0 * (1.0 - poisson) * depth.ln());
        let approach = contact.approach(force, modulus);
        assert!((approach.depth_mm - 2.0 * (compression + at_depth)).abs() < 1e-15);
    }

    #[test]
    fn edge_and_hertz_join_smoothly() {
        let (modulus, force, curvature) = (112_637.0, 400.0, 0.09_f64);
        let half_width = (4.0 * force / (std::f64::consts::PI * modulus * curvature)).sqrt();
        let at = |angle: f64| {
            LineContact { curvature_per_mm: curvature, edge_angle_rad: angle }.approach(force, modulus)
        };
        let limit = -curvature * half_width;
        let (inside, outside) = (at(limit * (1.0 + 1e-9)), at(limit * (1.0 - 1e-9)));
        assert!((inside.depth_mm - outside.depth_mm).abs() < 1e-9 * inside.depth_mm);
        assert!((inside.centre_mm - outside.centre_mm).abs() < 1e-6 * half_width);
        let (before, after) = (at(-1e-9), at(1e-9));
        assert!((before.depth_mm - after.depth_mm).abs() < 1e-7 * after.depth_mm);
        // A blunter edge gives way less.
        assert!(at(0.01).depth_mm < at(0.05).depth_mm && at(limit).depth_mm < at(0.0).depth_mm);
    }

    /// With κ → 0 a wedge's edge: P = π E* c β/4 and the pressure √((c − t)/t), whose approach is 2P/(πE*)
    /// (ln(4/c) + 1).
    #[test]
    fn a_straight_edge_is_known_in_closed_form() {
        let (modulus, force, angle) = (112_637.0, 250.0, 0.03);
        let contact = LineContact { curvature_per_mm: 1e-12, edge_angle_rad: angle };
        let width = 4.0 * force / (std::f64::consts::PI * modulus * angle);
        let wanted = 2.0 * force / (std::f64::consts::PI * modulus) * ((4.0 / width).ln() + 1.0);
        let approach = contact.approach(force, modulus);
        assert!((approach.depth_mm / wanted - 1.0).abs() < 1e-9);
        assert!((approach.centre_mm / (0.25 * width) - 1.0).abs() < 1e-9);
    }
}
