//! The force on one pair of teeth from its first to its last contact.

use super::loaded_cycle::tooth_shares;
use super::mesh_cycle::Mesh;
use super::{ContactRule, ElasticBodies, FlankWear, GearError, GearPair};

/// Rotations per mesh period: their spacing on the flank is less than a third of a typical contact width.
const PER_PERIOD: usize = 160;

/// The force at one rotation, representing the turn [`ContactLoad::turn_rad`] around it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ContactLoad {
    /// φ₁ of the driving tooth in rad.
    pub(super) phi1_rad: f64,
    /// Normal force in N per mm of width.
    pub(super) force_n_per_mm: f64,
    /// Turn of the driving gear in rad.
    pub(super) turn_rad: f64,
}

/// Computes the forces on one pair of teeth over its contact, by the pair's contact rule at the pair's own
/// torque. `bodies` are those of loaded contact.
pub(super) fn contact_loads(
    pair: &GearPair,
    wear: &FlankWear,
    bodies: Option<&ElasticBodies>,
) -> Result<Vec<ContactLoad>, GearError> {
    let shares = match (pair.spec.dynamics.contact, bodies) {
        (ContactRule::Loaded, Some(bodies)) => tooth_shares(pair, bodies, wear, PER_PERIOD)?,
        (ContactRule::Loaded, None) => {
            tooth_shares(pair, &ElasticBodies::new(pair, wear)?, wear, PER_PERIOD)?
        }
        (ContactRule::Threshold, _) => rigid_shares(pair, wear)?,
    };
    let torque_n = pair.spec.operation.torque_nm * 1e3 / pair.spec.geometry.face_width_mm;
    let turn_rad = pair.gears[0].pitch_angle_rad() / PER_PERIOD as f64;
    let load = |(phi1_rad, share): (f64, f64)| ContactLoad {
        phi1_rad,
        force_n_per_mm: share * torque_n / pair.gears[0].base_radius_mm,
        turn_rad,
    };
    Ok(shares.into_iter().map(load).collect())
}

/// Computes the shares under the threshold rule: pairs in contact share the load by their stiffness.
fn rigid_shares(pair: &GearPair, wear: &FlankWear) -> Result<Vec<(f64, f64)>, GearError> {
    let mesh = Mesh::new(pair, wear)?;
    let (first, last) = mesh.curve.range();
    let turn_rad = pair.gears[0].pitch_angle_rad() / PER_PERIOD as f64;
    let count = ((last - first) / turn_rad).ceil() as usize;
    let mut shares = Vec::with_capacity(count);
    for i in 0..count {
        let phi1 = first + (i as f64 + 0.5) * turn_rad;
        let share = mesh.share(phi1)?;
        if share > 0.0 {
            shares.push((phi1, share));
        }
    }
    Ok(shares)
}

#[cfg(test)]
mod tests {
    use super::contact_loads;
    use crate::testing::shen2022_spec;
    use crate::{ContactRule, FlankWear};

    /// Over a passage the shares of a mesh period add up to one at every rotation: Σ F R_b b Δφ = T 2π/z.
    #[test]
    fn forces_carry_the_torque_over_the_period() {
        for rule in [ContactRule::Threshold, ContactRule::Loaded] {
            let mut spec = shen2022_spec();
            spec.dynamics.contact = rule;
            let pair = spec.resolve().unwrap();
            for depth_mm in [0.0, 0.05] {
                let wear = FlankWear::from_shape(&pair, depth_mm).unwrap();
                let loads = contact_loads(&pair, &wear, None).unwrap();
                let work: f64 = loads.iter().map(|load| load.force_n_per_mm * load.turn_rad).sum();
                let whole = pair.spec.operation.torque_nm * 1e3 / (pair.gears[0].base_radius_mm * 50.0)
                    * pair.gears[0].pitch_angle_rad();
                assert!((work / whole - 1.0).abs() < 1e-9, "{rule}, {depth_mm} mm: {work} {whole}");
            }
        }
    }
}
