//! One flank in the tooth's own coordinates X (the tooth's centre line) and Y: the perfect involute and the
//! worn profile.

use super::flank_wear::WearProfile;
use super::{FlankWear, Gear, GearError, GearPair};

/// Number of flank points at which the wear is compared with the tooth's thickness.
const CHECKED_POINTS: usize = 200;

/// A flank of one gear with its wear.
#[derive(Debug, Clone)]
pub struct Flank<'a> {
    /// The gear.
    pub gear: &'a Gear,
    wear: &'a WearProfile,
}

/// A point of a flank, Eqs. (1)–(8), (18)–(21); lengths in mm, angles in rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlankPoint {
    /// α₁ of the unworn point: angle of its normal against Y.
    pub alpha_rad: f64,
    /// Radius R_A,perfect of the unworn point.
    pub radius_mm: f64,
    /// Coordinate x along the tooth's centre line, the same for worn and unworn.
    pub x_mm: f64,
    /// Coordinate y = g(x) of the unworn point, half the tooth's thickness.
    pub y_mm: f64,
    /// Wear depth h along Y.
    pub depth_mm: f64,
    /// Slope dh/dx.
    pub depth_slope: f64,
    /// λ: angle of the worn flank's normal against Y, arctan(tan α₁ + dh/dx).
    pub lambda_rad: f64,
    /// sin λ and cos λ.
    pub lambda_sin_cos: (f64, f64),
}

impl FlankPoint {
    /// Returns the distance of the gear's centre from the worn point's normal: R_b on a perfect flank.
    pub fn normal_arm_mm(&self) -> f64 {
        let (sin, cos) = self.lambda_sin_cos;
        self.x_mm * cos - (self.y_mm - self.depth_mm) * sin
    }

    /// Returns the distance of the worn point from the foot of the centre's perpendicular on its normal: R_b
    /// (α₂ + α₁) on a perfect flank.
    pub fn normal_length_mm(&self) -> f64 {
        let (sin, cos) = self.lambda_sin_cos;
        self.x_mm * sin + (self.y_mm - self.depth_mm) * cos
    }

    /// Returns γ, Eqs. (3) and (7): angle of the worn point against the tooth's centre line.
    pub fn gamma_rad(&self) -> f64 {
        (self.y_mm - self.depth_mm).atan2(self.x_mm)
    }

    /// Returns R_A, Eqs. (4) and (8): radius of the worn point.
    pub fn worn_radius_mm(&self) -> f64 {
        self.x_mm.hypot(self.y_mm - self.depth_mm)
    }
}

impl<'a> Flank<'a> {
    /// Creates the flank of `gear`, number `index` (0 or 1) of its pair, with `wear`.
    ///
    /// # Panics
    /// If `index` is neither 0 nor 1.
    pub fn new(gear: &'a Gear, wear: &'a FlankWear, index: usize) -> Self {
        Self { gear, wear: &wear.profiles[index] }
    }

    /// Returns the point at α₁ = `alpha_rad`, from −α₂ (the base circle) on.
    pub fn at(&self, alpha_rad: f64) -> FlankPoint {
        let base = self.gear.base_radius_mm;
        let (sin, cos) = alpha_rad.sin_cos();
        // The length unrolled from the base circle, in base radii: tan of the pressure angle at the point.
        let roll = alpha_rad + self.gear.base_half_angle_rad;
        let secant = (1.0 + roll * roll).sqrt();
        let radius_mm = base * secant;
        let (depth_mm, depth_over_radius) = self.wear.depth_and_slope(radius_mm);
        // ds/dα = R_b roll/secant and dx/dα = R_b roll cos α, so ds/dx has no zero over zero at the base
        // circle.
        let depth_slope = depth_over_radius / (secant * cos);
        let tan = sin / cos + depth_slope;
        let lambda_cos = 1.0 / (1.0 + tan * tan).sqrt();
        FlankPoint {
            alpha_rad,
            radius_mm,
            x_mm: base * (roll * sin + cos),
            y_mm: base * (roll * cos - sin),
            depth_mm,
            depth_slope,
            lambda_rad: tan.atan(),
            lambda_sin_cos: (tan * lambda_cos, lambda_cos),
        }
    }

    /// Returns α₁ of the unworn point at a radius in mm, not below the base circle.
    pub(super) fn alpha_at_radius_rad(&self, radius_mm: f64) -> f64 {
        let ratio = radius_mm / self.gear.base_radius_mm;
        (ratio * ratio - 1.0).max(0.0).sqrt() - self.gear.base_half_angle_rad
    }

