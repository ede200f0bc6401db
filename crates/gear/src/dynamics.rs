//! The 4-DOF dynamics, Eqs. (23) and (24), in the relative coordinate.
//!
//! With x = R_b1 θ₁ − R_b2 θ₂ the rotations reduce to one equation, ẍ = T₁R_b1/I₁ + T₂R_b2/I₂ − F_m/m_e with
//! F_m = k x_m + c ẋ_m, while the mean speed is prescribed, so unbalanced torques do not cause drift. ė is
//! not needed: for each coordinate of mass m that F_m acts on, the velocity less c x_m/m, the damper's
//! contribution, is integrated. It remains continuous where e jumps.
//!
//! Under loaded contact the teeth only push: x_m is replaced by its closed part, which is x_m above zero,
//! zero within the backlash, and x_m plus the backlash if the teeth's back flanks touch. Spring and damper
//! both act on it.

use super::excitation::{Excitation, LaneExcitation};
use super::{ContactRule, GearPair, MeshCycle};

/// Parameters of the equations of motion, in SI units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Motion {
    /// 1/m_e, 1/m₁, 1/m₂ in 1/kg.
    pub(super) inverse_mass_per_kg: [f64; 3],
    /// T₁R_b1/I₁ + T₂R_b2/I₂ in m/s².
    pub(super) drive_m_per_s2: f64,
    /// Mesh damping c in N·s/m.
    pub(super) mesh_damping_n_s_per_m: f64,
    /// Support stiffness k₁ = k₂ in N/m.
    pub(super) support_stiffness_n_per_m: f64,
    /// Support damping c₁ = c₂ in N·s/m.
    pub(super) support_damping_n_s_per_m: f64,
    /// Backlash along the line of action in m from the working flanks to the back flanks; 0 if the teeth
    /// cannot separate.
    pub(super) backlash_m: f64,
}

/// x, y₁, y₂ in m and the velocities less the damper's contribution in m/s.
pub(super) type State = [f64; 6];

/// The states of several systems in parallel: one row per component of the state.
pub(super) type Lanes<const LANES: usize> = [[f64; LANES]; 6];

/// Parameters that differ between lanes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LaneMotion<const LANES: usize> {
    pub(super) mesh_damping_n_s_per_m: [f64; LANES],
    pub(super) backlash_m: [f64; LANES],
}

impl Motion {
    pub(super) fn new(pair: &GearPair, cycle: &MeshCycle, torque_nm: f64) -> Self {
        let [driving, driven] = &pair.gears;
        let operation = &pair.spec.operation;
        // The driven torque keeps its ratio to the driving one; if not given, it balances it.
        let balanced = driven.base_radius_mm / driving.base_radius_mm;
        let proportion = operation.output_torque_nm.map_or(balanced, |output| output / operation.torque_nm);
        let push = |torque: f64, gear: &super::Gear| torque * gear.base_radius_mm * 1e-3 / gear.inertia_kg_m2;
        let mesh_mass = pair.mesh_mass_kg();
        Self {
            inverse_mass_per_kg: [1.0 / mesh_mass, 1.0 / driving.mass_kg, 1.0 / driven.mass_kg],
            drive_m_per_s2: push(torque_nm, driving) + push(torque_nm * proportion, driven),
            mesh_damping_n_s_per_m: 2.0
                * pair.spec.dynamics.mesh_damping_ratio
                * (cycle.mean_stiffness_n_per_m() * mesh_mass).sqrt(),
            support_stiffness_n_per_m: pair.supports.stiffness_n_per_m,
            support_damping_n_s_per_m: pair.supports.damping_n_s_per_m,
            backlash_m: match pair.spec.dynamics.contact {
                ContactRule::Loaded => backlash_m(pair, cycle),
                ContactRule::Threshold => 0.0,
            },
        }
    }

    /// Returns the parameters of one lane.
    #[inline(always)]
    pub(super) fn of_lane<const LANES: usize>(&self, differing: &LaneMotion<LANES>, lane: usize) -> Self {
        Self {
            mesh_damping_n_s_per_m: differing.mesh_damping_n_s_per_m[lane],
            backlash_m: differing.backlash_m[lane],
            ..*self
        }
    }

