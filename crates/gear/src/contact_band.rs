//! Pressure distribution of a contact on both flanks, and the wear it causes.
//!
//! The gap between the flanks at each rotation is closed by a bed of springs (Winkler foundation, as Flodin
//! uses it for the wear of spur gears): p = c (δ − g)₊ with ∫ p = F. Its stiffness c = 3πE*/(8a) makes the
//! band between two involutes as wide as Hertz's, 2a. A flank that wear has made conformal thus carries load
//! over more of its width, two parts of one flank can carry load at once, and a tip edge has a finite
//! pressure over a finite width, without an edge radius, which pair files do not state.
//!
//! The gears turn at constant speed: relative to each other they turn about the pitch point, so flanks in
//! contact at a distance x from it along the line of action slide by (1 + z₁/z₂) |x| dφ₁. The transmission
//! error of worn flanks changes the speed ratio by at most about 1 %.

use std::f64::consts::PI;

use super::contact_load::ContactLoad;
use super::tooth_outline::ToothOutline;
use super::tooth_touch::ToothPair;
use super::{Flank, FlankPoint, FlankWear, Gear, GearPair};

/// Smallest radius of curvature in modules: close to the base circle the involute's own vanishes.
const MIN_CURVATURE_MODULES: f64 = 0.05;

/// p₀: pressure in MPa at which the wear coefficient holds whatever the pressure exponent is.
const COEFFICIENT_PRESSURE_MPA: f64 = 1000.0;

/// Wear work at a point of the flanks per turn of the driving gear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rubbing {
    /// Arc length in mm along the unworn involutes of both gears, from their base circles.
    pub(super) arcs_mm: [f64; 2],
    /// Force times sliding in N for each mm of width, times (p/p₀)^(m − 1).
    pub(super) work_n: f64,
}

/// One pair of teeth with worn flanks, discretised along the driving flank.
pub(super) struct ContactBand<'a> {
    pair: &'a GearPair,
    teeth: ToothPair<'a>,
    /// Points at equal spacing along the driving flank's arc, `spacing_mm` apart.
    points: Vec<FlankPoint>,
    spacing_mm: f64,
    /// Largest wear of both flanks together before the gaps are recomputed, in mm.
    step_mm: f64,
    contact_modulus_mpa: f64,
    /// Greatest distance in mm of a contact from the pitch point, along the line of action.
    farthest_mm: f64,
}

/// A point that may carry load.
#[derive(Debug, Clone, Copy)]
struct Place {
    gap_mm: f64,
    /// Force in N/mm per mm of closing.
    stiffness_mpa: f64,
    slide_mm_per_rad: f64,
    arcs_mm: [f64; 2],
}

impl<'a> ContactBand<'a> {
    /// Creates points `spacing_mm` apart; `step_mm` is the largest wear before the gaps are recomputed.
    pub(super) fn new(
        pair: &'a GearPair,
        wear: &'a FlankWear,
        outlines: &[ToothOutline; 2],
        spacing_mm: f64,
        step_mm: f64,
    ) -> Self {
        let driving = &pair.gears[0];
        let flank = Flank::new(driving, wear, 0);
        let form = arc_mm(driving, flank.alpha_at_radius_rad(outlines[0].form_radius_mm));
        let tip = arc_mm(driving, driving.tip_angle_rad);
        let count = ((tip - form) / spacing_mm).floor() as usize;
        let material = &pair.spec.material;
        Self {
            teeth: ToothPair::new(pair, wear, outlines),
            points: (0..=count)
                .map(|i| flank.at(alpha_rad(driving, tip - (count - i) as f64 * spacing_mm)))
                .collect(),
            spacing_mm,
            step_mm,
            contact_modulus_mpa: material.youngs_modulus_pa * 1e-6
                / (2.0 * (1.0 - material.poisson_ratio.powi(2))),
            farthest_mm: [0, 1]
                .map(|i| {
                    let gear = &pair.gears[i];
                    let length = |radius: f64| (radius * radius - gear.base_radius_mm.powi(2)).sqrt();
                    length(gear.tip_radius_mm) - length(gear.pitch_radius_mm)
                })
                .into_iter()
                .fold(0.0, f64::max),
            pair,
        }
    }

