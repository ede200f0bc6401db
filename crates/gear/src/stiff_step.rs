//! An integration step that is stable for any stiffness of teeth and supports relative to the masses.
//!
//! The diagonally implicit Runge–Kutta method of order 3 with an explicit first stage of Kennedy and
//! Carpenter (ARK3(2)4L\[2\]SA, Appl. Numer. Math. 44, 2003). It is L-stable: vibration too fast for the step
//! dies out within it, which leaves the equilibrium that a sensor with the record's band sees. The
//! coordinates are coupled only by the closed distance ξ of the teeth, so a stage has a closed form,
//! including separated teeth, and needs no iteration.

use super::dynamics::{LaneMotion, Lanes, Motion, closed};
use super::excitation::LaneExcitation;

/// Number of stages, the first of them explicit.
pub(super) const STAGES: usize = 4;
/// The diagonal of all stages but the first.
const DIAGONAL: f64 = 1_767_732_205_903.0 / 4_055_673_282_236.0;
/// Times of the stages as fractions of the step.
pub(super) const STAGE_TIMES: [f64; STAGES] = [0.0, 2.0 * DIAGONAL, 0.6, 1.0];
/// Weights of the earlier stages in each stage; the last stage is the step's end.
const WEIGHTS: [&[f64]; STAGES - 1] = [
    &[DIAGONAL],
    &[2_746_238_789_719.0 / 10_658_868_560_708.0, -640_167_445_237.0 / 6_845_629_431_997.0],
    &[
        1_471_266_399_579.0 / 7_840_856_788_654.0,
        -4_482_444_167_858.0 / 7_529_755_066_697.0,
        11_266_239_266_428.0 / 11_593_286_722_821.0,
    ],
];

/// Constants of all steps of one length for each system.
#[derive(Debug, Clone, Copy)]
pub(super) struct StiffStep<const LANES: usize> {
    lengths: [f64; LANES],
    stage: Stage<LANES>,
}

/// A stage that includes `part` seconds of its own slope.
#[derive(Debug, Clone, Copy)]
struct Stage<const LANES: usize> {
    part: [f64; LANES],
    /// Factors of the supports on the velocities ẏ₁, ẏ₂ within that part.
    left: [[f64; LANES]; 2],
}

impl<const LANES: usize> StiffStep<LANES> {
    /// Prepares steps of `lengths` seconds for motions with these masses and supports.
    #[inline(always)]
    pub(super) fn new(motion: &Motion, lengths: [f64; LANES]) -> Self {
        let part = lengths.map(|length| DIAGONAL * length);
        let left = [1, 2].map(|i| {
            part.map(|part| {
                1.0 / (1.0
                    + part
                        * motion.inverse_mass_per_kg[i]
                        * (motion.support_damping_n_s_per_m + part * motion.support_stiffness_n_per_m))
            })
        });
        Self { lengths, stage: Stage { part, left } }
    }

    /// The states of several systems after a step, each with its own damping and backlash, and with the
    /// excitation at the stages' [times](STAGE_TIMES).
    #[inline(always)]
    pub(super) fn advance(
        &self,
        motion: &Motion,
        differing: &LaneMotion<LANES>,
        states: &Lanes<LANES>,
        excitation: [&LaneExcitation<LANES>; STAGES],
    ) -> Lanes<LANES> {
        // One by one: as an array they would be moved.
        let [one, two, three] = WEIGHTS;
        let first = Stage::<LANES>::EXPLICIT.slopes(motion, differing, states, excitation[0]);
        let mut known = *states;
        self.add(&mut known, one[0], &first);
        let second = self.stage.slopes(motion, differing, &known, excitation[1]);
        known = *states;
        self.add(&mut known, two[0], &first);
        self.add(&mut known, two[1], &second);
        let third = self.stage.slopes(motion, differing, &known, excitation[2]);
        known = *states;
        self.add(&mut known, three[0], &first);
        self.add(&mut known, three[1], &second);
        self.add(&mut known, three[2], &third);
        let fourth = self.stage.slopes(motion, differing, &known, excitation[3]);
        self.add(&mut known, DIAGONAL, &fourth);
        known
    }

    /// Adds the slopes times a part of each step.
    #[inline(always)]
    fn add(&self, known: &mut Lanes<LANES>, weight: f64, slopes: &Lanes<LANES>) {
        for (known, slopes) in known.iter_mut().zip(slopes) {
            for lane in 0..LANES {
                known[lane] += weight * self.lengths[lane] * slopes[lane];
            }
        }
    }
}

impl<const LANES: usize> Stage<LANES> {
    const EXPLICIT: Self = Self { part: [0.0; LANES], left: [[1.0; LANES]; 2] };

