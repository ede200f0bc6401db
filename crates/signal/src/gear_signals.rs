//! The synchronous average of a gear, split into the part of a healthy mesh and the rest.

use flankwatch_fourier::Complex;

use super::sums::mean_of;
use super::transform::Transforms;

/// Shaft orders of the regular signal: once and twice per turn (unbalance, misalignment).
const SHAFT_ORDERS: usize = 2;

/// Sidebands on each side of the mesh line in sideband energy and in the envelope band of NB4.
const SIDEBANDS: usize = 6;

/// The synchronous average of one shaft over one turn, and its components. Bins of its transform are whole
/// orders of the shaft, so the components are exact: no window, no leakage.
#[derive(Debug, Clone, PartialEq)]
pub struct GearSignals {
    /// The average, its mean removed.
    pub average: Vec<f64>,
    /// Shaft orders 1 and 2, all mesh harmonics below half the sampling rate, and the orders of other known
    /// meshes.
    pub regular: Vec<f64>,
    /// The average without the regular signal.
    pub residual: Vec<f64>,
    /// The residual without the first-order sidebands of every mesh harmonic.
    pub difference: Vec<f64>,
    /// The modulus of the analytic signal of the orders teeth − 6 to teeth + 6 (of 1 and above, below 2 ×
    /// teeth), mean removed.
    pub mesh_envelope: Vec<f64>,
    /// Amplitude (peak) at each order.
    amplitude: Vec<f64>,
    teeth: usize,
    /// Highest order whose amplitude is read.
    highest_order: usize,
}

impl GearSignals {
    /// Splits `average`, one turn of a shaft with this many teeth. Orders of other meshes (`is_foreign`)
    /// count as regular, and amplitudes above `highest_order` are not read. `None` unless order `teeth` + 1
    /// lies below half the number of samples.
    pub(super) fn split(
        average: &[f64],
        teeth: u32,
        highest_order: usize,
        is_foreign: &dyn Fn(usize) -> bool,
        transforms: &mut Transforms,
    ) -> Option<Self> {
        let (samples, teeth) = (average.len(), teeth as usize);
        if teeth == 0 || 2 * (teeth + 1) >= samples {
            return None;
        }
        let (mut bins, mut turn) = (transforms.complex_buffer(), transforms.buffer());
        turn.extend_from_slice(average);
        transforms.forward(&mut turn, &mut bins);
        transforms.recycle(turn);
        let scale = 1.0 / samples as f64;
        bins.iter_mut().for_each(|bin| *bin *= scale);
        bins[0] = Complex::default();
        let mut signal = |selects: &dyn Fn(usize) -> bool, factor: Complex<f64>| {
            let (mut selected, mut output) = (transforms.complex_buffer(), transforms.buffer());
            let all = bins.iter().enumerate();
            selected.extend(all.map(|(k, bin)| if selects(k) { bin * factor } else { Complex::default() }));
            if let Some(last) = selected.last_mut()
                && samples.is_multiple_of(2)
            {
                last.im = 0.0;
            }
            output.resize(samples, 0.0);
            transforms.inverse(&mut selected, &mut output);
            transforms.recycle_complex(selected);
            output
        };
        let one = Complex::new(1.0, 0.0);
        let regular = |k: usize| k <= SHAFT_ORDERS || k.is_multiple_of(teeth) || is_foreign(k);
        let sideband = |k: usize| k > teeth / 2 && (k % teeth == 1 || k % teeth == teeth - 1);
        let band = teeth.saturating_sub(SIDEBANDS).max(1)
            ..=(teeth + SIDEBANDS).min(2 * teeth - 1).min((samples - 1) / 2);
        let real = signal(&|k| band.contains(&k), one);
        let imaginary = signal(&|k| band.contains(&k), Complex::new(0.0, -1.0));
        let difference = signal(&|k| !regular(k) && !sideband(k), one);
        let regular = signal(&regular, one);
        let mean = mean_of(average, |x| *x);
        let [mut whole, mut residual] = [transforms.buffer(), transforms.buffer()];
        whole.extend(average.iter().map(|x| x - mean));
        residual.extend(whole.iter().zip(&regular).map(|(whole, regular)| whole - regular));
        let mut mesh_envelope = real;
        for (re, im) in mesh_envelope.iter_mut().zip(&imaginary) {
            *re = (*re * *re + im * im).sqrt();
        }
        let mean = mean_of(&mesh_envelope, |modulus| *modulus);
        mesh_envelope.iter_mut().for_each(|modulus| *modulus -= mean);
        transforms.recycle(imaginary);
        let mut amplitude = transforms.buffer();
        amplitude.extend(bins.iter().map(|bin| 2.0 * bin.norm()));
        transforms.recycle_complex(bins);
        let highest_order = highest_order.min((samples - 1) / 2);
        Some(Self {
            average: whole,
            regular,
            residual,
            difference,
            mesh_envelope,
            amplitude,
            teeth,
            highest_order,
        })
    }