    /// Adds the wear work of a load to `rubbings`.
    pub(super) fn rub(&self, load: &ContactLoad, rubbings: &mut Vec<Rubbing>) {
        let mut places = self.places(load);
        places.sort_by(|a, b| a.gap_mm.total_cmp(&b.gap_mm));
        // The force grows with the closing δ; each additional point makes the bed stiffer.
        let (mut stiffness, mut offset, mut closing) = (0.0, load.force_n_per_mm, f64::INFINITY);
        for place in &places {
            if place.gap_mm >= closing {
                break;
            }
            stiffness += place.stiffness_mpa;
            offset += place.stiffness_mpa * place.gap_mm;
            closing = offset / stiffness;
        }
        let exponent = self.pair.spec.wear.pressure_exponent - 1.0;
        rubbings.extend(places.iter().take_while(|place| place.gap_mm < closing).map(|place| {
            let force_n_per_mm = place.stiffness_mpa * (closing - place.gap_mm);
            let pressure_mpa = force_n_per_mm / self.spacing_mm;
            let factor = (pressure_mpa / COEFFICIENT_PRESSURE_MPA).powf(exponent);
            Rubbing {
                arcs_mm: place.arcs_mm,
                work_n: force_n_per_mm * factor * place.slide_mm_per_rad * load.turn_rad,
            }
        }));
    }

    /// Returns the points that face the driven flank at a load's rotation and can carry its force.
    fn places(&self, load: &ContactLoad) -> Vec<Place> {
        let turned = load.phi1_rad.sin_cos();
        let meetings: Vec<_> = self
            .points
            .iter()
            .filter_map(|point| self.teeth.meeting(point, turned).map(|meeting| (point, meeting)))
            .collect();
        let Some((first, (lead, radius_mm, _))) = meetings.iter().max_by(|a, b| a.1.0.total_cmp(&b.1.0))
        else {
            return Vec::new();
        };
        let [driving, driven] = &self.pair.gears;
        let half_width = self.half_width_mm(
            [driving_length_mm(driving, first), flank_length_mm(driven, *radius_mm)],
            load.force_n_per_mm,
        );
        let soft = 8.0 * half_width / (3.0 * PI * self.contact_modulus_mpa);
        // The wear until the next update of the gaps counts as compliance, in proportion to the sliding at
        // this point. Without it, narrow ridges would be worn into grooves in one step and left standing in
        // the next.
        let worn = 2.0 * self.step_mm * 2.0 * half_width / load.force_n_per_mm;
        let ratio = 1.0 + f64::from(driving.teeth) / f64::from(driven.teeth);
        let (line_sin, line_cos) = self.pair.pressure_angle_rad.sin_cos();
        let place = |(point, (phi2, radius_mm, [beside, above])): &(&FlankPoint, (f64, f64, [f64; 2]))| {
            let from_pitch = (above * line_cos - (beside - driven.pitch_radius_mm) * line_sin).abs();
            Place {
                gap_mm: (lead - phi2) * driven.base_radius_mm,
                stiffness_mpa: self.spacing_mm / (soft + worn * (from_pitch / self.farthest_mm).min(1.0)),
                slide_mm_per_rad: ratio * from_pitch,
                arcs_mm: [
                    arc_mm(driving, point.alpha_rad),
                    0.5 * flank_length_mm(driven, *radius_mm).powi(2) / driven.base_radius_mm,
                ],
            }
        };
        let most = load.force_n_per_mm * (soft + worn) / self.spacing_mm;
        meetings.iter().map(place).filter(|place| place.gap_mm < most).collect()
    }

