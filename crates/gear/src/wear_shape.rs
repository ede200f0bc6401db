//! Wear in the shape that a pair file or a table describes.

use super::archard;
use super::error::at_least;
use super::flank_wear::{Parabola, WearProfile};
use super::wear_table::{self, DepthCurve};
use super::{ArchardWear, FlankWear, GearError, GearPair, WearShape};

impl FlankWear {
    /// Creates wear in the shape of the pair's [`WearSpec`](super::WearSpec) with the largest depth
    /// `h_max_mm`.
    ///
    /// The pitch point of the parabolic shape is the operating one, where there is no sliding.
    ///
    /// # Errors
    /// [`GearError::Field`] for an invalid shape or depth, including a depth that leaves less than half of
    /// the tooth.
    pub fn from_shape(pair: &GearPair, h_max_mm: f64) -> Result<Self, GearError> {
        at_least("wear depth in mm", h_max_mm, 0.0)?;
        let spec = &pair.spec.wear;
        let profiles = match spec.shape {
            WearShape::Parabolic => {
                pair.gears.each_ref().map(|gear| WearProfile::Parabolic(Parabola::new(spec, gear, h_max_mm)))
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

    /// Creates wear in the shape of the pair's [`WearSpec`](super::WearSpec) at each of several ascending
    /// largest depths in mm. Faster than one by one for the shape `archard`, whose states follow from each
    /// other.
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
                .map(|state| state.wear.after_turns(state.driving_turns))
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
        let radii_mm = pair.gears.each_ref().map(|gear| [gear.root_radius_mm, gear.tip_radius_mm]);
        let curves = wear_table::from_csv(csv, radii_mm)?;
        let deepest = curves.iter().map(DepthCurve::deepest_mm).fold(0.0, f64::max);
        let wear = Self::new(curves.map(WearProfile::Table));
        wear.check_thickness(pair, deepest)?;
        Ok(wear)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{shen2022, shen2022_spec};
    use crate::{FlankWear, GearError, WearPoint, WearShape};

    #[test]
    fn a_table_has_points_of_the_tooth_only() {
        let pair = shen2022();
        let read = |rows: &str| FlankWear::from_table_csv(&pair, &format!("gear,radius_mm,depth_um\n{rows}"));
        let [root_mm, tip_mm] = [pair.gears[0].root_radius_mm, pair.gears[0].tip_radius_mm];
        assert!(read(&format!("1,{root_mm:.3},0\n1,{tip_mm:.3},10\n")).is_ok());
        for radius_mm in [root_mm - 0.1, tip_mm + 0.1, f64::NAN] {
            let error = read(&format!("1,{radius_mm},10\n")).unwrap_err().to_string();
            assert!(error.contains("the root radius") && error.contains("the tip radius (mm)"), "{error}");
        }
        let error = read("").unwrap_err().to_string();
        assert_eq!(error, "the wear table is without rows, expected at least one line below the header");
    }

    #[test]
    fn a_negative_or_endless_depth_is_rejected_in_a_short_sentence() {
        for depth_mm in [-1.0, f64::INFINITY] {
            let error = FlankWear::from_shape(&shen2022(), depth_mm).unwrap_err().to_string();
            assert_eq!(
                error,
                format!("wear depth in mm is {depth_mm}, expected a finite number of at least 0")
            );
        }
    }

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
