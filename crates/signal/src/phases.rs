//! The phases of many complex numbers at once. The C library's arctangent computes one at a time, which took
//! a tenth of a record's analysis.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use flankwatch_fourier::Complex;
use pulp::{Arch, Simd, WithSimd};

/// From this ratio on, the arctangent is computed of the angle's distance from π/4.
const STEEP: f64 = 0.66;

/// Numerator and denominator of (atan(x) − x)/x³ over x² up to 0.66, highest power first (Moshier, Cephes
/// Mathematical Library, `atan.c`); the denominator's highest coefficient is 1.
const NUMERATOR: [f64; 5] = [
    -8.750_608_600_031_904e-1,
    -1.615_753_718_733_365e1,
    -7.500_855_792_314_705e1,
    -1.228_866_684_490_136_1e2,
    -6.485_021_904_942_025e1,
];
const DENOMINATOR: [f64; 5] = [
    2.485_846_490_142_306_4e1,
    1.650_270_098_316_988_6e2,
    4.328_810_604_912_903e2,
    4.853_903_996_359_137e2,
    1.945_506_571_482_614e2,
];

/// Writes the phase of each value, from −π to π, to `phases`.
pub(super) fn phases_of(values: &[Complex<f64>], phases: &mut Vec<f64>) {
    phases.resize(values.len(), 0.0);
    Arch::new().dispatch(Phases { values, phases });
}

/// Adds the phase from each value to the next one, from −π to π, to `steps`.
pub(super) fn add_phase_steps(values: &[Complex<f64>], steps: &mut [f64]) {
    Arch::new().dispatch(PhaseSteps { values, steps });
}

struct PhaseSteps<'a> {
    values: &'a [Complex<f64>],
    steps: &'a mut [f64],
}

impl WithSimd for PhaseSteps<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (step, pair) in self.steps.iter_mut().zip(self.values.windows(2)) {
            *step += phase_of(pair[1] * pair[0].conj());
        }
    }
}

struct Phases<'a> {
    values: &'a [Complex<f64>],
    phases: &'a mut [f64],
}

impl WithSimd for Phases<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (phase, value) in self.phases.iter_mut().zip(self.values) {
            *phase = phase_of(*value);
        }
    }
}

/// Returns `value.arg()` within a few units in the last place, without a branch.
#[inline(always)]
fn phase_of(value: Complex<f64>) -> f64 {
    let (re, im) = (value.re.abs(), value.im.abs());
    let (low, high) = if im > re { (re, im) } else { (im, re) };
    let is_steep = low > STEEP * high;
    let (above, below) = if is_steep { (low - high, low + high) } else { (low, high) };
    // Zero has the phase zero.
    let x = above / if below > 0.0 { below } else { 1.0 };
    let square = x * x;
    let numerator = NUMERATOR.iter().fold(0.0, |sum, coefficient| sum * square + coefficient);
    let denominator = DENOMINATOR.iter().fold(1.0, |sum, coefficient| sum * square + coefficient);
    let arctangent = x + x * square * numerator / denominator + if is_steep { FRAC_PI_4 } else { 0.0 };
    let to_axis = if im > re { FRAC_PI_2 - arctangent } else { arctangent };
    let unsigned = if value.re < 0.0 { PI - to_axis } else { to_axis };
    unsigned.copysign(value.im)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phases_equal_those_of_the_standard_library() {
        let steps = 100_003;
        let on_circle = (0..=steps).map(|i| {
            Complex::from_polar(1e-3 * f64::from(i + 1), PI * (2.0 * f64::from(i) / f64::from(steps) - 1.0))
        });
        let on_axes =
            [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0), (1.0, 1.0), (-1.0, 1e-300)];
        let values: Vec<Complex<f64>> =
            on_circle.chain(on_axes.map(|(re, im)| Complex::new(re, im))).collect();
        let mut phases = Vec::new();
        phases_of(&values, &mut phases);
        for (got, value) in phases.iter().zip(&values) {
            let want = value.im.atan2(value.re);
            assert!((got - want).abs() <= 4.0 * f64::EPSILON * want.abs(), "{value}: {got} {want}");
        }
    }
}
