//! What each contact of one pair of teeth does to the flanks on its way: where, with which force, rolling how fast.

use std::f64::consts::PI;

use super::loaded_cycle::tooth_loads;
use super::mesh_cycle::Mesh;
use super::{ContactRule, ElasticBodies, Flank, FlankPoint, FlankWear, Gear, GearError, GearPair};

/// Contacts looked at in a mesh period.
const PER_PERIOD: usize = 512;
/// Least radius of curvature in modules: nearer to the base circle the involute's own vanishes.
const LEAST_CURVATURE_MODULES: f64 = 0.05;

/// One contact, standing for the turn of [`ContactLoad::turn_rad`] around it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ContactLoad {
    /// Arc length in mm along the unworn involute from the base circle to the touching point, on both flanks.
    pub(super) arc_mm: [f64; 2],
    /// Speed u of the flank's material along the contact's tangent, in mm per rad of the driving gear.
    pub(super) rolling_mm_per_rad: [f64; 2],
    /// Normal force in N per mm of width.
    pub(super) force_n_per_mm: f64,
    /// Hertz's half-width a in mm.
    pub(super) half_width_mm: f64,
    /// Turn of the driving gear in rad.
    pub(super) turn_rad: f64,
}

/// The contacts of one pair of teeth that carry, from its first to its last, by the pair's contact rule at the pair's own torque. `bodies`
/// are those of loaded contact.
pub(super) fn contact_loads(pair: &GearPair, wear: &FlankWear, bodies: Option<&ElasticBodies>) -> Result<Vec<ContactLoad>, GearError> {
    match (pair.spec.dynamics.contact, bodies) {
        (ContactRule::Loaded, Some(bodies)) => loaded(pair, wear, bodies),
        (ContactRule::Loaded, None) => loaded(pair, wear, &ElasticBodies::new(pair, wear)?),
        (ContactRule::Threshold, _) => rigid(pair, wear),
    }
}

/// By the threshold rule: pairs that carry together share by their stiffness.
fn rigid(pair: &GearPair, wear: &FlankWear) -> Result<Vec<ContactLoad>, GearError> {
    let mesh = Mesh::new(pair, wear)?;
    let flanks = [0, 1].map(|i| Flank::new(&pair.gears[i], wear, i));
    let (first, last) = mesh.curve.range();
    let count = ((last - first) / pair.gears[0].pitch_angle_rad() * PER_PERIOD as f64).ceil();
    let turn_rad = (last - first) / count;
    let mut loads = Vec::with_capacity(count as usize);
    for i in 0..count as usize {
        let phi1 = first + (i as f64 + 0.5) * turn_rad;
        let share = mesh.share(phi1)?;
        if let Some(angles) = mesh.curve.flank_angles(phi1).filter(|_| share > 0.0) {
            let points = [flanks[0].at(angles[0]), flanks[1].at(angles[1])];
            let arms = points.map(|point| point.normal_arm_mm());
            let lengths = points.map(|point| point.normal_length_mm());
            loads.push(contact(pair, &points, lengths, arms, share, turn_rad));
        }
    }
    Ok(loads)
}

/// By elastic load sharing, tip edges included.
fn loaded(pair: &GearPair, wear: &FlankWear, bodies: &ElasticBodies) -> Result<Vec<ContactLoad>, GearError> {
    let flanks = [0, 1].map(|i| Flank::new(&pair.gears[i], wear, i));
    let turn_rad = pair.gears[0].pitch_angle_rad() / PER_PERIOD as f64;
    let loads = tooth_loads(pair, bodies, wear, PER_PERIOD)?;
    Ok(loads
        .iter()
        .map(|(touch, share)| {
            let points = [0, 1].map(|i| flanks[i].at(flanks[i].alpha_at_radius_rad(touch.radii_mm[i])));
            let lengths = [0, 1].map(|i| {
                let [sin, cos] = touch.normals[i];
                points[i].x_mm * sin + (points[i].y_mm - points[i].depth_mm) * cos
            });
            contact(pair, &points, lengths, touch.arms_mm, *share, turn_rad)
        })
        .collect())
}