    /// Returns the static equilibrium under constant excitation.
    pub(super) fn at_rest(&self, excitation: Excitation) -> State {
        let force = self.drive_m_per_s2 / self.inverse_mass_per_kg[0];
        let mesh = force / excitation.stiffness;
        let support = force / self.support_stiffness_n_per_m;
        let part = self.inverse_mass_per_kg.map(|inverse| self.mesh_damping_n_s_per_m * mesh * inverse);
        let x = mesh + 2.0 * support + excitation.error;
        [x, support, -support, part[0], -part[1], part[2]]
    }

    /// Returns ẋ, ẏ₁, ẏ₂ in m/s.
    #[inline(always)]
    pub(super) fn velocities(&self, state: &State, error: f64) -> [f64; 3] {
        let mesh = closed(state[0] - state[1] + state[2] - error, self.backlash_m);
        let damped = self.mesh_damping_n_s_per_m * mesh;
        [
            state[3] - damped * self.inverse_mass_per_kg[0],
            state[4] + damped * self.inverse_mass_per_kg[1],
            state[5] - damped * self.inverse_mass_per_kg[2],
        ]
    }

    #[inline(always)]
    fn derivative(&self, state: &State, excitation: Excitation) -> State {
        let velocities = self.velocities(state, excitation.error);
        let push =
            excitation.stiffness * closed(state[0] - state[1] + state[2] - excitation.error, self.backlash_m);
        let support = |i: usize| {
            self.support_damping_n_s_per_m * velocities[i] + self.support_stiffness_n_per_m * state[i]
        };
        [
            velocities[0],
            velocities[1],
            velocities[2],
            self.drive_m_per_s2 - push * self.inverse_mass_per_kg[0],
            (push - support(1)) * self.inverse_mass_per_kg[1],
            (-push - support(2)) * self.inverse_mass_per_kg[2],
        ]
    }

    /// One step of the classical Runge–Kutta method over `step` seconds, with the excitation at its start,
    /// middle and end.
    #[inline(always)]
    pub(super) fn step(&self, state: &State, excitation: &[Excitation; 3], step: f64) -> State {
        let ahead =
            |slope: &State, length: f64| -> State { std::array::from_fn(|i| state[i] + length * slope[i]) };
        let k1 = self.derivative(state, excitation[0]);
        let k2 = self.derivative(&ahead(&k1, 0.5 * step), excitation[1]);
        let k3 = self.derivative(&ahead(&k2, 0.5 * step), excitation[1]);
        let k4 = self.derivative(&ahead(&k3, step), excitation[2]);
        std::array::from_fn(|i| state[i] + step / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]))
    }

    /// Performs one step of several systems in parallel, which differ in damping and backlash. The
    /// excitations are those at start, middle and end of each one's step. Every lane equals the result of
    /// [`Motion::step`].
    #[inline(always)]
    pub(super) fn step_lanes<const LANES: usize>(
        &self,
        differing: &LaneMotion<LANES>,
        states: &mut Lanes<LANES>,
        excitation: [&LaneExcitation<LANES>; 3],
        lengths: &[f64; LANES],
    ) {
        for lane in 0..LANES {
            let three = excitation
                .map(|[stiffness, error]| Excitation { stiffness: stiffness[lane], error: error[lane] });
            let after = self.of_lane(differing, lane).step(
                &std::array::from_fn(|i| states[i][lane]),
                &three,
                lengths[lane],
            );
            for (row, value) in states.iter_mut().zip(after) {
                row[lane] = value;
            }
        }
    }

    /// Returns the fastest rate of the linear system with stiffness up to `stiffness`, in rad/s, which the
    /// step must resolve.
    pub(super) fn fastest_rate(&self, stiffness: f64) -> f64 {
        let mesh: f64 = self.inverse_mass_per_kg.iter().sum();
        let translation = self.inverse_mass_per_kg[1].max(self.inverse_mass_per_kg[2]);
        let spring = (stiffness * mesh + self.support_stiffness_n_per_m * translation).sqrt();
        spring.max(self.mesh_damping_n_s_per_m * mesh + self.support_damping_n_s_per_m * translation)
    }

    /// Returns the slowest decay rate in 1/s, of the mesh mode at `stiffness` or of a support alone: that of
    /// the start-up transient.
    pub(super) fn slowest_decay(&self, stiffness: f64) -> f64 {
        let decay = |inverse: f64, damping: f64, stiffness: f64| {
            let half = 0.5 * damping * inverse;
            let under = half * half - stiffness * inverse;
            if under > 0.0 {
                // half − √under without cancellation.
                stiffness * inverse / (half + under.sqrt())
            } else {
                half
            }
        };
        let mesh = decay(self.inverse_mass_per_kg[0], self.mesh_damping_n_s_per_m, stiffness);
        let supports = [1, 2].map(|i| {
            decay(
                self.inverse_mass_per_kg[i],
                self.support_damping_n_s_per_m + self.mesh_damping_n_s_per_m,
                self.support_stiffness_n_per_m,
            )
        });
        mesh.min(supports[0]).min(supports[1])
    }
}

