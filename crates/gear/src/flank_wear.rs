//! Wear depth over the flanks of both gears, along Y, with its exact slope over the radius.

use super::wear_table::DepthCurve;
use super::{Gear, WearSpec};

/// Wear depth of one flank over the radius s in mm of its unworn points.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum WearProfile {
    /// No wear.
    None,
    /// The same depth in mm everywhere.
    Floor(f64),
    /// Least at the pitch point.
    Parabolic(Parabola),
    /// A table.
    Table(DepthCurve),
}

/// The parabolic shape of [`WearSpec`], radii in mm.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Parabola {
    h_max_mm: f64,
    floor: f64,
    tip_ratio: f64,
    exponent: f64,
    pitch_mm: f64,
    sap_mm: f64,
    tip_mm: f64,
}

impl Parabola {
    pub(super) fn new(spec: &WearSpec, gear: &Gear, h_max_mm: f64) -> Self {
        Self {
            h_max_mm,
            floor: spec.floor,
            tip_ratio: spec.tip_ratio,
            exponent: spec.exponent,
            pitch_mm: gear.pitch_radius_mm,
            sap_mm: gear.sap_radius_mm,
            tip_mm: gear.tip_radius_mm,
        }
    }

    fn depth_and_slope(&self, radius_mm: f64) -> (f64, f64) {
        let (rise, length, sign) = if radius_mm < self.pitch_mm {
            (1.0 - self.floor, self.pitch_mm - self.sap_mm, -1.0)
        } else {
            (self.tip_ratio - self.floor, self.tip_mm - self.pitch_mm, 1.0)
        };
        // If the pitch point lies outside the active profile, that side has no length.
        if length <= 0.0 {
            return (self.h_max_mm * self.floor, 0.0);
        }
        let part = (radius_mm - self.pitch_mm).abs() / length;
        if sign < 0.0 && part > 1.0 + 1e-12 {
            return (self.h_max_mm * (self.floor + rise), 0.0);
        }
        let power = part.powf(self.exponent - 1.0);
        (
            self.h_max_mm * (self.floor + rise * power * part),
            self.h_max_mm * rise * self.exponent * power * sign / length,
        )
    }
}

impl WearProfile {
    /// Returns the depth h in mm and dh/ds at the unworn radius `radius_mm`.
    pub(super) fn depth_and_slope(&self, radius_mm: f64) -> (f64, f64) {
        match self {
            Self::None => (0.0, 0.0),
            Self::Floor(depth) => (*depth, 0.0),
            Self::Parabolic(parabola) => parabola.depth_and_slope(radius_mm),
            Self::Table(curve) => curve.depth_and_slope(radius_mm),
        }
    }

    /// Returns the radii in mm at which a derivative of the depth is discontinuous: quadrature intervals end
    /// there.
    pub(super) fn kinks_mm(&self) -> Vec<f64> {
        match self {
            Self::None | Self::Floor(_) => Vec::new(),
            Self::Parabolic(parabola) => vec![parabola.sap_mm, parabola.pitch_mm],
            Self::Table(curve) => curve.radii_mm().to_vec(),
        }
    }
}

/// Wear of the driving and the driven gear's working flanks: depth along Y over the radius of the unworn
/// flank point. Below the active profile it equals that at its end.
#[derive(Debug, Clone, PartialEq)]
pub struct FlankWear {
    pub(super) profiles: [WearProfile; 2],
    driving_turns: Option<f64>,
}

impl FlankWear {
    /// Returns perfect flanks.
    pub fn none() -> Self {
        Self::new([WearProfile::None, WearProfile::None])
    }

    pub(super) fn new(profiles: [WearProfile; 2]) -> Self {
        Self { profiles, driving_turns: None }
    }

    pub(super) fn after_turns(self, driving_turns: f64) -> Self {
        Self { driving_turns: Some(driving_turns), ..self }
    }

    /// Returns the turns of the driving gear that caused the wear, if its shape follows Archard's law: load
    /// cycles of each of its teeth.
    pub fn driving_turns(&self) -> Option<f64> {
        self.driving_turns
    }

    /// Returns the depth in mm along Y of gear `index` (0 drives) at the unworn radius `radius_mm` in mm.
    pub fn depth_mm(&self, index: usize, radius_mm: f64) -> f64 {
        self.profiles[index].depth_and_slope(radius_mm).0
    }
}
