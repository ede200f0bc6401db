//! Exponentials and logarithms in single precision, without branches, so that compilers vectorise them and
//! every processor gives the same bits.

use std::f32::consts::{LN_2, LOG2_E, SQRT_2};

/// Adding this to a number and subtracting it again rounds the number to an integer, which is in the last
/// bits of the sum.
const ROUNDING: f32 = 12_582_912.0;

/// ln 2 in two parts: the first has few bits, so that integer multiples of it are exact.
const LN_2_HIGH: f32 = 0.693_359_4;
const LN_2_LOW: f32 = -2.121_944_4e-4;

/// Coefficients of (eˣ − 1 − x) / x² on ± ½ ln 2, and of (ln(1 + x) − x) / x² from √½ to √2, by interpolation
/// at Chebyshev points.
const EXP: [f32; 5] = [0.5, 1.666_657_7e-1, 4.166_655_5e-2, 8.363_173e-3, 1.392_617_6e-3];
const LN: [f32; 8] = [
    -0.5,
    3.333_367e-1,
    -2.500_114_8e-1,
    1.997_205e-1,
    -1.658_848_8e-1,
    1.483_478_7e-1,
    -1.415_964_7e-1,
    8.787_265_5e-2,
];

/// Returns eˣ, limited to e⁻⁸⁷ to e⁸⁷, with a relative error of 10⁻⁶.
#[inline(always)]
pub(super) fn exp(x: f32) -> f32 {
    let x = x.clamp(-87.0, 87.0);
    let shifted = x * LOG2_E + ROUNDING;
    let whole = shifted - ROUNDING;
    let rest = x - whole * LN_2_HIGH - whole * LN_2_LOW;
    let power = f32::from_bits(shifted.to_bits().wrapping_sub(ROUNDING.to_bits()).wrapping_add(127) << 23);
    power * (1.0 + rest + rest * rest * polynomial(&EXP, rest))
}

/// Returns ln x of a positive normal number, with a relative error of 10⁻⁶ or an absolute one of 10⁻⁷.
#[inline(always)]
pub(super) fn ln(x: f32) -> f32 {
    let shifted = x.to_bits().wrapping_sub((0.5 * SQRT_2).to_bits());
    let exponent = shifted.cast_signed() >> 23;
    let rest = f32::from_bits(x.to_bits().wrapping_sub((exponent << 23).cast_unsigned())) - 1.0;
    exponent as f32 * LN_2 + (rest + rest * rest * polynomial(&LN, rest))
}

#[inline(always)]
fn polynomial<const N: usize>(coefficients: &[f32; N], x: f32) -> f32 {
    coefficients.iter().rev().fold(0.0, |sum, coefficient| sum * x + coefficient)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_agree_with_double_precision() {
        for step in -8700..=8700 {
            let x = step as f32 * 0.01;
            let exact = f64::from(x).exp();
            assert!((f64::from(exp(x)) / exact - 1.0).abs() < 1e-6, "e^{x}");
            let y = exact as f32;
            let near = (f64::from(ln(y)) - f64::from(y).ln()).abs();
            assert!(near < 1e-6 * f64::from(x).abs().max(0.1), "ln {y}: {near}");
        }
        assert_eq!((exp(0.0), ln(1.0)), (1.0, 0.0));
        assert!(exp(-1000.0) < 1e-37 && exp(-1000.0) > 0.0);
    }
}
