//! Low-pass filter and decimation from the integrator's steps to a record's samples, for several records in
//! parallel.

use std::f64::consts::PI;

/// End of the pass band as a fraction of the output rate; the stop band starts at half of it.
const PASS: f64 = 0.4;
const STOP: f64 = 0.5;
/// Attenuation of the stop bands in dB. The shaft sidebands of worn gears lie 60 dB below the mesh lines, and
/// lines above half the output rate alias next to them: with 80 dB those features change by some per cent.
const ATTENUATION_DB: f64 = 140.0;
/// Number of used values in the buffer before they are dropped.
const BLOCK: usize = 1 << 10;

/// Finite impulse response low-pass (Kaiser window) that returns every `factor`-th value of each lane. Flat
/// to 0.4 of the output rate.
///
/// Two stages: the first decimates to twice the output rate and removes only what the second cannot; the
/// second is the steep one. Input n is the mean around step n weighted by a triangle that ends at n − 1 and
/// n + 1 (the second difference of the quantity whose second derivative the input is), so jumps between steps
/// hardly alias. The first stage compensates the droop of that mean. Output j is exactly at the instant
/// j·factor.
#[derive(Debug)]
pub(super) struct Decimator<const LANES: usize> {
    first: Stage<LANES>,
    second: Stage<LANES>,
}

impl<const LANES: usize> Decimator<LANES> {
    /// `factor` is even.
    pub(super) fn new(factor: usize) -> Self {
        let between = factor / 2;
        // As fractions of the input rate: the first stage's images end at the second stage's stop band.
        let stop = (2.0 - STOP) / factor as f64;
        Self {
            first: Stage::new(without_droop(&low_pass(STOP / factor as f64, stop)), between),
            second: Stage::new(low_pass(0.5 * PASS, 0.5 * STOP), 2),
        }
    }

    /// Returns the number of values before and after an output's instant that it needs.
    pub(super) fn reach(&self) -> usize {
        self.first.taps.len() / 2 + self.second.taps.len() / 2 * self.first.factor
    }

    /// Adds one value of each lane; returns an output if it is complete. The first output is complete with
    /// value number 2 × reach + 1.
    #[inline]
    pub(super) fn push(&mut self, values: [f64; LANES]) -> Option<[f64; LANES]> {
        self.first.push(values).and_then(|values| self.second.push(values))
    }
}

#[derive(Debug)]
struct Stage<const LANES: usize> {
    /// Symmetric about the middle one.
    taps: Vec<f64>,
    factor: usize,
    buffer: Vec<[f64; LANES]>,
    /// Index in the buffer of the next output's first value.
    next: usize,
}

impl<const LANES: usize> Stage<LANES> {
    fn new(taps: Vec<f64>, factor: usize) -> Self {
        Self { taps, factor, buffer: Vec::new(), next: 0 }
    }

    #[inline]
    fn push(&mut self, values: [f64; LANES]) -> Option<[f64; LANES]> {
        self.buffer.push(values);
        if self.buffer.len() < self.next + self.taps.len() {
            return None;
        }
        let output = filtered(&self.taps, &self.buffer[self.next..self.next + self.taps.len()]);
        self.next += self.factor;
        if self.next > BLOCK {
            // The filter is longer than the factor, so the next output starts within the buffer.
            self.buffer.drain(..self.next);
            self.next = 0;
        }
        Some(output)
    }
}

/// Returns each lane's sum of taps times values, in two independent partial sums.
fn filtered<const LANES: usize>(taps: &[f64], values: &[[f64; LANES]]) -> [f64; LANES] {
    let mut sums = [[0.0; LANES]; 2];
    let (tap_pairs, tap_rest) = taps.as_chunks::<2>();
    let (value_pairs, value_rest) = values.as_chunks::<2>();
    for (taps, values) in tap_pairs.iter().zip(value_pairs) {
        for half in 0..2 {
            for lane in 0..LANES {
                sums[half][lane] += taps[half] * values[half][lane];
            }
        }
    }
    for (tap, values) in tap_rest.iter().zip(value_rest) {
        for lane in 0..LANES {
            sums[0][lane] += tap * values[lane];
        }
    }
    std::array::from_fn(|lane| sums[0][lane] + sums[1][lane])
}

