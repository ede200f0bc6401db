//! Wear depth over the flanks of both gears, along Y, with its exact slope over the radius.

use super::archard;
use super::error::within;
use super::wear_table::{self, DepthCurve};
use super::{ArchardWear, Flank, Gear, GearError, GearPair, WearShape, WearSpec};

/// Number of flank points at which the wear is compared with the tooth's thickness.
const CHECKED_POINTS: usize = 200;

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

    /// Returns the turns of the driving gear that caused the wear, if its shape follows Archard's law: load
    /// cycles of each of its teeth.
    pub fn driving_turns(&self) -> Option<f64> {
        self.driving_turns
    }

    /// Creates wear in the shape of the pair's [`WearSpec`] with the largest depth `h_max_mm`.
    ///
    /// The pitch point of the parabolic shape is the operating one, where there is no sliding.
    ///
    /// # Errors
    /// [`GearError::Field`] for an invalid shape or depth, including a depth that leaves less than half of
    /// the tooth.
    pub fn from_shape(pair: &GearPair, h_max_mm: f64) -> Result<Self, GearError> {
        within("wear depth in mm", h_max_mm, 0.0, f64::MAX)?;
        let spec = &pair.spec.wear;
        let profiles = match spec.shape {
            WearShape::Parabolic => {
                pair.gears.each_ref().map(|gear| WearProfile::Parabolic(parabola(spec, gear, h_max_mm)))
            }
            WearShape::Floor => [WearProfile::Floor(h_max_mm), WearProfile::Floor(h_max_mm)],
            WearShape::Table => wear_table::from_points(&spec.table, h_max_mm)?.map(WearProfile::Table),
            WearShape::Archard => {
                let states = Self::from_shape_at(pair, &[h_max_mm])?;
                return Ok(states.into_iter().next().expect("one depth gives one state"));
            }
        };
        let wear = Self::new(profiles);
        wear.check_thickness(pair, h_max_mm)?;
        Ok(wear)
    }

    /// Creates wear in the shape of the pair's [`WearSpec`] at each of several ascending largest depths in
    /// mm. Faster than one by one for the shape `archard`, whose states follow from each other.
    ///
    /// # Errors
    /// As [`FlankWear::from_shape`].
    pub fn from_shape_at(pair: &GearPair, depths_mm: &[f64]) -> Result<Vec<Self>, GearError> {
        Self::from_shape_in_steps(pair, depths_mm, archard::STEP_MODULES)
    }

    /// Like [`from_shape_at`](Self::from_shape_at) in coarser steps of wear for the shape `archard`, twice as
    /// fast: for comparisons of many wear histories.
    ///
    /// # Errors
    /// As [`FlankWear::from_shape`].
    pub fn from_shape_coarse_at(pair: &GearPair, depths_mm: &[f64]) -> Result<Vec<Self>, GearError> {
        Self::from_shape_in_steps(pair, depths_mm, archard::COARSE_STEP_MODULES)
    }

    fn from_shape_in_steps(
        pair: &GearPair,
        depths_mm: &[f64],
        step_modules: f64,
    ) -> Result<Vec<Self>, GearError> {
        match pair.spec.wear.shape {
            WearShape::Archard => Ok(ArchardWear::at_depths(pair, depths_mm, step_modules)?
                .into_iter()
                .map(|state| Self { driving_turns: Some(state.driving_turns), ..state.wear })
                .collect()),
            _ => depths_mm.iter().map(|depth| Self::from_shape(pair, *depth)).collect(),
        }
    }

    /// Reads depths from CSV: header `gear,radius_mm,depth_um`, gear 1 or 2, radius of the unworn flank
    /// point, depth along Y, in any order. A gear without lines has no wear. Between the points the depth is
    /// a monotone cubic with a continuous slope; beyond them it is constant.
    ///
    /// # Errors
    /// [`GearError::WearTable`] with line, field and value; [`GearError::WearTableCsv`] for invalid CSV;
    /// [`GearError::Field`] for a depth that leaves less than half of the tooth.
    pub fn from_table_csv(pair: &GearPair, csv: &str) -> Result<Self, GearError> {
        let curves = wear_table::from_csv(csv, pair)?;
        let deepest = curves.iter().map(DepthCurve::deepest_mm).fold(0.0, f64::max);
        let wear = Self::new(curves.map(WearProfile::Table));
        wear.check_thickness(pair, deepest)?;
        Ok(wear)
    }

    /// Returns the depth in mm along Y of gear `index` (0 drives) at the unworn radius `radius_mm` in mm.
    pub fn depth_mm(&self, index: usize, radius_mm: f64) -> f64 {
        self.profiles[index].depth_and_slope(radius_mm).0
    }

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

