//! Random pairs that an engineer might describe.

use flankwatch_gear::{
    ContactRule, DynamicsSpec, GeometrySpec, MaterialSpec, OperationSpec, PairSpec, PlaneState,
    ResponseCoordinate, SupportSpec, WearShape, WearSpec,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Young's modulus in Pa, Poisson's ratio, density in kg/m³ and permissible root stress in MPa.
const MATERIALS: [(f64, f64, f64, f64); 5] = [
    (2.05e11, 0.3, 7850.0, 300.0),
    (2.05e11, 0.3, 7850.0, 300.0),
    (1.15e11, 0.26, 7200.0, 80.0),
    // Polyoxymethylene, polyamide 66.
    (2.8e9, 0.37, 1410.0, 25.0),
    (1.6e9, 0.4, 1140.0, 25.0),
];

struct Dice(ChaCha8Rng);

impl Dice {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    fn log_between(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    fn chance(&mut self, probability: f64) -> bool {
        self.0.random::<f64>() < probability
    }

    fn one_of<T: Copy>(&mut self, values: &[T]) -> T {
        values[(self.between(0.0, values.len() as f64) as usize).min(values.len() - 1)]
    }
}

/// Pair number `number`: module 0.3 to 20 mm, 12 to 200 teeth, face width 2 to 300 mm, steel, cast iron and
/// plastic, loads from 0.01 to 1 of the permissible one, pitch line velocities from 0.1 to 20 m/s.
pub(crate) fn pair(number: u64) -> PairSpec {
    let mut dice = Dice(ChaCha8Rng::seed_from_u64(number));
    let module_mm = dice.log_between(0.3, 20.0);
    let teeth = [0, 1].map(|_| dice.log_between(12.0, 200.9) as u32);
    let face_width_mm = (module_mm * dice.log_between(4.0, 40.0)).clamp(2.0, 300.0);
    let (youngs_modulus_pa, poisson_ratio, density_kg_per_m3, bears_mpa) = dice.one_of(&MATERIALS);
    let pressure_angle_deg = dice.one_of(&[20.0, 20.0, 20.0, 20.0, 14.5, 25.0]);
    // Gears with few teeth usually have a profile shift; in some descriptions it is missing.
    let careless = dice.chance(0.1);
    let shift = |teeth: u32, more: f64| {
        let angle: f64 = f64::to_radians(pressure_angle_deg);
        let least = 1.0 - f64::from(teeth) * angle.sin().powi(2) / 2.0;
        if careless { 0.0 } else { least.max(0.0) + more }
    };
    let more = if dice.chance(0.5) { 0.0 } else { dice.between(0.0, 0.3) };
    let profile_shift = [shift(teeth[0], more), shift(teeth[1], 0.0)];
    let root = [0, 1].map(|i| module_mm * (f64::from(teeth[i]) / 2.0 - 1.25 + profile_shift[i]));
    let bore_radius_mm = Some(root.map(|root| root * dice.between(0.1, 0.68)));

    let reference_m = module_mm * f64::from(teeth[0]) * 0.5e-3;
    let load = dice.log_between(0.01, 1.0);
    let torque_nm = load * bears_mpa * face_width_mm * module_mm / 4.0 * reference_m;
    let velocity = dice.log_between(0.1, 20.0);
    let shaft_speed_hz = (velocity / (std::f64::consts::TAU * reference_m)).clamp(0.5, 400.0);
    let supports = if dice.chance(0.6) {
        SupportSpec::default()
    } else {
        SupportSpec {
            stiffness_n_per_m: Some(dice.log_between(1e6, 1e9)),
            damping_n_s_per_m: Some(dice.log_between(1e2, 3e5)),
        }
    };
    PairSpec {
        name: format!("pair {number}"),
        geometry: GeometrySpec {
            teeth,
            module_mm,
            face_width_mm,
            pressure_angle_deg,
            addendum: [1.0; 2],
            dedendum: [1.25; 2],
            bore_radius_mm,
            profile_shift,
            centre_distance_mm: None,
        },
        material: MaterialSpec { youngs_modulus_pa, poisson_ratio, density_kg_per_m3 },
        operation: OperationSpec { torque_nm, output_torque_nm: None, shaft_speed_hz },
        supports,
        dynamics: DynamicsSpec {
            mesh_damping_ratio: dice.log_between(0.03, 0.5),
            response: dice.one_of(&[
                ResponseCoordinate::Bearing1,
                ResponseCoordinate::Bearing2,
                ResponseCoordinate::Mesh,
            ]),
            contact: if dice.chance(0.6) { ContactRule::Loaded } else { ContactRule::Threshold },
            plane: if face_width_mm < 3.0 * module_mm { PlaneState::Stress } else { PlaneState::Strain },
            ..DynamicsSpec::default()
        },
        errors: Default::default(),
        wear: WearSpec {
            shape: dice.one_of(&[
                WearShape::Parabolic,
                WearShape::Parabolic,
                WearShape::Parabolic,
                WearShape::Floor,
                WearShape::Archard,
            ]),
            exponent: dice.one_of(&[4.0, 4.0, 2.0, 1.5]),
            ..WearSpec::default()
        },
    }
}
