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
/// Input n is the mean over the step from n to n + 1; the filter makes up for that mean's droop, and its even length puts output j at the
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

    /// Values before the first output's instant, and from it on, that an output needs.
    pub(super) fn reach(&self) -> usize {
        self.taps.len() / 2
    }

    /// Takes one value; gives an output where it completes one. The first completes with value number 2 × reach.
    #[inline]
    pub(super) fn push(&mut self, value: f64) -> Option<f64> {
        self.buffer.push(value);
        if self.buffer.len() < self.next + self.taps.len() {
            return None;
        }
        let output = dot(&self.taps, &self.buffer[self.next..self.next + self.taps.len()]);
        self.next += self.factor;
        if self.next > BLOCK {
            // The next output can start beyond what is there already where the factor is longer than the filter: never, it is 50 times longer.
            self.buffer.drain(..self.next.min(self.buffer.len()));
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
    let mut low_pass: Vec<f64> = (0..2 * half)
        .map(|i| {
            let place = i as f64 + 0.5 - half as f64;
            let window = bessel_i0(beta * (1.0 - (place / half as f64).powi(2)).max(0.0).sqrt());
            (2.0 * PI * cutoff * place).sin() / (PI * place) * window
        })
        .collect();
    let sum: f64 = low_pass.iter().sum();
    for tap in &mut low_pass {
        *tap /= sum;
    }
    // A mean over one step has the response sin(πf)/(πf); 13/12 − cos(2πf)/12 undoes it to the fourth order.
    let at = |i: isize| usize::try_from(i).ok().and_then(|i| low_pass.get(i)).copied().unwrap_or(0.0);
    (-1..=2 * half as isize)
        .map(|i| at(i) * 13.0 / 12.0 - (at(i - 1) + at(i + 1)) / 24.0)
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

    /// Amplitude and phase of the output for a sine of `frequency` output rates, whose step means are the input.
    fn response(factor: usize, frequency: f64) -> (f64, f64) {
        let mut decimator = Decimator::new(factor);
        let reach = decimator.reach() as i64;
        let rate = 2.0 * PI * frequency / factor as f64;
        let outputs = 400;
        let (mut sine, mut cosine, mut j) = (0.0, 0.0, 0);
        for n in -reach..reach + (outputs - 1) * factor as i64 {
            let mean = (rate * n as f64).cos() - (rate * (n + 1) as f64).cos();
            if let Some(output) = decimator.push(mean / rate) {
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
