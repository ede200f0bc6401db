//! Search for a mesh comb whose lines are smeared by speed fluctuation within the record. Positions are in
//! bins.
//!
//! A line smeared over many bins exceeds the noise in none of them, but its energy over the width of the
//! smear does. For each candidate, the energy in a window around each harmonic, with a width proportional to
//! the harmonic's frequency, is compared with the noise beside it.

use super::comb::MeshComb;
use super::line::{fits, noise_amplitude};

/// Number of harmonics examined.
const ORDERS: usize = 10;

/// Half-widths of the windows as fractions of the frequency: speed fluctuations within a record.
const HALF_WIDTHS: [f64; 3] = [0.0015, 0.003, 0.006];

/// Spacing of candidates in half-widths.
const STEP: f64 = 0.5;

/// Range of the noise bins beside a window, in half-widths, and their minimum number.
const NOISE_RANGE: [f64; 2] = [1.5, 5.0];
const MIN_NOISE_BINS: f64 = 32.0;

/// Bins of a Hann spectrum per statistically independent one.
const BINS_PER_DEGREE: f64 = 1.5;

/// Largest contribution of one harmonic to the logarithm of a comb's likelihood ratio: one line is no comb.
const MAX_HARMONIC_LIKELIHOOD: f64 = 12.0;

/// Smallest sum for a comb: white noise exceeds it in fewer than one of a thousand records.
const MIN_SUM: f64 = 30.0;

/// This many harmonics must exceed this logarithm by themselves.
const MIN_HARMONICS: usize = 2;
const MIN_HARMONIC_LIKELIHOOD: f64 = 4.0;

/// Searches the comb h·f with f from `low` to `high` bins.
pub(super) fn find(amplitude: &[f64], [low, high]: [f64; 2], scratch: &mut Vec<f64>) -> Option<MeshComb> {
    let orders = (1..=ORDERS).take_while(|order| fits(1.02 * *order as f64 * high, amplitude.len())).count();
    if orders < MIN_HARMONICS {
        return None;
    }
    let mut best: Option<(f64, f64, f64)> = None;
    for part in HALF_WIDTHS {
        let ratio = 1.0 + STEP * part;
        let mut mesh = low;
        while mesh <= high {
            let harmonics =
                (1..=orders).filter_map(|order| harmonic(amplitude, order as f64 * mesh, part, scratch));
            let (mut sum, mut detected) = (0.0, 0);
            for (likelihood, _) in harmonics {
                sum += likelihood.min(MAX_HARMONIC_LIKELIHOOD);
                detected += usize::from(likelihood > MIN_HARMONIC_LIKELIHOOD);
            }
            if detected >= MIN_HARMONICS && sum > best.map_or(MIN_SUM, |(sum, ..)| sum) {
                best = Some((sum, mesh, part));
            }
            mesh *= ratio;
        }
    }
    let (_, mesh, part) = best?;
    Some(refined(amplitude, mesh, part, orders, scratch))
}

/// Returns the contribution of one harmonic to the logarithm of the likelihood ratio, and the noise's mean
/// square in one bin.
///
/// The squares of n bins of noise are exponential with mean b². For a mean of r·b² the logarithm of the ratio
/// is n(r − 1 − ln r).
fn harmonic(amplitude: &[f64], position: f64, part: f64, scratch: &mut Vec<f64>) -> Option<(f64, f64)> {
    let half = (part * position).max(1.0);
    let window = amplitude.get((position - half).round() as usize..=(position + half).round() as usize)?;
    let noise = noise_beside(amplitude, position, half, scratch)?;
    let count = window.len() as f64;
    let ratio = window.iter().map(|a| a * a).sum::<f64>() / (count * noise);
    let likelihood = if ratio > 1.0 { count / BINS_PER_DEGREE * (ratio - 1.0 - ratio.ln()) } else { 0.0 };
    Some((likelihood, noise))
}