    /// Returns the angles in rad at which a derivative of the wear is discontinuous.
    pub(super) fn kinks_rad(&self) -> Vec<f64> {
        self.wear.kinks_mm().into_iter().map(|radius| self.alpha_at_radius_rad(radius)).collect()
    }

    /// Returns `count` + 1 points at equal steps of α₁ from the start of active profile to the tip.
    pub fn active_points(&self, count: usize) -> impl Iterator<Item = FlankPoint> + '_ {
        let (root, tip) = (self.gear.root_angle_rad, self.gear.tip_angle_rad);
        (0..=count).map(move |i| self.at(root + (tip - root) * i as f64 / count as f64))
    }
}

impl FlankWear {
    /// Returns the largest depth in mm on the active profiles of gear 1 and gear 2.
    pub fn greatest_depth_mm(&self, pair: &GearPair) -> [f64; 2] {
        [0, 1].map(|i| {
            let flank = Flank::new(&pair.gears[i], self, i);
            flank.active_points(CHECKED_POINTS).map(|point| point.depth_mm).fold(0.0, f64::max)
        })
    }

    /// Rejects wear beyond the tooth's centre line.
    pub(super) fn check_thickness(&self, pair: &GearPair, h_max_mm: f64) -> Result<(), GearError> {
        for (i, gear) in pair.gears.iter().enumerate() {
            for point in Flank::new(gear, self, i).active_points(CHECKED_POINTS) {
                if point.y_mm - point.depth_mm <= 0.0 {
                    let expected = format!(
                        "a smaller depth: at radius {:.3} mm of gear {} the wear is {:.4} mm and half of the tooth is {:.4} mm",
                        point.radius_mm,
                        i + 1,
                        point.depth_mm,
                        point.y_mm
                    );
                    return Err(GearError::field("wear depth in mm", h_max_mm, expected));
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{shen2022, typical_wear};
    use super::Flank;
    use crate::FlankWear;

    #[test]
    fn perfect_points_obey_equations_1_and_2() {
        let (pair, wear) = (shen2022(), FlankWear::none());
        for (i, gear) in pair.gears.iter().enumerate() {
            for point in Flank::new(gear, &wear, i).active_points(50) {
                let gamma = (gear.base_half_angle_rad + point.alpha_rad).atan() - point.alpha_rad;
                let radius = gear.base_radius_mm / (point.alpha_rad + gamma).cos();
                assert!((point.gamma_rad() - gamma).abs() < 1e-14);
                assert!((point.worn_radius_mm() - radius).abs() < 1e-12);
                assert!((point.radius_mm - radius).abs() < 1e-12);
                // The normal of an involute touches its base circle.
                assert!((point.normal_arm_mm() - gear.base_radius_mm).abs() < 1e-12);
                assert!((point.lambda_rad - point.alpha_rad).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn worn_points_obey_equations_3_and_4() {
        let (pair, wear) = typical_wear();
        for point in Flank::new(&pair.gears[0], &wear, 0).active_points(50) {
            let perfect = point.y_mm.atan2(point.x_mm);
            let gamma = ((point.radius_mm * perfect.sin() - point.depth_mm)
                / (point.radius_mm * perfect.cos()))
            .atan();
            assert!((point.gamma_rad() - gamma).abs() < 1e-14);
            assert!((point.worn_radius_mm() - point.radius_mm * perfect.cos() / gamma.cos()).abs() < 1e-12);
        }
    }

    #[test]
    fn slope_of_the_wear_is_the_derivative_along_x() {
        let (pair, wear) = typical_wear();
        for (i, gear) in pair.gears.iter().enumerate() {
            let flank = Flank::new(gear, &wear, i);
            let step = 1e-6;
            for k in 1..40 {
                let alpha = gear.root_angle_rad
                    + (gear.tip_angle_rad - gear.root_angle_rad) * (f64::from(k) + 0.3) / 41.0;
                let (before, point, after) =
                    (flank.at(alpha - step), flank.at(alpha), flank.at(alpha + step));
                let differenced = (after.depth_mm - before.depth_mm) / (after.x_mm - before.x_mm);
                assert!(
                    (differenced - point.depth_slope).abs() < 1e-8,
                    "{differenced} {}",
                    point.depth_slope
                );
                // Eq. (19): the worn flank's own tangent.
                let tangent = ((after.y_mm - after.depth_mm) - (before.y_mm - before.depth_mm))
                    / (after.x_mm - before.x_mm);
                assert!((tangent + point.lambda_rad.tan()).abs() < 1e-8);
            }
        }
    }
}