    /// Returns Hertz's half-width in mm between involutes with these radii of curvature.
    pub(super) fn half_width_mm(&self, lengths_mm: [f64; 2], force_n_per_mm: f64) -> f64 {
        let least = MIN_CURVATURE_MODULES * self.pair.spec.geometry.module_mm;
        let curvature: f64 = lengths_mm.iter().map(|length| 1.0 / length.max(least)).sum();
        (4.0 * force_n_per_mm / (PI * self.contact_modulus_mpa * curvature)).sqrt()
    }
}

/// Length of the line from the base circle to the unworn point.
fn driving_length_mm(gear: &Gear, point: &FlankPoint) -> f64 {
    gear.base_radius_mm * (point.alpha_rad + gear.base_half_angle_rad)
}

/// Length of that line from the point's radius in mm.
fn flank_length_mm(gear: &Gear, radius_mm: f64) -> f64 {
    (radius_mm * radius_mm - gear.base_radius_mm.powi(2)).max(0.0).sqrt()
}

/// Length of the unworn involute in mm from the base circle to α₁ = `alpha_rad`: ∫ R_b (α₁ + α₂) dα₁.
pub(super) fn arc_mm(gear: &Gear, alpha_rad: f64) -> f64 {
    0.5 * gear.base_radius_mm * (alpha_rad + gear.base_half_angle_rad).powi(2)
}

/// α₁ at that length.
pub(super) fn alpha_rad(gear: &Gear, arc_mm: f64) -> f64 {
    (2.0 * arc_mm / gear.base_radius_mm).max(0.0).sqrt() - gear.base_half_angle_rad
}

#[cfg(test)]
mod tests {
    use super::{ContactBand, Rubbing, arc_mm};
    use crate::contact_load::ContactLoad;
    use crate::testing::{shen2022, shen2022_spec};
    use crate::tooth_outline::ToothOutline;
    use crate::{FlankWear, GearPair};

    /// F/b = T/(R_b1 b) of the typical pair in single contact.
    const FORCE_N_PER_MM: f64 = 384.3;

    /// What one unit of turn under `FORCE_N_PER_MM` rubs off, with places 10 µm apart and vanishing steps of
    /// wear.
    fn rubbed(pair: &GearPair, wear: &FlankWear, phi1_rad: f64) -> Vec<Rubbing> {
        let outlines = [0, 1].map(|i| ToothOutline::new(pair, i));
        let load = ContactLoad { phi1_rad, force_n_per_mm: FORCE_N_PER_MM, turn_rad: 1.0 };
        let mut rubbings = Vec::new();
        ContactBand::new(pair, wear, &outlines, 0.01, 1e-9).rub(&load, &mut rubbings);
        rubbings
    }

    fn width_mm(rubbings: &[Rubbing], i: usize) -> f64 {
        let arcs = || rubbings.iter().map(|rubbing| rubbing.arcs_mm[i]);
        arcs().fold(f64::MIN, f64::max) - arcs().fold(f64::MAX, f64::min)
    }

