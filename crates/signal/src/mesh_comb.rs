//! Search for the comb of mesh harmonics in a Hann amplitude spectrum. Positions are in bins.

use super::comb::{MESH_RESOLVED_BINS, MeshComb, SHAFT_RESOLVED_BINS};
use super::line::{fits, noise_amplitude, read_line};

/// Number of harmonics in the comb: the lowest ones stand out.
const ORDERS: usize = 5;

/// Above this ratio to the background, a line adds to the score only by its logarithm: a comb is more than
/// its strongest line.
const STRONG_LINE: f64 = 16.0;

/// Weight of the once-per-turn sidebands, which distinguish the mesh line from a strong sideband of it.
const SIDEBAND_WEIGHT: f64 = 0.5;

/// Probability that the best candidate in white noise is accepted as a comb.
const FALSE_ALARM: f64 = 1e-3;

/// Lowest background relative to the highest line there.
const NOISE_FLOOR: f64 = 1e-9;

/// Fewest bins of a harmonic's background.
const BACKGROUND_BINS: f64 = 64.0;

/// Searches the comb h·f, h = 1 … 5 (as far as it fits), with f from `low` to `high` bins.
///
/// A candidate's score is the sum of its lines' ratios A_h/b_h, with b_h the median-based noise around order
/// h. A ratio r above 16 counts as 16·(1 + ln(r/16)). The candidate must exceed the level that white noise
/// exceeds in one of a thousand records over all candidates together. Among the candidates that do, the one
/// with the highest sum of its score and half the score of the sidebands at h·f ± f/teeth is taken (if the
/// record resolves the shaft), and its frequency refined from its lines' positions.
pub(super) fn find(
    amplitude: &[f64],
    [low, high]: [f64; 2],
    teeth: u32,
    scratch: &mut Vec<f64>,
) -> Option<MeshComb> {
    let low = low.max(MESH_RESOLVED_BINS);
    let in_order = low <= high;
    if !in_order {
        return None;
    }
    let orders = (1..=ORDERS).take_while(|order| fits(*order as f64 * high, amplitude.len())).count();
    let mut noise = [0.0; ORDERS];
    for (order, noise) in (1..).zip(&mut noise[..orders]) {
        *noise = order_noise(amplitude, f64::from(order), [low, high], scratch);
    }
    let noise = &noise[..orders];
    if noise.is_empty() {
        return None;
    }
    let step = 0.5 / noise.len() as f64;
    let candidates = ((high - low) / step) as usize + 1;
    let level = detection_level(noise.len(), candidates);
    // Thousands of candidates are scored, and a division costs several multiplications.
    let mut per_noise = [0.0; ORDERS];
    per_noise.iter_mut().zip(noise).for_each(|(per_noise, noise)| *per_noise = noise.recip());
    let per_noise = &per_noise[..noise.len()];
    let score = |mesh: f64, offset: f64| -> f64 {
        let ratio = |(index, per_noise): (usize, &f64)| {
            let bin = ((index as f64 + 1.0 + offset) * mesh + 0.5) as usize;
            amplitude.get(bin).map_or(0.0, |a| a * per_noise)
        };
        per_noise.iter().enumerate().map(ratio).map(compress).sum()
    };
    let shaft = 1.0 / f64::from(teeth.max(1));
    let resolves_shaft = low * shaft >= SHAFT_RESOLVED_BINS;
    let mut best: Option<(f64, f64)> = None;
    for candidate in 0..candidates {
        let mesh = low + candidate as f64 * step;
        let comb = score(mesh, 0.0);
        if comb < level {
            continue;
        }
        let sidebands = if resolves_shaft { score(mesh, shaft) + score(mesh, -shaft) } else { 0.0 };
        let total = comb + SIDEBAND_WEIGHT * sidebands;
        if best.is_none_or(|(_, highest)| total > highest) {
            best = Some((mesh, total));
        }
    }
    best.map(|(mesh, _)| refine(amplitude, mesh, noise))
}

fn compress(ratio: f64) -> f64 {
    if ratio <= STRONG_LINE { ratio } else { STRONG_LINE * (1.0 + (ratio / STRONG_LINE).ln()) }
}

/// Returns the noise around one order: over the candidates' range, widened to 64 bins if that is less.
fn order_noise(amplitude: &[f64], order: f64, [low, high]: [f64; 2], scratch: &mut Vec<f64>) -> f64 {
    let half = (0.5 * order * (high - low)).max(0.5 * BACKGROUND_BINS);
    let middle = 0.5 * order * (high + low);
    let first = (middle - half).max(1.0) as usize;
    let last = ((middle + half) as usize).min(amplitude.len() - 1);
    scratch.clear();
    scratch.extend_from_slice(&amplitude[first..=last]);
    let highest = scratch.iter().copied().fold(0.0, f64::max);
    if highest == 0.0 {
        // There is no signal here: any background but zero shows this.
        return 1.0;
    }
    // A computed signal may have a line and exact zeros beside it.
    noise_amplitude(scratch).unwrap_or(0.0).max(NOISE_FLOOR * highest)
}

