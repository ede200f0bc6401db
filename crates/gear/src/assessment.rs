//! Assessment of a described pair: all errors, and the measures that decide them.

use serde::Serialize;

use super::geometry::MIN_TIP_THICKNESS_MODULES;
use super::limits::{self, HARMLESS_UNDERCUT_MODULES, MIN_ROOT_TO_BORE};
use super::refusals::Refusals;
use super::{GearError, GearPair, PairSpec};

/// Contact ratio with a usual reserve: below it slight wear of the tips or a larger centre distance
/// interrupts the contact.
const USUAL_CONTACT_RATIO: f64 = 1.2;
/// Tip clearance in modules that allows for errors; the basic rack of ISO 53 has 0.25.
const USUAL_CLEARANCE_MODULES: f64 = 0.1;
/// Tip thickness in modules that a hardened tip should have.
const USUAL_TIP_MODULES: f64 = 0.2;

/// A described pair with all its errors.
#[derive(Debug)]
pub struct Assessment {
    /// The pair, if its geometry can be computed; possibly an unusable one.
    pub pair: Option<GearPair>,
    /// The measures that decide whether the teeth can mesh; empty without a geometry.
    pub measures: Vec<GeometryMeasure>,
    /// All reasons why the pair cannot be used; empty if [`PairSpec::resolve`] returns a pair.
    pub refusals: Vec<GearError>,
}

/// The quantity of a geometry measure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum MeasuredQuantity {
    /// Contact ratio: mesh periods that a pair of teeth stays in contact.
    ContactRatio,
    /// Backlash along the operating pitch circles in mm.
    Backlash,
    /// Distance from a gear's tip to the other's root in modules.
    TipClearance,
    /// Thickness of the tip in modules.
    TipThickness,
    /// Profile shift beyond the one at which undercut begins, in modules.
    UndercutMargin,
    /// Length on the line of action in mm from the end of a gear's involute to its contact with the other's
    /// tip: negative in case of interference.
    InterferenceMargin,
    /// Root radius over bore radius.
    RootToBore,
    /// Torque over the largest that the teeth withstand.
    Load,
}

/// Verdict on a measure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Within the usual range.
    Good,
    /// Possible, with little reserve.
    Marginal,
    /// Impossible.
    Impossible,
}

/// One measure of a pair, or of one of its gears.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct GeometryMeasure {
    /// The measured quantity.
    pub quantity: MeasuredQuantity,
    /// The gear, 1 or 2; none if it belongs to both.
    pub gear: Option<u32>,
    /// The value.
    pub value: f64,
    /// The smallest possible value.
    pub least: Option<f64>,
    /// The largest possible value.
    pub most: Option<f64>,
    /// The verdict.
    pub verdict: Verdict,
}

impl PairSpec {
    /// Collects all errors of the pair, of which [`PairSpec::resolve`] returns the first, with the measures
    /// of its geometry.
    pub fn assess(&self) -> Assessment {
        let mut refusals = Refusals::default();
        let pair = GearPair::draft(self, &mut refusals);
        Assessment {
            measures: pair.as_ref().map(GearPair::measures).unwrap_or_default(),
            pair,
            refusals: refusals.into_vec(),
        }
    }
}

impl GearPair {
    /// Returns the backlash along the operating pitch circles in mm, of unworn flanks.
    pub fn backlash_mm(&self) -> f64 {
        let driven = &self.gears[1];
        2.0 * driven.pitch_radius_mm * (self.perfect_lag_rad() + 0.5 * driven.pitch_angle_rad())
    }

    fn measures(&self) -> Vec<GeometryMeasure> {
        use MeasuredQuantity::{
            Backlash, ContactRatio, InterferenceMargin, Load, RootToBore, TipClearance, TipThickness,
            UndercutMargin,
        };

        let basic = &self.spec.geometry;
        let module = basic.module_mm;
        let alpha0 = basic.pressure_angle_deg.to_radians();
        // Allows for the rounding of a centre distance.
        let tight_mm = 2.0 * limits::CENTRE_ROUNDING_MODULES * module * self.pressure_angle_rad.tan();
        let mut measures = vec![
            at_least(ContactRatio, None, self.contact_ratio(), 1.0, USUAL_CONTACT_RATIO),
            at_least(Backlash, None, self.backlash_mm(), -tight_mm, -1e-6 * module),
        ];
        for i in 0..2 {
            let (gear, other, number) = (&self.gears[i], &self.gears[1 - i], Some(i as u32 + 1));
            let clearance = (self.centre_distance_mm - gear.tip_radius_mm - other.root_radius_mm) / module;
            let shift = basic.profile_shift[i] - limits::min_profile_shift(basic, i, alpha0);
            let sap_length_mm = (gear.root_angle_rad + gear.base_half_angle_rad) * gear.base_radius_mm;
            let involute_mm = sap_length_mm - limits::form_length_mm(basic, i, alpha0);
            measures.extend([
                at_least(TipClearance, number, clearance, -1e-9 / module, USUAL_CLEARANCE_MODULES),
                at_least(
                    TipThickness,
                    number,
                    gear.tip_thickness_mm() / module,
                    MIN_TIP_THICKNESS_MODULES,
                    USUAL_TIP_MODULES,
                ),
                at_least(UndercutMargin, number, shift, -HARMLESS_UNDERCUT_MODULES, 0.0),
                at_least(InterferenceMargin, number, involute_mm, -1e-6 * module, 0.0),
                at_least(
                    RootToBore,
                    number,
                    gear.root_radius_mm / gear.bore_radius_mm,
                    MIN_ROOT_TO_BORE,
                    MIN_ROOT_TO_BORE,
                ),
            ]);
        }
        let operation = &self.spec.operation;
        let torques = [Some(operation.torque_nm), operation.output_torque_nm];
        let load = torques
            .into_iter()
            .zip(&self.gears)
            .filter_map(|(torque, gear)| {
                Some(torque? / limits::max_torque_nm(&self.spec, gear.base_radius_mm))
            })
            .fold(0.0, f64::max);
        measures.push(GeometryMeasure {
            quantity: Load,
            gear: None,
            value: load,
            least: None,
            most: Some(1.0),
            verdict: if load <= 1.0 { Verdict::Good } else { Verdict::Impossible },
        });
        measures
    }
}

