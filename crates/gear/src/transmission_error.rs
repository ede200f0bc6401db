//! The error terms of Eqs. (25) and (26) other than wear.

use std::f64::consts::TAU;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::Errors;

/// Clock index of a run's start, so that the start-up before it has valid indices.
const INDEX_OF_START: i64 = 1 << 40;

/// e_error(t): a random number from 0 to its range on every tick of a fixed clock, linear between the ticks.
///
/// The number is a function of the seed and the tick only, so a run does not depend on the integrator's step.
/// The linear interpolation has a derivative.
#[derive(Debug)]
pub(super) struct RandomError {
    generator: ChaCha8Rng,
    range_m: f64,
    clock_hz: f64,
    tick: i64,
    /// Values at the tick before, at the tick and at the next.
    values: [f64; 3],
}

impl RandomError {
    pub(super) fn new(spec: &Errors, seed: u64) -> Self {
        let mut error = Self {
            generator: ChaCha8Rng::seed_from_u64(seed),
            range_m: spec.random_um * 1e-6,
            clock_hz: spec.random_clock_hz,
            tick: 0,
            values: [0.0; 3],
        };
        error.seek(0);
        error
    }

    /// Returns e_error in metres at `seconds` from the run's start; fast if calls are consecutive in time, or
    /// go back by at most one tick.
    pub(super) fn at(&mut self, seconds: f64) -> f64 {
        let place = seconds * self.clock_hz;
        let tick = place.floor();
        let index = tick as i64;
        if index == self.tick - 1 {
            return self.values[0] + (place - tick) * (self.values[1] - self.values[0]);
        }
        if index != self.tick {
            if index == self.tick + 1 {
                self.tick = index;
                self.values = [self.values[1], self.values[2], self.draw()];
            } else {
                self.seek(index);
            }
        }
        self.values[1] + (place - tick) * (self.values[2] - self.values[1])
    }

    fn seek(&mut self, tick: i64) {
        // A value takes two of the generator's 32-bit words.
        let index = INDEX_OF_START.saturating_add(tick).saturating_sub(1).max(0);
        self.generator.set_word_pos(u128::from(index.unsigned_abs()) * 2);
        self.tick = tick;
        self.values = [self.draw(), self.draw(), self.draw()];
    }

    fn draw(&mut self) -> f64 {
        // The upper 53 bits: every multiple of 2⁻⁵³ in [0, 1).
        self.range_m * (self.generator.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Distance in radians between the angles at which [`LongPeriodError`] computes sine and cosine.
const SINE_SPACING_RAD: f64 = 0.02;

/// e_A1 over the shaft's angle: A₁ sin(2π f₁ t). From sine and cosine at one of evenly spaced angles
/// it is a polynomial, which is exact to rounding and faster for calls at neighbouring angles.
#[derive(Debug)]
pub(super) struct LongPeriodError {
    amplitude_m: f64,
    /// Number of the last of these angles towards zero, and sine and cosine there.
    number: i64,
    sine: f64,
    cosine: f64,
}

impl LongPeriodError {
    pub(super) fn new(spec: &Errors) -> Self {
        Self { amplitude_m: spec.long_period_um * 1e-6, number: 0, sine: 0.0, cosine: 1.0 }
    }

    /// Returns e_A1 in metres at a shaft angle in turns.
    #[inline]
    pub(super) fn at(&mut self, shaft_turns: f64) -> f64 {
        let angle = TAU * shaft_turns;
        let number = (angle * (1.0 / SINE_SPACING_RAD)) as i64;
        if number != self.number {
            self.number = number;
            (self.sine, self.cosine) = (number as f64 * SINE_SPACING_RAD).sin_cos();
        }
        let x = angle - number as f64 * SINE_SPACING_RAD;
        let square = x * x;
        // The next terms are below 1e-13.
        let cosine = 1.0 - square * (0.5 - square * (1.0 / 24.0));
        let sine = x * (1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0)));
        self.amplitude_m * (self.sine * cosine + self.cosine * sine)
    }
}

impl Errors {
    /// Returns e_A2 in metres at a phase in mesh periods: A₂ sin(2π (f_m t + ψ)) with the phase ψ in mesh
    /// periods.
    pub fn short_period_m(&self, mesh_periods: f64) -> f64 {
        self.short_period_um * 1e-6 * (TAU * (mesh_periods + self.short_period_phase)).sin()
    }
}

#[cfg(test)]
mod tests {
    use super::{LongPeriodError, RandomError};
    use crate::testing::shen2022_spec;

    #[test]
    fn random_error_is_a_function_of_seed_and_clock_alone() {
        let spec = shen2022_spec().errors();
        let mut coarse = RandomError::new(&spec, 7);
        let mut fine = RandomError::new(&spec, 7);
        let mut backwards = RandomError::new(&spec, 7);
        let times: Vec<f64> = (-400..400).map(|i| f64::from(i) * 3.1e-5).collect();
        let coarse: Vec<f64> = times.iter().map(|t| coarse.at(*t)).collect();
        let mut back: Vec<f64> = times.iter().rev().map(|t| backwards.at(*t)).collect();
        back.reverse();
        for (i, t) in times.iter().enumerate() {
            for k in 0..9 {
                fine.at(t + 3.1e-6 * f64::from(k));
            }
            let again = fine.at(*t);
            assert_eq!(again.to_bits(), coarse[i].to_bits());
            assert_eq!(back[i].to_bits(), coarse[i].to_bits());
        }
        assert_ne!(RandomError::new(&spec, 8).at(0.0), coarse[400]);
    }

    #[test]
    fn random_error_fills_its_range_evenly_and_is_continuous() {
        let spec = shen2022_spec().errors();
        let mut error = RandomError::new(&spec, 1);
        let ticks = 20_000;
        let values: Vec<f64> =
            (0..ticks).map(|tick| error.at((f64::from(tick) + 1e-9) / spec.random_clock_hz)).collect();
        let mean = values.iter().sum::<f64>() / f64::from(ticks);
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / f64::from(ticks);
        // A uniform distribution on [0, r]: mean r/2, variance r²/12; five standard errors of 20 000 draws.
        let range = 0.2e-6;
        assert!((mean / range - 0.5).abs() < 5.0 * (1.0 / 12.0_f64 / f64::from(ticks)).sqrt());
        assert!((variance / range.powi(2) * 12.0 - 1.0).abs() < 0.04);
        let before = error.at(3.0 / spec.random_clock_hz - 1e-12);
        let after = error.at(3.0 / spec.random_clock_hz + 1e-12);
        assert!((before - after).abs() < 1e-6 * range);
    }

    #[test]
    fn periodic_errors_are_the_sines_of_equation_26() {
        let spec = shen2022_spec().errors();
        let mut long_period = LongPeriodError::new(&spec);
        for n in -400..400 {
            let turns = f64::from(n) * 0.0377;
            let expected = 30e-6 * (std::f64::consts::TAU * turns).sin();
            assert!((long_period.at(turns) - expected).abs() < 1e-17, "at {turns} turns");
        }
        assert!((spec.short_period_m(1.0 / 12.0) - 7.5e-6).abs() < 1e-18);
    }
}