/// Returns the score that one of `candidates` combs of `orders` lines in white noise exceeds with a
/// probability of at most 10⁻³.
///
/// The ratios' squares are exponential with mean 1, so their sum E is Gamma distributed, and Σr ≤ √(orders·E)
/// bounds the score.
fn detection_level(orders: usize, candidates: usize) -> f64 {
    let ln_probability = (FALSE_ALARM / candidates as f64).ln();
    let ln_tail = |x: f64| {
        let mut term = 1.0;
        let mut sum = 1.0;
        for j in 1..orders {
            term *= x / j as f64;
            sum += term;
        }
        sum.ln() - x
    };
    let (mut low, mut high) = (0.0, 200.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if ln_tail(middle) > ln_probability {
            low = middle;
        } else {
            high = middle;
        }
    }
    (orders as f64 * high).sqrt()
}

/// Returns the candidate at the mean of its lines' positions, weighted by their squared ratio to the noise.
fn refine(amplitude: &[f64], mesh: f64, noise: &[f64]) -> MeshComb {
    let (mut weights, mut weighted, mut squares) = (0.0, 0.0, 0.0);
    for (index, noise) in noise.iter().enumerate() {
        let order = index as f64 + 1.0;
        let Some(line) = read_line(amplitude, order * mesh) else {
            continue;
        };
        let weight = (line.amplitude / noise).powi(2);
        weights += weight;
        weighted += weight * line.position / order;
        squares += weight;
    }
    MeshComb {
        mesh: if weights > 0.0 { weighted / weights } else { mesh },
        to_background: (squares / noise.len() as f64).sqrt(),
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::super::spectrum::hann_amplitude;
    use super::super::transform::Transforms;
    use super::*;

    fn noise(length: usize, seed: u64) -> Vec<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        (0..length).map(|_| StandardNormal.sample(&mut random)).collect()
    }

    fn add_line(x: &mut [f64], position: f64, amplitude: f64) {
        let length = x.len() as f64;
        for (i, x) in x.iter_mut().enumerate() {
            *x += amplitude * (2.0 * PI * position * i as f64 / length + position).sin();
        }
    }

    fn comb_in(mut samples: Vec<f64>, range: [f64; 2], teeth: u32) -> Option<MeshComb> {
        let (mut bins, mut amplitude) = (Vec::new(), Vec::new());
        let length = samples.len();
        Transforms::default().forward(&mut samples, &mut bins);
        hann_amplitude(&bins, length, &mut amplitude);
        find(&amplitude, range, teeth, &mut Vec::new())
    }

    /// The level promises at most 1 in 1000; 1200 seeded records of three lengths should give about one at
    /// most.
    #[test]
    fn white_noise_has_no_comb() {
        let mut found = 0;
        for (length, records) in [(2560, 500), (4000, 500), (20_000, 200)] {
            let mesh = 400.0 * length as f64 / 20_000.0;
            for seed in 0..records {
                found += usize::from(comb_in(noise(length, seed), [0.95 * mesh, 1.05 * mesh], 24).is_some());
            }
        }
        assert!(found <= 3, "{found} of 1200");
    }

    /// Lines at 5 times the noise's amplitude in a bin, the frequency put in, found to a tenth of a bin.
    #[test]
    fn a_comb_in_noise_is_found_within_a_tenth_of_a_bin() {
        let length = 20_000;
        let background = (4.0 * 1.5 / length as f64).sqrt();
        for seed in 0..50 {
            let mesh = 389.37 + 0.41 * seed as f64;
            let mut x = noise(length, seed);
            for order in 1..=5 {
                add_line(&mut x, f64::from(order) * mesh, 5.0 * background);
            }
            let comb = comb_in(x, [380.0, 420.0], 24).unwrap();
            assert!((comb.mesh - mesh).abs() < 0.1, "{mesh}: {comb:?}");
            assert!((3.5..7.0).contains(&comb.to_background), "{comb:?}");
        }
    }

    /// A first sideband three times as strong as the mesh line itself lies in the range too (± 5 % holds ± 1
    /// of 24 teeth).
    #[test]
    fn a_stronger_sideband_is_not_taken_for_the_mesh_line() {
        let length = 40_000;
        let mesh = 800.3;
        let mut x = noise(length, 5);
        for order in 1..=5 {
            add_line(&mut x, f64::from(order) * mesh, 0.3);
            add_line(&mut x, f64::from(order) * mesh + mesh / 24.0, 0.9);
            add_line(&mut x, f64::from(order) * mesh - mesh / 24.0, 0.2);
        }
        let comb = comb_in(x, [760.0, 840.0], 24).unwrap();
        assert!((comb.mesh - mesh).abs() < 0.1, "{comb:?}");
    }

    #[test]
    fn a_lone_strong_mesh_line_is_found() {
        let mut x = noise(20_000, 9);
        add_line(&mut x, 401.6, 1.0);
        assert!((comb_in(x, [380.0, 420.0], 24).unwrap().mesh - 401.6).abs() < 0.02);
    }

    #[test]
    fn nothing_is_found_without_a_comb() {
        assert_eq!(comb_in(vec![0.0; 4000], [76.0, 84.0], 24), None);
        assert_eq!(comb_in(noise(4000, 1), [2500.0, 2700.0], 24), None);
        assert_eq!(comb_in(noise(1, 1), [76.0, 84.0], 24), None);
        assert_eq!(comb_in(noise(4000, 1), [f64::NAN, 84.0], 24), None);
        assert_eq!(comb_in(noise(4000, 1), [84.0, 76.0], 24), None);
    }
}
