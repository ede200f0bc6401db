//! A record sampled over the angle of a shaft instead of over time.

use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};

use super::by_name::Name;
use super::shaft_angle::AngleSource;
use super::spectrum::{HANN_BANDWIDTH_BINS, hann_amplitude};
use super::transform::{Float, Transforms};

/// Whole turns of a shaft, sampled at equal steps of its angle.
#[derive(Debug, Clone, PartialEq)]
pub struct AngleRecord {
    /// Unit of the samples.
    pub unit: Name,
    /// Samples per turn; even, with no prime factor above 7.
    pub samples_per_turn: usize,
    /// Number of whole turns.
    pub turns: usize,
    /// Highest order of the shaft whose amplitude resampling preserves in every turn.
    pub highest_order: usize,
    /// Samples, turn by turn, with the record's mean removed.
    pub samples: Vec<f32>,
    /// Source and accuracy of the angle.
    pub angle: AngleSource,
}

/// A one-sided Hann amplitude (peak) spectrum over orders of a shaft.
#[derive(Debug, Clone, PartialEq)]
pub struct OrderSpectrum {
    /// Unit of the amplitudes.
    pub unit: String,
    /// Bin spacing in orders: one over the number of turns.
    pub resolution_orders: f64,
    /// Equivalent noise bandwidth in orders: 1.5 bins.
    pub bandwidth_orders: f64,
    /// Amplitude of bin k, at k × `resolution_orders`.
    pub amplitude: Vec<f64>,
    /// Source and accuracy of the angle.
    pub angle: AngleSource,
}

impl AngleRecord {
    /// Returns the mean over all turns at each angle.
    pub fn synchronous_average(&self) -> Vec<f64> {
        let mut average = Vec::new();
        self.average_into([&mut average, &mut Vec::new()]);
        average
    }

    /// Writes the average into the first buffer, with the second one as scratch.
    pub(super) fn average_into(&self, [average, odd]: [&mut Vec<f64>; 2]) {
        self.sum_into(0..self.turns, [&mut *average, &mut *odd]);
        let scale = 1.0 / self.turns as f64;
        average.iter_mut().zip(odd).for_each(|(sum, odd)| *sum = (*sum + *odd) * scale);
    }

    /// Writes the sums at each angle over the even and over the odd turns of a range, counted from its start,
    /// into `sums`.
    pub(super) fn sum_into<T: Float + From<f32>>(&self, turns: Range<usize>, sums: [&mut Vec<T>; 2]) {
        let per_turn = self.samples_per_turn;
        let samples = &self.samples[turns.start * per_turn..turns.end * per_turn];
        for (parity, sum) in sums.into_iter().enumerate() {
            sum.resize(per_turn, T::default());
            Arch::new().dispatch(EverySecondTurn { samples, parity, sum });
        }
    }

    /// Returns the Hann amplitude spectrum over orders.
    pub(super) fn order_spectrum(&self, transforms: &mut Transforms) -> OrderSpectrum {
        let mut samples: Vec<f64> = self.samples.iter().map(|&sample| sample.into()).collect();
        let (mut bins, mut amplitude) = (Vec::new(), Vec::new());
        let mean = samples.iter().sum::<f64>() / samples.len() as f64;
        samples.iter_mut().for_each(|sample| *sample -= mean);
        transforms.forward(&mut samples, &mut bins);
        hann_amplitude(&bins, samples.len(), &mut amplitude);
        let resolution_orders = 1.0 / self.turns as f64;
        OrderSpectrum {
            unit: self.unit.to_string(),
            resolution_orders,
            bandwidth_orders: HANN_BANDWIDTH_BINS * resolution_orders,
            amplitude,
            angle: self.angle,
        }
    }
}

/// The sum over every second turn, as a plain loop compiled for each instruction set.
struct EverySecondTurn<'a, T> {
    samples: &'a [f32],
    parity: usize,
    sum: &'a mut [T],
}

impl<T: Float + From<f32>> WithSimd for EverySecondTurn<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let mut turns = self.samples.chunks_exact(self.sum.len()).skip(self.parity).step_by(2);
        match turns.next() {
            Some(first) => {
                self.sum.iter_mut().zip(first).for_each(|(sum, &sample)| *sum = sample.into());
            }
            None => self.sum.fill(T::default()),
        }
        for turn in turns {
            for (sum, &sample) in self.sum.iter_mut().zip(turn) {
                *sum = *sum + sample.into();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::super::line::read_line;
    use super::*;

    /// The line read from a few bins is the one in the whole spectrum.
    #[test]
    fn summed_line_equals_the_transform() {
        for (turns, samples_per_turn, teeth) in [(4, 120, 20), (37, 210, 24), (163, 96, 17)] {
            let samples = (0..turns * samples_per_turn).map(|n| {
                let turn = TAU * n as f64 / samples_per_turn as f64;
                0.7 + (f64::from(teeth) * 1.0007 * turn).sin()
                    + 0.4 * (3.3 * turn).cos()
                    + 0.1 * ((n * n % 17) as f64)
            });
            let samples = samples.map(|sample| sample as f32);
            let turned = AngleRecord {
                unit: "g".into(),
                samples_per_turn,
                turns,
                highest_order: samples_per_turn / 2,
                samples: samples.collect(),
                angle: AngleSource::ConstantSpeed,
            };
            let spectrum = turned.order_spectrum(&mut Transforms::default());
            let want = read_line(&spectrum.amplitude, f64::from(teeth) * turns as f64).unwrap();
            let got = turned.mesh_line_and_average(teeth, &mut Transforms::default()).0.unwrap();
            assert!((got.amplitude / want.amplitude - 1.0).abs() < 1e-11, "{got:?} {want:?}");
            assert!((got.position - want.position).abs() < 1e-9, "{got:?} {want:?}");
        }
    }
}
