//! Outline of a whole unworn tooth in its own coordinates X (centre line) and Y: involute, fillet and root
//! circle as the basic rack cuts them.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use super::GearPair;

/// Tip radius of the basic rack in modules (ISO 53, profile A).
const RACK_TIP_RADIUS_MODULES: f64 = 0.38;
/// Largest bottom clearance of the basic rack in modules, used by the tip rounding.
const RACK_CLEARANCE_MODULES: f64 = 0.25;

/// A point in the tooth's coordinates in mm.
pub(super) type Point = [f64; 2];

/// Involute flank and trochoid fillet of one gear's teeth.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ToothOutline {
    /// Angle between two teeth in rad.
    pub(super) pitch_angle_rad: f64,
    /// Tip radius in mm.
    pub(super) tip_radius_mm: f64,
    /// Radius in mm where the involute ends in the fillet.
    pub(super) form_radius_mm: f64,
    /// Root radius in mm.
    pub(super) root_radius_mm: f64,
    base_radius_mm: f64,
    base_half_angle_rad: f64,
    reference_radius_mm: f64,
    pressure_angle_rad: f64,
    /// Rack tip's centre of rounding: depth below the rolling line, distance from the rack tooth's centre
    /// line, radius; in mm.
    rounding_depth_mm: f64,
    rounding_offset_mm: f64,
    rounding_mm: f64,
}

impl ToothOutline {
    /// Outline of gear `i` (0 or 1) of the pair.
    ///
    /// The rack's tip radius is 0.38 modules, or less if the clearance or the width of the rack's tooth does
    /// not allow it.
    pub(super) fn new(pair: &GearPair, i: usize) -> Self {
        let basic = &pair.spec.geometry;
        let gear = &pair.gears[i];
        let module = basic.module_mm;
        let alpha = basic.pressure_angle_deg.to_radians();
        let depth = basic.dedendum[i] * module;
        let half_tip = FRAC_PI_4 * module - depth * alpha.tan();
        let clearance = (basic.dedendum[i] - basic.addendum[1 - i]).clamp(0.0, RACK_CLEARANCE_MODULES);
        // The standard's 0.38 is rounded up from the value for its clearance, hence the factor 1.01.
        let rounding_mm = (RACK_TIP_RADIUS_MODULES * module)
            .min(clearance * module / (1.0 - alpha.sin()) * (1.0 + 1e-2))
            .min(half_tip * alpha.cos() / (1.0 - alpha.sin()));
        let mut outline = Self {
            pitch_angle_rad: gear.pitch_angle_rad(),
            tip_radius_mm: gear.tip_radius_mm,
            form_radius_mm: 0.0,
            root_radius_mm: gear.root_radius_mm,
            base_radius_mm: gear.base_radius_mm,
            base_half_angle_rad: gear.base_half_angle_rad,
            reference_radius_mm: gear.reference_radius_mm,
            pressure_angle_rad: alpha,
            rounding_depth_mm: depth - rounding_mm - basic.profile_shift[i] * module,
            rounding_offset_mm: half_tip - rounding_mm * (1.0 - alpha.sin()) / alpha.cos(),
            rounding_mm,
        };
        let [x, y] = outline.fillet(alpha);
        outline.form_radius_mm = x.hypot(y).max(gear.base_radius_mm * (1.0 + 1e-9));
        outline
    }

    /// Returns the point of the involute at a radius in mm, not below the base circle.
    pub(super) fn flank(&self, radius_mm: f64) -> Point {
        let (sin, cos) = self.half_angle(radius_mm).sin_cos();
        [radius_mm * cos, radius_mm * sin]
    }

    /// Returns λ in rad of the involute's normal at a radius: (sin λ, cos λ) points out of the tooth.
    pub(super) fn inclination(&self, radius_mm: f64) -> f64 {
        self.profile_angle(radius_mm) - self.half_angle(radius_mm)
    }

    /// Returns the pressure angle in rad of the involute at a radius.
    pub(super) fn profile_angle(&self, radius_mm: f64) -> f64 {
        (self.base_radius_mm / radius_mm).min(1.0).acos()
    }