fn noise_beside(amplitude: &[f64], position: f64, half: f64, scratch: &mut Vec<f64>) -> Option<f64> {
    let (near, far) =
        (NOISE_RANGE[0] * half, (NOISE_RANGE[1] * half).max(NOISE_RANGE[0] * half + MIN_NOISE_BINS));
    scratch.clear();
    for (from, to) in [(position - far, position - near), (position + near, position + far)] {
        let (from, to) = (from.max(1.0) as usize, (to as usize).min(amplitude.len().saturating_sub(1)));
        scratch.extend_from_slice(amplitude.get(from..to)?);
    }
    noise_amplitude(scratch).map(|noise| noise * noise).filter(|noise| *noise > 0.0)
}

/// Returns the comb at the mean of its lines' centres of energy, weighted by their contributions.
fn refined(amplitude: &[f64], mesh: f64, part: f64, orders: usize, scratch: &mut Vec<f64>) -> MeshComb {
    let (mut weights, mut weighted, mut squares) = (0.0, 0.0, 0.0);
    for order in (1..=orders).map(|order| order as f64) {
        let position = order * mesh;
        let Some((likelihood, noise)) = harmonic(amplitude, position, part, scratch) else {
            continue;
        };
        let half = (part * position).max(1.0);
        let (first, last) = ((position - half).round() as usize, (position + half).round() as usize);
        let (mut energy, mut moment) = (0.0, 0.0);
        for (bin, a) in amplitude.iter().enumerate().take(last + 1).skip(first) {
            let above = (a * a - noise).max(0.0);
            energy += above;
            moment += above * bin as f64;
        }
        squares += energy / noise;
        if likelihood > MIN_HARMONIC_LIKELIHOOD && energy > 0.0 {
            weights += likelihood.min(MAX_HARMONIC_LIKELIHOOD);
            weighted += likelihood.min(MAX_HARMONIC_LIKELIHOOD) * moment / energy / order;
        }
    }
    MeshComb {
        mesh: if weights > 0.0 { weighted / weights } else { mesh },
        to_background: (squares / orders as f64).sqrt(),
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::super::spectrum::hann_amplitude;
    use super::super::transform::Transforms;
    use super::*;

    const LENGTH: usize = 20_000;

    fn noise(seed: u64) -> Vec<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        (0..LENGTH).map(|_| StandardNormal.sample(&mut random)).collect()
    }

    fn comb_in(mut samples: Vec<f64>) -> Option<MeshComb> {
        let (mut bins, mut amplitude) = (Vec::new(), Vec::new());
        Transforms::default().forward(&mut samples, &mut bins);
        hann_amplitude(&bins, LENGTH, &mut amplitude);
        find(&amplitude, [380.0, 420.0], &mut Vec::new())
    }

    #[test]
    fn white_noise_has_no_comb() {
        assert_eq!((0..1000).filter(|seed| comb_in(noise(*seed)).is_some()).count(), 0);
    }

    /// Harmonics 2 to 6 of a speed that swings by ± 0.3 % over the record, each a tenth of the noise's
    /// deviation.
    #[test]
    fn a_fluctuating_comb_is_found() {
        for seed in 0..20 {
            let mesh = 388.3 + seed as f64;
            let mut samples = noise(seed);
            for (i, x) in samples.iter_mut().enumerate() {
                let time = i as f64 / LENGTH as f64;
                let phase = mesh * (time - 0.003 * (TAU * time + seed as f64).cos() / TAU);
                *x += (2..=6)
                    .map(|h| 0.17 * (TAU * f64::from(h) * phase + f64::from(h * h)).sin())
                    .sum::<f64>();
            }
            let comb = comb_in(samples).unwrap_or_else(|| panic!("{mesh}: none"));
            assert!((comb.mesh / mesh - 1.0).abs() < 3e-3, "{mesh}: {comb:?}");
        }
    }

    #[test]
    fn a_single_line_is_not_a_comb() {
        let mut samples = noise(3);
        for (i, x) in samples.iter_mut().enumerate() {
            *x += (TAU * 401.3 * i as f64 / LENGTH as f64).sin();
        }
        assert_eq!(comb_in(samples), None);
    }

    #[test]
    fn nothing_is_found_without_a_comb() {
        assert_eq!(find(&[0.0; 2000], [76.0, 84.0], &mut Vec::new()), None);
        assert_eq!(find(&[1.0; 40], [76.0, 84.0], &mut Vec::new()), None);
        assert_eq!(find(&[], [76.0, 84.0], &mut Vec::new()), None);
    }
}
