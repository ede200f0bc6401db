//! The geometry of a previewed pair: its measures and the data to draw its teeth.

use serde::Serialize;

use crate::gear::{Gear, GearPair, GeometryMeasure};

/// Points of a fillet and of a flank.
const POINTS: usize = 24;

/// The geometry of a pair, possibly of an impossible one.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = PreviewGeometry)]
pub(crate) struct GeometryView {
    /// Operating centre distance in mm.
    centre_distance_mm: f64,
    /// Operating pressure angle in degrees.
    pressure_angle_deg: f64,
    /// The measures that decide whether the teeth can mesh.
    measures: Vec<GeometryMeasure>,
    /// The driving and the driven gear.
    gears: Vec<GearView>,
}

/// One gear of the pair.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = PreviewGear)]
struct GearView {
    /// Tooth number.
    teeth: u32,
    /// Bore radius in mm.
    bore_radius_mm: f64,
    /// Root radius in mm.
    root_radius_mm: f64,
    /// Base radius in mm.
    base_radius_mm: f64,
    /// Reference radius in mm.
    reference_radius_mm: f64,
    /// Operating pitch radius in mm.
    pitch_radius_mm: f64,
    /// Tip radius in mm.
    tip_radius_mm: f64,
    /// Radius in mm of the start of the active profile, where the mating gear's tip contacts the flank.
    start_of_active_profile_mm: f64,
    /// Mass in kg.
    mass_kg: f64,
    /// Moment of inertia in kg·m².
    inertia_kg_m2: f64,
    /// Half of an unworn tooth in mm as distance along its centre line from the gear's centre and half
    /// thickness: from the middle of the space along fillet and flank to the tip.
    profile_mm: Vec<[f32; 2]>,
}

impl GeometryView {
    /// `None` if the numbers define no drawing, for example a tooth without a flank.
    pub(crate) fn of(pair: &GearPair, measures: Vec<GeometryMeasure>) -> Option<Self> {
        let gears: Vec<GearView> = (0..2).map(|i| GearView::of(pair, i)).collect();
        let is_drawn =
            gears.iter().all(|gear| gear.profile_mm.iter().flatten().all(|place| place.is_finite()));
        let is_measured = measures.iter().all(|measure| measure.value.is_finite());
        (is_drawn && is_measured).then(|| Self {
            centre_distance_mm: pair.centre_distance_mm,
            pressure_angle_deg: pair.pressure_angle_rad.to_degrees(),
            measures,
            gears,
        })
    }
}

impl GearView {
    fn of(pair: &GearPair, i: usize) -> Self {
        let gear: &Gear = &pair.gears[i];
        Self {
            teeth: gear.teeth,
            bore_radius_mm: gear.bore_radius_mm,
            root_radius_mm: gear.root_radius_mm,
            base_radius_mm: gear.base_radius_mm,
            reference_radius_mm: gear.reference_radius_mm,
            pitch_radius_mm: gear.pitch_radius_mm,
            tip_radius_mm: gear.tip_radius_mm,
            start_of_active_profile_mm: gear.sap_radius_mm,
            mass_kg: gear.mass_kg,
            inertia_kg_m2: gear.inertia_kg_m2,
            profile_mm: pair
                .tooth_profile_mm(i, POINTS)
                .iter()
                .map(|place| place.map(|mm| mm as f32))
                .collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gear::PairSpec;

    #[test]
    fn an_impossible_pair_has_a_drawing() {
        let mut spec = PairSpec::from_toml(include_str!("../../../fixtures/pairs/shen2022.toml")).unwrap();
        spec.geometry.teeth = [9, 26];
        spec.geometry.centre_distance_mm = None;
        let assessment = spec.assess();
        assert!(!assessment.refusals.is_empty());
        let view = GeometryView::of(&assessment.pair.unwrap(), assessment.measures).unwrap();
        assert_eq!(view.gears[0].profile_mm.len(), 2 * POINTS);
    }
}