    /// Returns the slopes at `known` + `part` × slope.
    #[inline(always)]
    fn slopes(
        &self,
        motion: &Motion,
        differing: &LaneMotion<LANES>,
        known: &Lanes<LANES>,
        [stiffness, error]: &LaneExcitation<LANES>,
    ) -> Lanes<LANES> {
        let [mesh, first, second] = motion.inverse_mass_per_kg;
        let (support, damper) = (motion.support_stiffness_n_per_m, motion.support_damping_n_s_per_m);
        let mut slopes = [[0.0; LANES]; 6];
        for lane in 0..LANES {
            let (part, [left1, left2]) = (self.part[lane], self.left.each_ref().map(|left| left[lane]));
            let soft = mesh + first * left1 + second * left2;
            let [x, y1, y2, v0, v1, v2] = known.each_ref().map(|row| row[lane]);
            let damping = differing.mesh_damping_n_s_per_m[lane];
            // ẏ₁ and ẏ₂, and the final values of x, y₁ and y₂, without the teeth's force.
            let free1 = left1 * (v1 - part * first * support * y1);
            let free2 = left2 * (v2 - part * second * support * y2);
            let ahead = x + part * (v0 + part * motion.drive_m_per_s2);
            let apart = ahead - (y1 + part * free1) + (y2 + part * free2) - error[lane];
            // ξ contributes the forces k ξ and c ξ, which close x_m by `part` × `push` × `soft` per ξ.
            let push = damping + part * stiffness[lane];
            let closed = closed(apart, differing.backlash_m[lane]) / (1.0 + part * push * soft);
            let speed1 = free1 + first * left1 * push * closed;
            let speed2 = free2 - second * left2 * push * closed;
            let force = stiffness[lane] * closed;
            let drive = motion.drive_m_per_s2 - force * mesh;
            slopes[0][lane] = v0 + part * drive - damping * closed * mesh;
            slopes[1][lane] = speed1;
            slopes[2][lane] = speed2;
            slopes[3][lane] = drive;
            slopes[4][lane] = (force - damper * speed1 - support * (y1 + part * speed1)) * first;
            slopes[5][lane] = (-force - damper * speed2 - support * (y2 + part * speed2)) * second;
        }
        slopes
    }
}

#[cfg(test)]
mod tests {
    use super::{STAGE_TIMES, STAGES, StiffStep};
    use crate::dynamics::{LaneMotion, Motion, State};
    use crate::excitation::Excitation;

    fn motion(stiffness_of_supports: f64, damping: f64) -> Motion {
        Motion {
            inverse_mass_per_kg: [0.5, 0.15, 0.13],
            drive_m_per_s2: 1e4,
            mesh_damping_n_s_per_m: damping,
            support_stiffness_n_per_m: stiffness_of_supports,
            support_damping_n_s_per_m: 10.0 * damping,
            backlash_m: 0.0,
        }
    }

    /// k and e that swing.
    fn excitation(seconds: f64) -> Excitation {
        Excitation {
            stiffness: 6e8 * (1.0 + 0.2 * (3e3 * seconds).sin()),
            error: 5e-6 * (4e3 * seconds).cos(),
        }
    }

    fn implicitly(motion: &Motion, start: State, seconds: f64, steps: usize) -> State {
        let length = seconds / steps as f64;
        let step = StiffStep::new(motion, [length]);
        (0..steps).fold(start, |state, n| {
            let stages: [_; STAGES] = STAGE_TIMES.map(|place| {
                let Excitation { stiffness, error } = excitation((n as f64 + place) * length);
                [[stiffness], [error]]
            });
            let differing = LaneMotion {
                mesh_damping_n_s_per_m: [motion.mesh_damping_n_s_per_m],
                backlash_m: [motion.backlash_m],
            };
            step.advance(motion, &differing, &state.map(|part| [part]), stages.each_ref()).map(|[part]| part)
        })
    }

    fn explicitly(motion: &Motion, start: State, seconds: f64, steps: usize) -> State {
        let length = seconds / steps as f64;
        (0..steps).fold(start, |state, n| {
            let three = [0.0, 0.5, 1.0].map(|place| excitation((n as f64 + place) * length));
            motion.step(&state, &three, length)
        })
    }

    fn difference(a: &State, b: &State) -> f64 {
        (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn its_error_falls_with_the_third_power_of_the_step() {
        let motion = motion(6.56e7, 1e3);
        let start = motion.at_rest(excitation(0.0));
        let exact = explicitly(&motion, start, 2e-3, 20_000);
        let errors =
            [100, 200, 400].map(|steps| difference(&implicitly(&motion, start, 2e-3, steps), &exact));
        for two in errors.windows(2) {
            let order = (two[0] / two[1]).log2();
            assert!((2.6..3.6).contains(&order), "{order} of {errors:?}");
        }
    }

    /// Supports a thousand times as stiff, masses and all: what they leave is found with steps 100 times
    /// longer than stable explicit ones.
    #[test]
    fn stiff_supports_need_no_short_steps() {
        let motion = motion(6.56e10, 1e5);
        let start = motion.at_rest(excitation(0.0));
        let exact = explicitly(&motion, start, 5e-3, 200_000);
        let coarse = implicitly(&motion, start, 5e-3, 800);
        let way = difference(&exact, &start);
        assert!(difference(&coarse, &exact) < 1e-4 * way, "{} of {way}", difference(&coarse, &exact));
    }

    /// Teeth that fly through their backlash and come back.
    #[test]
    fn separated_teeth_match_the_explicit_step() {
        let mut motion = motion(6.56e7, 1e3);
        motion.backlash_m = 10e-6;
        motion.drive_m_per_s2 = 50.0;
        let mut start = motion.at_rest(excitation(0.0));
        start[3] -= 0.04;
        let (exact, found) =
            (explicitly(&motion, start, 2e-3, 40_000), implicitly(&motion, start, 2e-3, 4_000));
        assert!(difference(&found, &exact) < 1e-8, "{} {exact:?}", difference(&found, &exact));
    }
}