/// Returns the part of x_m on which spring and damper act; without backlash all of it. Branch-free, for
/// lanes.
#[inline(always)]
pub(super) fn closed(mesh: f64, backlash_m: f64) -> f64 {
    let back = mesh + backlash_m;
    let working = if mesh > 0.0 { mesh } else { 0.0 };
    working + if back < 0.0 { back } else { 0.0 }
}

/// Returns the backlash of the unworn pair, from both half-gaps, plus the mean contribution of wear; the back
/// flanks do not wear.
fn backlash_m(pair: &GearPair, cycle: &MeshCycle) -> f64 {
    let driven = &pair.gears[1];
    let half_gap = pair.perfect_lag_rad() + 0.5 * driven.pitch_angle_rad();
    let worn = cycle.uste_rad.iter().sum::<f64>() / cycle.uste_rad.len() as f64;
    (driven.base_radius_mm * 1e-3 * (2.0 * half_gap + worn)).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::{Motion, State};
    use crate::excitation::Excitation;

    /// A mass on the mesh alone: the supports' masses are infinite.
    fn oscillator(damping_ratio: f64) -> (Motion, Excitation, f64) {
        let (mass, stiffness) = (2.0, 5e8_f64);
        let motion = Motion {
            inverse_mass_per_kg: [1.0 / mass, 0.0, 0.0],
            drive_m_per_s2: 0.0,
            mesh_damping_n_s_per_m: 2.0 * damping_ratio * (stiffness * mass).sqrt(),
            support_stiffness_n_per_m: 1e8,
            support_damping_n_s_per_m: 1e3,
            backlash_m: 0.0,
        };
        (motion, Excitation { stiffness, error: 0.0 }, (stiffness / mass).sqrt())
    }

    fn run(motion: &Motion, mut state: State, excitation: Excitation, step: f64, steps: usize) -> State {
        for _ in 0..steps {
            state = motion.step(&state, &[excitation; 3], step);
        }
        state
    }

    #[test]
    fn free_vibration_is_the_closed_form() {
        for ratio in [0.0, 0.07, 0.4] {
            let (motion, excitation, omega) = oscillator(ratio);
            // x(0) = 1 µm and ẋ(0) = 0: the integrated velocity then is c x/m.
            let start = [1e-6, 0.0, 0.0, 2.0 * ratio * omega * 1e-6, 0.0, 0.0];
            let (step, steps) = (1e-6, 1000);
            let state = run(&motion, start, excitation, step, steps);
            let (t, damped) = (1e-3, omega * (1.0 - ratio * ratio).sqrt());
            let decay = (-ratio * omega * t).exp();
            let wanted = 1e-6 * decay * ((damped * t).cos() + ratio * omega / damped * (damped * t).sin());
            let velocity = -1e-6 * decay * omega * omega / damped * (damped * t).sin();
            assert!((state[0] - wanted).abs() < 1e-6 * 1e-6, "{} {wanted}", state[0]);
            assert!((motion.velocities(&state, 0.0)[0] - velocity).abs() < 1e-6 * 1e-6 * omega);
        }
    }

    /// Free flight between working flanks and backs at constant speed, a half vibration on each: the period
    /// is 2π/ω + 2b/v.
    #[test]
    fn separated_teeth_move_freely_and_strike_the_back_flanks() {
        let (mut motion, excitation, omega) = oscillator(0.0);
        let backlash = 20e-6;
        motion.backlash_m = backlash;
        let speed = 0.05;
        let start = [0.0, 0.0, 0.0, -speed, 0.0, 0.0];
        let flight = backlash / speed;
        let run_for = |seconds: f64| run(&motion, start, excitation, seconds / 20_000.0, 20_000);
        let parted = run_for(0.5 * flight);
        assert!((parted[0] + 0.5 * backlash).abs() < 1e-12 && (parted[3] + speed).abs() < 1e-12);
        let deepest = run_for(flight + 0.5 * std::f64::consts::PI / omega);
        assert!((deepest[0] + backlash + speed / omega).abs() < 1e-4 * speed / omega, "{}", deepest[0]);
        let again = run_for(2.0 * flight + 2.0 * std::f64::consts::PI / omega);
        assert!(again[0].abs() < 1e-4 * backlash && (again[3] / speed + 1.0).abs() < 1e-4, "{again:?}");
    }

    /// The damper is not felt in flight, and not where the teeth stay closed.
    #[test]
    fn the_damper_acts_on_closed_teeth_alone() {
        let (mut motion, excitation, _) = oscillator(0.2);
        let closed = [1e-6, 0.0, 0.0, 0.01, 0.0, 0.0];
        let linear = run(&motion, closed, excitation, 1e-7, 100);
        motion.backlash_m = 20e-6;
        assert_eq!(run(&motion, closed, excitation, 1e-7, 100), linear);
        let parted = run(&motion, [-5e-6, 0.0, 0.0, -0.01, 0.0, 0.0], excitation, 1e-7, 100);
        assert!((parted[0] + 5.1e-6).abs() < 1e-15 && (parted[3] + 0.01).abs() < 1e-15);
    }

    #[test]
    fn a_jump_of_the_error_pushes_through_the_damper() {
        // x at rest, e jumps by Δ: ẋ(0+) = c Δ/m, then x − Δ vibrates freely.
        let (motion, mut excitation, omega) = oscillator(0.1);
        excitation.error = 2e-6;
        let at_rest = [0.0; 6];
        assert!((motion.velocities(&at_rest, 2e-6)[0] - 2.0 * 0.1 * omega * 2e-6).abs() < 1e-15);
        let state = run(&motion, at_rest, excitation, 1e-6, 500);
        let (t, damped) = (5e-4, omega * (1.0_f64 - 0.01).sqrt());
        let (start, speed) = (-2e-6, 2.0 * 0.1 * omega * 2e-6);
        let wanted = 2e-6
            + (-0.1 * omega * t).exp()
                * (start * (damped * t).cos() + (speed + 0.1 * omega * start) / damped * (damped * t).sin());
        assert!((state[0] - wanted).abs() < 1e-11, "{} {wanted}", state[0]);
    }

    #[test]
    fn without_damping_the_energy_of_the_whole_system_is_kept() {
        let motion = Motion {
            inverse_mass_per_kg: [1.0 / 1.95, 1.0 / 6.4, 1.0 / 7.5],
            drive_m_per_s2: 0.0,
            mesh_damping_n_s_per_m: 0.0,
            support_stiffness_n_per_m: 6.56e7,
            support_damping_n_s_per_m: 0.0,
            backlash_m: 0.0,
        };
        let excitation = Excitation { stiffness: 6e8, error: 0.0 };
        let energy = |s: &State| {
            let mesh = s[0] - s[1] + s[2];
            let kinetic: f64 = (0..3).map(|i| 0.5 * s[3 + i].powi(2) / motion.inverse_mass_per_kg[i]).sum();
            kinetic + 0.5 * 6e8 * mesh * mesh + 0.5 * 6.56e7 * (s[1] * s[1] + s[2] * s[2])
        };
        let start = [3e-6, 1e-6, -2e-6, 0.01, 0.0, 0.002];
        let end = run(&motion, start, excitation, 1e-6, 20_000);
        assert!(
            (energy(&end) / energy(&start) - 1.0).abs() < 1e-6,
            "{}",
            energy(&end) / energy(&start) - 1.0
        );
    }

    #[test]
    fn at_rest_stays_at_rest() {
        let (mut motion, excitation, _) = oscillator(0.1);
        motion.inverse_mass_per_kg = [0.5, 0.15, 0.13];
        motion.drive_m_per_s2 = 1e4;
        let excitation = Excitation { error: 5e-6, ..excitation };
        let start = motion.at_rest(excitation);
        let end = run(&motion, start, excitation, 1e-6, 1000);
        assert!(motion.velocities(&end, 5e-6).iter().all(|velocity| velocity.abs() < 1e-12));
        assert!((start[0] - end[0]).abs() < 1e-15);
    }
}