/// Creates a measure that must be at least `min`, and is usual from `usual` on.
fn at_least(
    quantity: MeasuredQuantity,
    gear: Option<u32>,
    value: f64,
    min: f64,
    usual: f64,
) -> GeometryMeasure {
    let verdict = if value >= usual {
        Verdict::Good
    } else if value >= min {
        Verdict::Marginal
    } else {
        Verdict::Impossible
    };
    GeometryMeasure { quantity, gear, value, least: Some(min), most: None, verdict }
}

#[cfg(test)]
mod tests {
    use super::super::testing::shen2022_spec;
    use super::{MeasuredQuantity, Verdict};
    use crate::{GearError, PairSpec};

    fn fields(spec: &PairSpec) -> Vec<&'static str> {
        let refusals = spec.assess().refusals;
        let field = |error: &GearError| match error {
            GearError::Field { field, .. } => *field,
            other => panic!("{other}"),
        };
        refusals.iter().map(field).collect()
    }

    #[test]
    fn all_errors_are_reported_at_once() {
        let mut spec = shen2022_spec();
        spec.geometry.module_mm = -1.0;
        spec.geometry.bore_radius_mm = Some([20.0, 0.0]);
        spec.material.poisson_ratio = 0.7;
        assert_eq!(
            fields(&spec),
            ["geometry.module_mm", "geometry.bore_radius_mm", "material.poisson_ratio"]
        );
        assert!(spec.assess().pair.is_none());
    }

    #[test]
    fn an_impossible_geometry_is_still_measured() {
        let mut spec = shen2022_spec();
        spec.geometry.teeth = [12, 26];
        spec.geometry.centre_distance_mm = Some(100.0);
        spec.geometry.bore_radius_mm = Some([29.0, 20.0]);
        let assessment = spec.assess();
        assert!(assessment.pair.is_none(), "base circles that overlap have no line of action");
        spec.geometry.centre_distance_mm = None;
        let assessment = spec.assess();
        assert!(assessment.pair.is_some());
        let impossible: Vec<_> = assessment
            .measures
            .iter()
            .filter(|measure| measure.verdict == Verdict::Impossible)
            .map(|measure| (measure.quantity, measure.gear))
            .collect();
        assert!(impossible.contains(&(MeasuredQuantity::UndercutMargin, Some(1))), "{impossible:?}");
        assert!(impossible.contains(&(MeasuredQuantity::InterferenceMargin, Some(1))), "{impossible:?}");
        assert!(impossible.contains(&(MeasuredQuantity::RootToBore, Some(1))), "{impossible:?}");
        assert_eq!(fields(&spec)[0], "geometry.bore_radius_mm");
    }

    /// Table 1: module 6 mm at the reference centre distance has no backlash, the basic rack's clearance and,
    /// by the textbook, ε = 1.6114.
    #[test]
    fn the_papers_pair_is_good() {
        let assessment = shen2022_spec().assess();
        assert!(assessment.refusals.is_empty());
        let value = |quantity| {
            let measure = assessment.measures.iter().find(|measure| measure.quantity == quantity).unwrap();
            assert_eq!(measure.verdict, Verdict::Good, "{measure:?}");
            measure.value
        };
        assert!((value(MeasuredQuantity::ContactRatio) - 1.6114).abs() < 1e-4);
        assert!(value(MeasuredQuantity::Backlash).abs() < 1e-9);
        assert!((value(MeasuredQuantity::TipClearance) - 0.25).abs() < 1e-9);
        assert!((value(MeasuredQuantity::RootToBore) - 64.5 / 20.0).abs() < 1e-9);
        assert!(value(MeasuredQuantity::InterferenceMargin) > 0.0);
    }
}