    /// At φ₁ = 0.05 rad the contact stands x = R_b1 (φ₁ + π/48) = 7.811 mm behind the pitch point; κ =
    /// 1/32.44 + 1/18.87 per mm and E* = 112 637 MPa give 2a = 0.4552 mm.
    #[test]
    fn involutes_touch_in_hertzs_band_and_slide_by_their_distance_from_the_pitch_point() {
        let pair = shen2022();
        let rubbings = rubbed(&pair, &FlankWear::none(), 0.05);
        let [driving, driven] = &pair.gears;
        let phi1 = 0.05;
        let rolled = driving.base_radius_mm * (phi1 + pair.pressure_angle_rad + driving.base_half_angle_rad);
        let x = rolled - driving.base_radius_mm * pair.pressure_angle_rad.tan();
        let rest = driven.base_radius_mm * pair.pressure_angle_rad.tan() - x;
        let curvature = 1.0 / rolled + 1.0 / rest;
        let half_width = (4.0 * FORCE_N_PER_MM / (std::f64::consts::PI * 112_637.0 * curvature)).sqrt();
        for (i, length) in [rolled, rest].into_iter().enumerate() {
            assert!(
                (width_mm(&rubbings, i) - 2.0 * half_width).abs() < 0.03,
                "{} {half_width}",
                width_mm(&rubbings, i)
            );
            let work: f64 = rubbings.iter().map(|rubbing| rubbing.work_n).sum();
            let middle =
                rubbings.iter().map(|rubbing| rubbing.work_n * rubbing.arcs_mm[i]).sum::<f64>() / work;
            let gear = &pair.gears[i];
            let place = arc_mm(gear, length / gear.base_radius_mm - gear.base_half_angle_rad);
            assert!((middle - place).abs() < 0.01, "{middle} {place}");
            assert!((work / (FORCE_N_PER_MM * (1.0 + 24.0 / 26.0) * x) - 1.0).abs() < 0.01, "{work}");
        }
    }

    /// The bed's pressure is a parabola of p₀ = 3F/4a: ∫ p² = 0.8 p₀ ∫ p, with 2a = 0.4552 mm.
    #[test]
    fn an_exponent_of_2_weighs_the_wear_with_the_pressure() {
        let mut spec = shen2022_spec();
        let work = |spec: &crate::PairSpec| -> f64 {
            let pair = spec.resolve().unwrap();
            rubbed(&pair, &FlankWear::none(), 0.05).iter().map(|rubbing| rubbing.work_n).sum()
        };
        let archards = work(&spec);
        spec.wear.pressure_exponent = 2.0;
        let wanted = 0.8 * 0.75 * FORCE_N_PER_MM / (0.5 * 0.4552) / 1000.0;
        assert!((work(&spec) / archards / wanted - 1.0).abs() < 0.02, "{} {wanted}", work(&spec) / archards);
    }

    /// A dent as wide as the band in the driving flank, 20 µm deep: both of its shoulders carry, and its
    /// bottom does not.
    #[test]
    fn two_places_of_one_flank_can_carry() {
        let pair = shen2022();
        let radius = (32.44_f64.powi(2) + pair.gears[0].base_radius_mm.powi(2)).sqrt();
        let table: String = [(-0.12, 0.0), (-0.05, 20.0), (0.05, 20.0), (0.12, 0.0)]
            .map(|(beside, depth)| format!("1,{},{depth}\n", radius + beside))
            .concat();
        let wear = FlankWear::from_table_csv(&pair, &format!("gear,radius_mm,depth_um\n{table}")).unwrap();
        let rubbings = rubbed(&pair, &wear, 0.05);
        let place =
            arc_mm(&pair.gears[0], 32.44 / pair.gears[0].base_radius_mm - pair.gears[0].base_half_angle_rad);
        let (before, behind): (Vec<Rubbing>, Vec<Rubbing>) =
            rubbings.iter().partition(|rubbing| rubbing.arcs_mm[0] < place);
        assert!(!before.is_empty() && !behind.is_empty());
        assert!(rubbings.iter().all(|rubbing| (rubbing.arcs_mm[0] - place).abs() > 0.1));
    }

    /// Before the nominal start of contact the driven tip's edge carries, with a finite pressure over a
    /// finite width.
    #[test]
    fn a_tips_edge_carries_on_less_than_hertzs_width() {
        let pair = shen2022_spec().resolve().unwrap();
        let rubbings = rubbed(&pair, &FlankWear::none(), pair.start_of_contact_rad() - 0.02);
        let tip = arc_mm(&pair.gears[1], pair.gears[1].tip_angle_rad);
        let farthest = rubbings.iter().map(|rubbing| tip - rubbing.arcs_mm[1]).fold(0.0, f64::max);
        assert!(rubbings.len() > 3 && farthest > 0.02 && farthest < 0.24, "{} {farthest}", rubbings.len());
    }
}
