//! Search for a mesh comb whose lines are smeared by speed fluctuation within the record. Positions are in
//! bins.
//!
//! A line smeared over many bins exceeds the noise in none of them, but its energy over the width of the
//! smear does. Around each bin, the energy in windows with widths proportional to the frequency is compared
//! with the noise there.

use super::comb::{HARMONICS, MeshComb};
use super::line::{MEDIAN_OF_NOISE, fits, noise_amplitude};

/// Half-widths of the windows as fractions of the frequency: speed fluctuations within a record.
const HALF_WIDTHS: [f64; 4] = [0.0015, 0.003, 0.006, 0.012];

/// Spacing of candidates as a fraction of the frequency.
const STEP: f64 = 0.5 * HALF_WIDTHS[0];

/// The noise is the median over this fraction of the frequency, at least this many bins: smeared lines fill
/// less than half of that.
const NOISE_WIDTH: f64 = 0.06;
const MIN_NOISE_BINS: usize = 64;

/// Lowest noise relative to the highest line: a record with hardly any noise has the skirts of lines there.
const NOISE_FLOOR: f64 = 1e-3;

/// Bins of a Hann spectrum per statistically independent one.
const BINS_PER_DEGREE: f64 = 1.5;

/// A smeared line raises more than half of the bins in its window above this multiple of the noise's median
/// (mean square). A few lines of something else do not.
const MIN_TYPICAL_RATIO: f64 = 1.2;

/// Largest contribution of one harmonic to the logarithm of a comb's likelihood ratio: one line alone is not
/// a comb.
const MAX_LIKELIHOOD: f64 = 12.0;

/// Weight of the logarithm of what exceeds that.
const EXCESS_WEIGHT: f64 = 3.0;

/// From this logarithm of the likelihood ratio on, a line stands out.
pub(super) const MIN_LIKELIHOOD: f64 = 4.0;

/// Smallest sum for a comb: white noise exceeds it in fewer than one of a thousand records.
const MIN_SUM: f64 = 32.0;

/// This many harmonics must stand out.
const MIN_HARMONICS: usize = 2;

/// The evidence for smeared lines in a spectrum.
pub(super) struct SmearedLines {
    /// For each bin the logarithm of the likelihood ratio of a line smeared around it to noise, for the width
    /// that fits best.
    likelihoods: Vec<f64>,
    /// For each bin the mean square of the noise.
    noise: Vec<f64>,
}

impl SmearedLines {
    /// Examines a spectrum.
    pub(super) fn of(amplitude: &[f64], scratch: &mut Vec<f64>) -> Self {
        let noise = noise_of(amplitude, scratch);
        // Sums over all bins below each one, of energy and of the number of bins that are raised.
        let (mut energy, mut raised) = (vec![0.0], vec![0_u32]);
        let level = MIN_TYPICAL_RATIO * MEDIAN_OF_NOISE * MEDIAN_OF_NOISE;
        for (a, noise) in amplitude.iter().zip(&noise) {
            energy.push(energy[energy.len() - 1] + a * a);
            raised.push(raised[raised.len() - 1] + u32::from(a * a > level * noise));
        }
        let likelihood = |bin: usize, part: &f64| {
            let (first, last) = window(bin as f64, *part);
            if last >= amplitude.len() || noise[bin] <= 0.0 {
                return 0.0;
            }
            let count = last + 1 - first;
            let is_filled = 2 * (raised[last + 1] - raised[first]) as usize > count;
            let ratio = (energy[last + 1] - energy[first]) / (count as f64 * noise[bin]);
            // The squares of n bins of noise are exponential with mean b². For a mean of r·b² the logarithm
            // of the likelihood ratio is n(r − 1 − ln r).
            if is_filled && ratio > 1.0 {
                count as f64 / BINS_PER_DEGREE * (ratio - 1.0 - ratio.ln())
            } else {
                0.0
            }
        };
        let best = |bin| HALF_WIDTHS.iter().map(|part| likelihood(bin, part)).fold(0.0, f64::max);
        let likelihoods = (0..amplitude.len()).map(best).collect();
        Self { likelihoods, noise }
    }

    /// Returns the logarithm of the likelihood ratio of a line at this position to noise.
    pub(super) fn at(&self, position: f64) -> f64 {
        self.likelihoods.get((position + 0.5) as usize).copied().unwrap_or(0.0)
    }

