//! From the integrator's steps to a record's samples: low-pass and decimation.

use std::f64::consts::PI;

/// Pass band's end as a part of the output rate; the stop band starts at half of it.
const PASS: f64 = 0.4;
const STOP: f64 = 0.5;
/// Attenuation of the stop band in dB.
const ATTENUATION_DB: f64 = 80.0;
/// Values kept before the used ones are dropped.
const BLOCK: usize = 1 << 14;

/// Finite impulse response low-pass (Kaiser's window, 80 dB) that keeps every `factor`-th value. Flat to 0.4 of the output rate.
///
/// Input n is the mean around step n weighted by a triangle that ends at n − 1 and n + 1 (the second difference of what the input is
/// the second derivative of), so that jumps between steps hardly alias; the filter makes up for that mean's droop. Output j is at the
/// instant j·factor exactly.
#[derive(Debug)]
pub(super) struct Decimator {
    taps: Vec<f64>,
    factor: usize,
    buffer: Vec<f64>,
    /// Place in the buffer of the next output's first value.
    next: usize,
}

impl Decimator {
    pub(super) fn new(factor: usize) -> Self {
        Self {
            taps: taps(factor),
            factor,
            buffer: Vec::new(),
            next: 0,
        }
    }

    /// Values before and after an output's instant that it needs.
    pub(super) fn reach(&self) -> usize {
        self.taps.len() / 2
    }

    /// Takes one value; gives an output where it completes one. The first completes with value number 2 × reach + 1.
    #[inline]
    pub(super) fn push(&mut self, value: f64) -> Option<f64> {
        self.buffer.push(value);
        if self.buffer.len() < self.next + self.taps.len() {
            return None;
        }
        let output = dot(&self.taps, &self.buffer[self.next..self.next + self.taps.len()]);
        self.next += self.factor;
        if self.next > BLOCK {
            // The filter is some 50 times longer than the factor, so the next output starts within the buffer.
            self.buffer.drain(..self.next);
            self.next = 0;
        }
        Some(output)
    }
}

/// In eight sums that do not wait for each other.
fn dot(taps: &[f64], values: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    let (tap_chunks, tap_rest) = taps.as_chunks::<8>();
    let (value_chunks, value_rest) = values.as_chunks::<8>();
    for (taps, values) in tap_chunks.iter().zip(value_chunks) {
        for i in 0..8 {
            sums[i] += taps[i] * values[i];
        }
    }
    sums.iter().sum::<f64>() + tap_rest.iter().zip(value_rest).map(|(tap, value)| tap * value).sum::<f64>()
}

fn taps(factor: usize) -> Vec<f64> {
    let transition = (STOP - PASS) / factor as f64;
    let half = ((ATTENUATION_DB - 8.0) / (2.285 * 2.0 * PI * transition) / 2.0).ceil() as usize;
    let beta = 0.1102 * (ATTENUATION_DB - 8.7);
    let cutoff = 0.5 * (PASS + STOP) / factor as f64;
    let mut low_pass: Vec<f64> = (0..=2 * half)
        .map(|i| {
            let place = i as f64 - half as f64;
            let window = bessel_i0(beta * (1.0 - (place / half as f64).powi(2)).max(0.0).sqrt());
            let sinc = if i == half {
                2.0 * cutoff
            } else {
                (2.0 * PI * cutoff * place).sin() / (PI * place)
            };
            sinc * window
        })
        .collect();
    let sum: f64 = low_pass.iter().sum();
    for tap in &mut low_pass {
        *tap /= sum;
    }
    // The triangle has the response sinc²(f); 7/6 − cos(2πf)/6 undoes it to the fourth order.
    let at = |i: usize| if i == 0 { 0.0 } else { low_pass.get(i - 1).copied().unwrap_or(0.0) };
    (0..low_pass.len() + 2)
        .map(|i| at(i) * 7.0 / 6.0 - (at(i.wrapping_sub(1)) + at(i + 1)) / 12.0)
        .collect()
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

    /// Amplitude and phase of the output for a sine of `frequency` output rates, whose triangular means are the input.
    fn response(factor: usize, frequency: f64) -> (f64, f64) {
        let mut decimator = Decimator::new(factor);
        let reach = decimator.reach() as i64;
        let rate = 2.0 * PI * frequency / factor as f64;
        let outputs = 400;
        let (mut sine, mut cosine, mut j) = (0.0, 0.0, 0);
        for n in -reach..=reach + (outputs - 1) * factor as i64 {
            let droop = (rate / 2.0).sin().powi(2) / (rate / 2.0).powi(2);
            if let Some(output) = decimator.push(droop * (rate * n as f64).sin()) {
                sine += output * (2.0 * PI * frequency * f64::from(j)).sin();
                cosine += output * (2.0 * PI * frequency * f64::from(j)).cos();
                j += 1;
            }
        }
        let count = f64::from(j);
        ((2.0 * sine / count).hypot(2.0 * cosine / count), cosine.atan2(sine))
    }

    #[test]
    fn passes_and_stops_where_it_says_without_delay() {
        for factor in [8, 13] {
            for frequency in [0.05, 0.2, 0.4] {
                let (gain, phase) = response(factor, frequency);
                assert!((gain - 1.0).abs() < 3e-4, "gain {gain} at {frequency}");
                assert!(phase.abs() < 1e-3, "phase {phase} at {frequency}");
            }
            for frequency in [0.5625, 0.7375, 1.0625, 2.2] {
                let (gain, _) = response(factor, frequency);
                assert!(gain < 2e-4, "gain {gain} at {frequency}");
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