    /// Returns the point of the fillet that the rack's rounding cuts with its normal at `normal_rad` to the
    /// rolling line: from the pressure angle, where the involute ends, to π/2, where the root circle begins.
    pub(super) fn fillet(&self, normal_rad: f64) -> Point {
        let (sin, cos) = normal_rad.sin_cos();
        // The contact's normal passes through the pitch point.
        let pitch_point = self.rounding_offset_mm - self.rounding_depth_mm * cos / sin;
        let across = self.rounding_offset_mm + self.rounding_mm * cos - pitch_point;
        let up = self.reference_radius_mm - self.rounding_depth_mm - self.rounding_mm * sin;
        let from_space = across.atan2(up) + pitch_point / self.reference_radius_mm;
        let angle = 0.5 * self.pitch_angle_rad - from_space;
        let radius = across.hypot(up);
        [radius * angle.cos(), radius * angle.sin()]
    }

    /// Returns the normal of the rounding in rad at a fraction of the fillet, 0 at the involute and 1 at the
    /// root circle.
    pub(super) fn fillet_normal(&self, part: f64) -> f64 {
        self.pressure_angle_rad + (FRAC_PI_2 - self.pressure_angle_rad) * part
    }

    fn half_angle(&self, radius_mm: f64) -> f64 {
        let angle = self.profile_angle(radius_mm);
        self.base_half_angle_rad - (angle.tan() - angle)
    }
}

impl GearPair {
    /// Returns half of an unworn tooth of gear `i` (0 drives) in its own coordinates in mm, centre line and
    /// half of the thickness: from the root circle in the middle of the space up the fillet and the flank,
    /// `points` of each, to the tip.
    pub fn tooth_profile_mm(&self, i: usize, points: usize) -> Vec<[f64; 2]> {
        let outline = ToothOutline::new(self, i);
        let middle = 0.5 * outline.pitch_angle_rad;
        let count = points.max(2) - 1;
        let part = |place: usize| place as f64 / count as f64;
        let root = [outline.root_radius_mm * middle.cos(), outline.root_radius_mm * middle.sin()];
        let fillet = (0..=count).map(|place| outline.fillet(outline.fillet_normal(1.0 - part(place))));
        let tip = outline.tip_radius_mm;
        let form = outline.form_radius_mm.min(tip);
        let flank = (1..=count).map(|place| outline.flank(form + (tip - form) * part(place)));
        std::iter::once(root).chain(fillet).chain(flank).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::ToothOutline;
    use crate::PairSpec;

    /// Table 1 of the paper; form and root radius of gear 1 from a Python script of the rack's generation:
    /// 68.0276, 64.5 mm.
    #[test]
    fn fillet_joins_involute_and_root_circle() {
        let pair = PairSpec::from_toml(include_str!("../../../fixtures/pairs/shen2022.toml"))
            .unwrap()
            .resolve()
            .unwrap();
        let outline = ToothOutline::new(&pair, 0);
        assert!((outline.form_radius_mm - 68.027_632_593).abs() < 1e-8, "{}", outline.form_radius_mm);
        let [x, y] = outline.fillet(outline.fillet_normal(0.0));
        let [flank_x, flank_y] = outline.flank(outline.form_radius_mm);
        assert!(
            (x - flank_x).hypot(y - flank_y) < 1e-9,
            "the fillet starts {x} {y}, the involute {flank_x} {flank_y}"
        );
        let [x, y] = outline.fillet(outline.fillet_normal(1.0));
        assert!((x.hypot(y) - 64.5).abs() < 1e-9);
        assert!((y.atan2(x) - 0.125_536_651_729).abs() < 1e-9);
        let profile = pair.tooth_profile_mm(0, 8);
        assert_eq!(profile.len(), 1 + 8 + 7);
        let radius = |[x, y]: [f64; 2]| x.hypot(y);
        assert!((radius(profile[0]) - 64.5).abs() < 1e-9 && (radius(profile[15]) - 78.0).abs() < 1e-9);
        assert!(profile.windows(2).all(|two| two[0][1] > two[1][1]), "it narrows from root to tip");
    }
}