/// A contact with the normal `lengths` and `arms` (mm) of its points from the gears' centres, which carries `share` of the torque.
fn contact(pair: &GearPair, points: &[FlankPoint; 2], lengths: [f64; 2], arms: [f64; 2], share: f64, turn_rad: f64) -> ContactLoad {
    let force_n_per_mm = share * pair.spec.operation.torque_nm * 1e3 / (arms[0] * pair.spec.geometry.face_width_mm);
    let least = LEAST_CURVATURE_MODULES * pair.spec.geometry.module_mm;
    let curvature: f64 = lengths.iter().map(|length| 1.0 / length.max(least)).sum();
    let material = &pair.spec.material;
    let contact_modulus_mpa = material.youngs_modulus_pa * 1e-6 / (2.0 * (1.0 - material.poisson_ratio.powi(2)));
    ContactLoad {
        arc_mm: [0, 1].map(|i| arc_mm(&pair.gears[i], points[i].alpha_rad)),
        rolling_mm_per_rad: [lengths[0], lengths[1] * arms[0] / arms[1]],
        force_n_per_mm,
        half_width_mm: (4.0 * force_n_per_mm / (PI * contact_modulus_mpa * curvature)).sqrt(),
        turn_rad,
    }
}

/// Length of the unworn involute in mm from the base circle to α₁ = `alpha_rad`: ∫ R_b (α₁ + α₂) dα₁.
pub(super) fn arc_mm(gear: &Gear, alpha_rad: f64) -> f64 {
    0.5 * gear.base_radius_mm * (alpha_rad + gear.base_half_angle_rad).powi(2)
}

#[cfg(test)]
mod tests {
    use crate::gear::contact_load::contact_loads;
    use crate::gear::testing::shen2022_spec;
    use crate::gear::{ContactRule, FlankWear};

    #[test]
    fn forces_carry_the_torque_over_the_period_and_rolling_balances_at_the_pitch_point() {
        for rule in [ContactRule::Threshold, ContactRule::Loaded] {
            let mut spec = shen2022_spec();
            spec.dynamics.contact = rule;
            let pair = spec.resolve().unwrap();
            let loads = contact_loads(&pair, &FlankWear::none(), None).unwrap();
            // Over a passage the shares of a mesh period add up to one at every rotation: Σ F r_b b Δφ = T 2π/z.
            let work: f64 = loads.iter().map(|load| load.force_n_per_mm * load.turn_rad).sum();
            let whole = pair.spec.operation.torque_nm * 1e3 / (pair.gears[0].base_radius_mm * 50.0) * pair.gears[0].pitch_angle_rad();
            assert!((work / whole - 1.0).abs() < 3e-3, "{rule}: {work} {whole}");
            let rolls = loads
                .iter()
                .min_by(|a, b| {
                    let slide = |load: &super::ContactLoad| (load.rolling_mm_per_rad[0] - load.rolling_mm_per_rad[1]).abs();
                    slide(a).total_cmp(&slide(b))
                })
                .unwrap();
            let gear = &pair.gears[0];
            let pitch_length = (gear.pitch_radius_mm.powi(2) - gear.base_radius_mm.powi(2)).sqrt();
            assert!(
                (rolls.rolling_mm_per_rad[0] - pitch_length).abs() < 0.05,
                "{}",
                rolls.rolling_mm_per_rad[0]
            );
            // Single contact there: F = T/(R_b1 b) = 384.3 N/mm, κ = 1/24.63 + 1/26.68 per mm, E* = 112 637 MPa.
            assert!((rolls.half_width_mm - 0.2359).abs() < 5e-4, "{}", rolls.half_width_mm);
        }
    }
}