/// Rejects invalid parameters of a shape, whatever its depth.
pub(super) fn check_shape(spec: &WearSpec) -> Result<(), GearError> {
    match spec.shape {
        WearShape::Parabolic => check_parabola(spec),
        WearShape::Table => wear_table::from_points(&spec.table, 1.0).map(drop),
        WearShape::Floor | WearShape::Archard => Ok(()),
    }
}

fn check_parabola(spec: &WearSpec) -> Result<(), GearError> {
    within("wear.floor", spec.floor, 0.0, 1.0)?;
    within("wear.tip_ratio", spec.tip_ratio, 0.0, 1.0)?;
    if !(spec.exponent > 1.0 && spec.exponent <= 20.0) {
        let expected = "above 1, so that the slope is continuous, and at most 20";
        return Err(GearError::field("wear.exponent", spec.exponent, expected));
    }
    Ok(())
}

fn parabola(spec: &WearSpec, gear: &Gear, h_max_mm: f64) -> Parabola {
    Parabola {
        h_max_mm,
        floor: spec.floor,
        tip_ratio: spec.tip_ratio,
        exponent: spec.exponent,
        pitch_mm: gear.pitch_radius_mm,
        sap_mm: gear.sap_radius_mm,
        tip_mm: gear.tip_radius_mm,
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{shen2022, shen2022_spec};
    use crate::{FlankWear, GearError, WearPoint, WearShape};

    #[test]
    fn parabolic_wear_has_its_given_depths() {
        let mut spec = shen2022_spec();
        (spec.wear.floor, spec.wear.tip_ratio, spec.wear.exponent) = (0.4, 0.5, 2.0);
        let pair = spec.resolve().unwrap();
        let wear = FlankWear::from_shape(&pair, 0.1).unwrap();
        for (gear, profile) in pair.gears.iter().zip(&wear.profiles) {
            let depth = |radius| profile.depth_and_slope(radius).0;
            let (sap, pitch, tip) = (gear.sap_radius_mm, gear.pitch_radius_mm, gear.tip_radius_mm);
            assert!((depth(sap) - 0.1).abs() < 1e-15);
            assert!((depth(0.5 * (sap + pitch)) - 0.1 * (0.4 + 0.6 * 0.25)).abs() < 1e-15);
            assert!((depth(pitch) - 0.04).abs() < 1e-15);
            assert!((depth(0.5 * (tip + pitch)) - 0.1 * (0.4 + 0.1 * 0.25)).abs() < 1e-15);
            assert!((depth(tip) - 0.05).abs() < 1e-15);
            assert_eq!(profile.depth_and_slope(sap - 1.0), (0.1, 0.0));
        }
        assert!((wear.greatest_depth_mm(&pair)[0] - 0.1).abs() < 1e-12);
    }

    #[test]
    fn a_floor_is_the_same_everywhere() {
        let mut spec = shen2022_spec();
        spec.wear.shape = WearShape::Floor;
        let pair = spec.resolve().unwrap();
        let wear = FlankWear::from_shape(&pair, 0.03).unwrap();
        assert_eq!(wear.profiles[1].depth_and_slope(80.0), (0.03, 0.0));
    }

    #[test]
    fn a_table_is_scaled_to_the_greatest_depth() {
        let mut spec = shen2022_spec();
        spec.wear.shape = WearShape::Table;
        let point = |gear, radius_mm, depth_um| WearPoint { gear, radius_mm, depth_um };
        spec.wear.table = vec![point(1, 78.0, 10.0), point(1, 70.0, 40.0), point(2, 80.0, 20.0)];
        let pair = spec.resolve().unwrap();
        let wear = FlankWear::from_shape(&pair, 0.1).unwrap();
        assert!((wear.profiles[0].depth_and_slope(60.0).0 - 0.1).abs() < 1e-15);
        assert!((wear.profiles[0].depth_and_slope(90.0).0 - 0.025).abs() < 1e-15);
        assert!((wear.profiles[1].depth_and_slope(77.0).0 - 0.05).abs() < 1e-15);
        let text = toml::to_string(&spec).unwrap();
        assert_eq!(crate::PairSpec::from_toml(&text).unwrap(), spec);
    }

    #[test]
    fn invalid_wear_is_rejected() {
        let pair = shen2022();
        for depth in [-0.01, f64::NAN, f64::INFINITY, 4.5] {
            let refusal = FlankWear::from_shape(&pair, depth).unwrap_err();
            assert!(matches!(refusal, GearError::Field { field: "wear depth in mm", .. }), "{refusal}");
        }
        let mut spec = shen2022_spec();
        for exponent in [1.0, 0.0, f64::NAN, 50.0] {
            spec.wear.exponent = exponent;
            assert!(spec.resolve().unwrap_err().to_string().starts_with("wear.exponent"));
        }
    }
}