    /// Returns the buffers for reuse.
    pub(super) fn recycle(self, transforms: &mut Transforms) {
        let Self { average, regular, residual, difference, mesh_envelope, amplitude, .. } = self;
        for buffer in [average, regular, residual, difference, mesh_envelope, amplitude] {
            transforms.recycle(buffer);
        }
    }

    /// Returns the amplitude (peak) of mesh harmonic `order`, if resampling preserves it.
    pub fn mesh_line(&self, order: usize) -> Option<f64> {
        self.preserved_amplitude(order * self.teeth)
    }

    /// Returns Σ of the amplitudes at teeth ± k shaft orders, k = 1 … 6, if all of them exist and belong to
    /// the first mesh line.
    pub(super) fn sideband_sum(&self) -> Option<f64> {
        if self.teeth <= SIDEBANDS {
            return None;
        }
        (1..=SIDEBANDS)
            .map(|k| {
                Some(self.preserved_amplitude(self.teeth - k)? + self.preserved_amplitude(self.teeth + k)?)
            })
            .sum()
    }

    /// Returns the sum of the amplitudes of the first sidebands of the first mesh line.
    pub(super) fn first_sidebands(&self) -> Option<f64> {
        Some(self.preserved_amplitude(self.teeth - 1)? + self.preserved_amplitude(self.teeth + 1)?)
    }

    fn preserved_amplitude(&self, order: usize) -> Option<f64> {
        (order <= self.highest_order).then(|| self.amplitude[order])
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    fn turn(lines: &[(f64, f64)]) -> Vec<f64> {
        let at = |i: i32| {
            lines.iter().map(|(order, a)| a * (TAU * order * f64::from(i) / 240.0 + order).cos()).sum()
        };
        (0..240).map(at).collect()
    }

    fn assert_equal(got: &[f64], want: &[f64]) {
        assert!(got.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-12), "{got:?} {want:?}");
    }

    /// What is put in at each order comes out in its part, and nowhere else.
    #[test]
    fn components_are_the_generated_orders() {
        let regular = [(1.0, 0.3), (2.0, 0.2), (20.0, 1.0), (40.0, 0.5), (100.0, 0.1)];
        let sidebands = [(19.0, 0.2), (21.0, 0.25), (41.0, 0.05), (99.0, 0.03)];
        let others = [(3.0, 0.07), (18.0, 0.06), (55.0, 0.04), (115.0, 0.02)];
        let average = turn(&[&regular[..], &sidebands, &others, &[(0.0, 5.0)]].concat());
        let got = GearSignals::split(&average, 20, 119, &|_| false, &mut Transforms::default()).unwrap();
        assert_equal(&got.regular, &turn(&regular));
        assert_equal(&got.residual, &turn(&[&sidebands[..], &others].concat()));
        assert_equal(&got.difference, &turn(&others));
        assert_equal(&got.average, &turn(&[&regular[..], &sidebands, &others].concat()));
        assert!((got.mesh_line(2).unwrap() - 0.5).abs() < 1e-12);
        assert_eq!(got.mesh_line(6), None);
        // The fifth harmonic is at order 100.
        let narrow = GearSignals::split(&average, 20, 99, &|_| false, &mut Transforms::default()).unwrap();
        assert_eq!((narrow.mesh_line(2), narrow.mesh_line(5)), (got.mesh_line(2), None));
        let of_another =
            GearSignals::split(&average, 20, 119, &|k| k == 18 || k == 55, &mut Transforms::default())
                .unwrap();
        assert_equal(&of_another.difference, &turn(&[others[0], others[3]]));
        assert!((got.sideband_sum().unwrap() - (0.2 + 0.25 + 0.06)).abs() < 1e-12);
        assert!((got.first_sidebands().unwrap() - 0.45).abs() < 1e-12);
    }

    /// Closed form: (1 + m·cos θ)·cos(zθ) has the envelope 1 + m·cos θ.
    #[test]
    fn the_mesh_envelope_is_the_modulation() {
        let average: Vec<f64> = (0..240)
            .map(|i| {
                let angle = TAU * f64::from(i) / 240.0;
                (1.0 + 0.3 * angle.cos()) * (20.0 * angle).cos()
            })
            .collect();
        let got = GearSignals::split(&average, 20, 119, &|_| false, &mut Transforms::default()).unwrap();
        assert_equal(
            &got.mesh_envelope,
            &turn(&[(1.0, 0.0)])
                .iter()
                .zip(0..)
                .map(|(_, i)| 0.3 * (TAU * f64::from(i) / 240.0).cos())
                .collect::<Vec<_>>(),
        );
    }

    #[test]
    fn a_turn_too_short_for_its_mesh_is_rejected() {
        for (samples, teeth) in [(0, 20), (42, 20), (240, 0), (240, u32::MAX)] {
            assert_eq!(
                GearSignals::split(
                    &vec![1.0; samples],
                    teeth,
                    samples,
                    &|_| false,
                    &mut Transforms::default()
                ),
                None
            );
        }
    }
}