    /// Returns whether the harmonics of a mesh are together more than white noise gives.
    fn has_comb(&self, mesh: f64, orders: usize) -> bool {
        let likelihoods = || (1..=orders).map(|order| self.at(order as f64 * mesh));
        likelihoods().filter(|likelihood| *likelihood > MIN_LIKELIHOOD).count() >= MIN_HARMONICS
            && likelihoods().map(|likelihood| likelihood.min(MAX_LIKELIHOOD)).sum::<f64>() > MIN_SUM
    }

    /// Returns the sum by which candidates are compared. Above 12, a harmonic's likelihood adds to it by its
    /// logarithm: it shows where the line is, but a resonance is a strong line too.
    fn rank(&self, mesh: f64, orders: usize) -> f64 {
        let compressed = |likelihood: f64| {
            let excess = (likelihood / MAX_LIKELIHOOD).max(1.0);
            likelihood.min(MAX_LIKELIHOOD) + EXCESS_WEIGHT * excess.ln()
        };
        (1..=orders).map(|order| compressed(self.at(order as f64 * mesh))).sum()
    }

    /// Returns the comb at the mean of its lines' centres of energy, weighted by their contributions.
    fn refined(&self, amplitude: &[f64], mesh: f64, orders: usize) -> MeshComb {
        let (mut weights, mut weighted, mut squares) = (0.0, 0.0, 0.0);
        for order in (1..=orders).map(|order| order as f64) {
            let position = order * mesh;
            let likelihood = self.at(position).min(MAX_LIKELIHOOD);
            let (first, last) = window(position, HALF_WIDTHS[1]);
            let (mut energy, mut moment) = (0.0, 0.0);
            let bins = amplitude.iter().zip(&self.noise).enumerate();
            for (bin, (a, noise)) in bins.take(last + 1).skip(first) {
                let above = (a * a - noise).max(0.0);
                energy += above;
                moment += above * bin as f64;
            }
            squares += energy / self.noise[(position as usize).min(self.noise.len() - 1)];
            if likelihood > MIN_LIKELIHOOD && energy > 0.0 {
                weights += likelihood;
                weighted += likelihood * moment / energy / order;
            }
        }
        MeshComb {
            mesh: if weights > 0.0 { weighted / weights } else { mesh },
            to_background: (squares / orders as f64).sqrt(),
        }
    }
}

/// Returns the first and last bin of the window around a position.
fn window(position: f64, part: f64) -> (usize, usize) {
    let half = (part * position).max(1.0);
    ((position - half).round().max(0.0) as usize, (position + half).round() as usize)
}

/// Returns the mean square of the noise at each bin.
fn noise_of(amplitude: &[f64], scratch: &mut Vec<f64>) -> Vec<f64> {
    let floor = NOISE_FLOOR * amplitude.iter().copied().fold(0.0, f64::max);
    let mut noise = Vec::with_capacity(amplitude.len());
    while noise.len() < amplitude.len() {
        let start = noise.len();
        let half = MIN_NOISE_BINS.max((NOISE_WIDTH * start as f64) as usize) / 2;
        let end = (start + half).min(amplitude.len());
        let around = start.saturating_sub(half / 2)..(end + half / 2).min(amplitude.len());
        scratch.clear();
        scratch.extend_from_slice(&amplitude[around]);
        let typical = noise_amplitude(scratch).unwrap_or(0.0).max(floor);
        noise.resize(end, typical * typical);
    }
    noise
}

/// Searches the comb h·f with f from `low` to `high` bins.
pub(super) fn find(amplitude: &[f64], [low, high]: [f64; 2], scratch: &mut Vec<f64>) -> Option<MeshComb> {
    let orders =
        (1..=HARMONICS).take_while(|order| fits(1.02 * *order as f64 * high, amplitude.len())).count();
    if orders < MIN_HARMONICS {
        return None;
    }
    let top = (1.05 * orders as f64 * high) as usize;
    let amplitude = &amplitude[..=top.min(amplitude.len() - 1)];
    let lines = SmearedLines::of(amplitude, scratch);
    let candidates = std::iter::successors(Some(low), |mesh| Some(mesh * (1.0 + STEP)));
    let best = candidates
        .take_while(|mesh| *mesh <= high)
        .filter(|mesh| lines.has_comb(*mesh, orders))
        .max_by(|a, b| lines.rank(*a, orders).total_cmp(&lines.rank(*b, orders)))?;
    Some(lines.refined(amplitude, best, orders))
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