/// Returns the taps of a low-pass with these ends of pass and stop band, as fractions of its input rate.
fn low_pass(pass: f64, stop: f64) -> Vec<f64> {
    let half = ((ATTENUATION_DB - 8.0) / (2.285 * 2.0 * PI * (stop - pass)) / 2.0).ceil() as usize;
    let beta = 0.1102 * (ATTENUATION_DB - 8.7);
    let cutoff = 0.5 * (pass + stop);
    let mut taps: Vec<f64> = (0..=2 * half)
        .map(|i| {
            let place = i as f64 - half as f64;
            let window = bessel_i0(beta * (1.0 - (place / half as f64).powi(2)).max(0.0).sqrt());
            let sinc =
                if i == half { 2.0 * cutoff } else { (2.0 * PI * cutoff * place).sin() / (PI * place) };
            sinc * window
        })
        .collect();
    let sum: f64 = taps.iter().sum();
    for tap in &mut taps {
        *tap /= sum;
    }
    taps
}

/// The triangle has the response sinc²(f) = u/arcsin²(√u) with u = sin²(πf); its reciprocal is 1 + u/3 +
/// 8u²/45 + 4u³/35 + …
fn without_droop(taps: &[f64]) -> Vec<f64> {
    const SERIES: [f64; 4] = [1.0, 1.0 / 3.0, 8.0 / 45.0, 4.0 / 35.0];
    let reach = SERIES.len() - 1;
    let mut power = vec![0.0; taps.len() + 2 * reach];
    power[reach..reach + taps.len()].copy_from_slice(taps);
    let mut sum = vec![0.0; power.len()];
    for factor in SERIES {
        sum.iter_mut().zip(&power).for_each(|(sum, value)| *sum += factor * value);
        // u is minus a quarter of the second difference.
        let at = |i: Option<usize>| i.and_then(|i| power.get(i)).copied().unwrap_or(0.0);
        power = (0..power.len())
            .map(|i| 0.5 * at(Some(i)) - 0.25 * (at(i.checked_sub(1)) + at(Some(i + 1))))
            .collect();
    }
    sum
}

/// Modified Bessel function I₀ by its series.
fn bessel_i0(x: f64) -> f64 {
    let (mut term, mut sum, quarter) = (1.0, 1.0, 0.25 * x * x);
    for k in 1..200 {
        term *= quarter / f64::from(k * k);
        sum += term;
        if term < 1e-17 * sum {
            break;
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::{Decimator, bessel_i0};

    /// Amplitude and phase of the output for a sine of `frequency` output rates, whose triangular means are
    /// the input; the second lane has twice of it.
    fn response(factor: usize, frequency: f64) -> (f64, f64) {
        let mut decimator = Decimator::<2>::new(factor);
        let reach = decimator.reach() as i64;
        let rate = 2.0 * PI * frequency / factor as f64;
        let outputs = 400;
        let (mut sine, mut cosine, mut j) = (0.0, 0.0, 0);
        for n in -reach..=reach + (outputs - 1) * factor as i64 {
            let droop = (rate / 2.0).sin().powi(2) / (rate / 2.0).powi(2);
            let input = droop * (rate * n as f64).sin();
            if let Some([output, twice]) = decimator.push([input, 2.0 * input]) {
                assert_eq!(twice, 2.0 * output);
                sine += output * (2.0 * PI * frequency * f64::from(j)).sin();
                cosine += output * (2.0 * PI * frequency * f64::from(j)).cos();
                j += 1;
            }
        }
        assert_eq!(i64::from(j), outputs);
        let count = f64::from(j);
        ((2.0 * sine / count).hypot(2.0 * cosine / count), cosine.atan2(sine))
    }

    #[test]
    fn has_the_stated_pass_and_stop_bands_without_delay() {
        for factor in [8, 14, 64] {
            for frequency in [0.05, 0.2, 0.4] {
                let (gain, phase) = response(factor, frequency);
                assert!((gain - 1.0).abs() < 1e-6, "gain {gain} at {frequency}");
                assert!(phase.abs() < 1e-6, "phase {phase} at {frequency}");
            }
            for frequency in [0.5, 0.5625, 0.7375, 1.0625, 1.45, 1.55, 2.2] {
                let (gain, _) = response(factor, frequency);
                assert!(gain < 2e-7, "gain {gain} at {frequency}");
            }
        }
    }

    #[test]
    fn bessel_function_has_its_tabled_values() {
        // Abramowitz and Stegun, table 9.8.
        assert!((bessel_i0(1.0) - 1.266_065_877_8).abs() < 1e-9);
        assert!((bessel_i0(5.0) - 27.239_871_824).abs() < 1e-8);
    }
}
