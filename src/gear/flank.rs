//! One flank in the tooth's own coordinates X (the tooth's centre line) and Y: the perfect involute and what wear leaves of it.

use super::wear::WearProfile;
use super::{FlankWear, Gear};

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
    /// Distance of the gear's centre from the worn point's normal: R_b on a perfect flank.
    pub fn normal_arm_mm(&self) -> f64 {
        let (sin, cos) = self.lambda_sin_cos;
        self.x_mm * cos - (self.y_mm - self.depth_mm) * sin
    }

    /// Distance of the worn point from the foot of the centre's perpendicular on its normal: R_b (α₂ + α₁) on a perfect flank.
    pub fn normal_length_mm(&self) -> f64 {
        let (sin, cos) = self.lambda_sin_cos;
        self.x_mm * sin + (self.y_mm - self.depth_mm) * cos
    }

    /// γ, Eqs. (3) and (7): angle of the worn point against the tooth's centre line.
    pub fn gamma_rad(&self) -> f64 {
        (self.y_mm - self.depth_mm).atan2(self.x_mm)
    }

    /// R_A, Eqs. (4) and (8): radius of the worn point.
    pub fn worn_radius_mm(&self) -> f64 {
        self.x_mm.hypot(self.y_mm - self.depth_mm)
    }
}

impl<'a> Flank<'a> {
    /// The flank of `gear`, number `index` (0 or 1) of its pair, with `wear`.
    ///
    /// # Panics
    /// Where `index` is neither 0 nor 1.
    pub fn new(gear: &'a Gear, wear: &'a FlankWear, index: usize) -> Self {
        Self {
            gear,
            wear: &wear.profiles[index],
        }
    }

    /// The point at α₁ = `alpha_rad`, from −α₂ (the base circle) on.
    pub fn at(&self, alpha_rad: f64) -> FlankPoint {
        let base = self.gear.base_radius_mm;
        let (sin, cos) = alpha_rad.sin_cos();
        // The length unrolled from the base circle, in base radii: tan of the pressure angle at the point.
        let roll = alpha_rad + self.gear.base_half_angle_rad;
        let secant = (1.0 + roll * roll).sqrt();
        let radius_mm = base * secant;
        let (depth_mm, depth_over_radius) = self.wear.depth_and_slope(radius_mm);
        // ds/dα = R_b roll/secant and dx/dα = R_b roll cos α, so ds/dx has no zero over zero at the base circle.
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

    /// Depth in mm at the unworn radius `radius_mm`, below the base circle too.
    pub(super) fn depth_at_radius_mm(&self, radius_mm: f64) -> f64 {
        self.wear.depth_and_slope(radius_mm).0
    }

    /// α₁ of the unworn point at a radius in mm, not below the base circle.
    pub(super) fn alpha_at_radius_rad(&self, radius_mm: f64) -> f64 {
        let ratio = radius_mm / self.gear.base_radius_mm;
        (ratio * ratio - 1.0).max(0.0).sqrt() - self.gear.base_half_angle_rad
    }

    /// Angles in rad where a derivative of the wear jumps.
    pub(super) fn kinks_rad(&self) -> Vec<f64> {
        self.wear
            .kinks_mm()
            .into_iter()
            .map(|radius| self.alpha_at_radius_rad(radius))
            .collect()
    }

    /// `count` + 1 points evenly over α₁ from the start of active profile to the tip.
    pub fn active_points(&self, count: usize) -> impl Iterator<Item = FlankPoint> + '_ {
        let (root, tip) = (self.gear.root_angle_rad, self.gear.tip_angle_rad);
        (0..=count).map(move |i| self.at(root + (tip - root) * i as f64 / count as f64))
    }
}
