//! Measurement of one line of a Hann amplitude spectrum between its bins, and of the noise beside it.
//! Positions are in bins.

use std::f64::consts::PI;

/// A line's main lobe under the Hann window reaches two bins to either side.
pub(super) const MAIN_LOBE_BINS: f64 = 2.0;

/// A line is searched this many bins from its expected position ...
const SEARCH_BINS: f64 = 1.5;

/// ... plus this fraction of its position: no speed is known more accurately.
const SEARCH_FRACTION: f64 = 1e-4;

/// A line that stands out is searched this fraction of its position further away, as shaft speeds fluctuate
/// within a record.
const FLUCTUATION_FRACTION: f64 = 5e-4;

/// Amplitude ratio to the noise from which a line stands out: noise alone reaches 4 times its root mean
/// square in one bin of e¹⁶ = 9 million.
pub(super) const DETECTION_RATIO: f64 = 4.0;

/// Median of the amplitude of noise over its root mean square: √(ln 2).
pub(super) const MEDIAN_OF_NOISE: f64 = 0.832_554_611_157_697_7;

/// Bins on each side of a line used for its background.
const BACKGROUND_BINS: usize = 32;

/// Fewest bins of a background.
const MIN_BACKGROUND_BINS: usize = 8;

/// A measured line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LineReading {
    /// Position in bins.
    pub(super) position: f64,
    /// Amplitude.
    pub(super) amplitude: f64,
}

/// Returns whether a line's main lobe lies inside a spectrum of `bins` bins.
pub(super) fn fits(position: f64, bins: usize) -> bool {
    position >= MAIN_LOBE_BINS && position + MAIN_LOBE_BINS <= bins as f64 - 1.0
}

/// Reads the line expected at `position`: the highest peak within 1.5 bins (plus 10⁻⁴ of the position) of it,
/// interpolated, or the amplitude of the nearest bin if there is no peak, as on the flank of a stronger line.
/// `None` if the main lobe does not fit.
pub(super) fn read_line(amplitude: &[f64], position: f64) -> Option<LineReading> {
    if !fits(position, amplitude.len()) {
        return None;
    }
    Some(read_line_in(amplitude, 0, position))
}

/// Returns how far from `position` a line is searched.
pub(super) fn search_reach(position: f64) -> f64 {
    SEARCH_BINS + SEARCH_FRACTION * position
}

/// Reads a line in the part of a spectrum that begins at bin `first` and contains the bins within reach of
/// `position` and one more on each side.
pub(super) fn read_line_in(amplitude: &[f64], first: usize, position: f64) -> LineReading {
    let offset = position - first as f64;
    let mut line = highest_peak(amplitude, offset, search_reach(position))
        .unwrap_or(LineReading { position: offset, amplitude: amplitude[offset.round() as usize] });
    line.position += first as f64;
    line
}

/// Reads a mesh line like [`read_line`], or the highest peak within 5·10⁻⁴ of its position (at most `reach`
/// bins away) if that one exceeds 4 times `noise`, the root-mean-square amplitude of the noise in one bin.
/// The condition keeps weak lines from being read as the highest noise peak.
pub(super) fn read_mesh_line(
    amplitude: &[f64],
    position: f64,
    reach: f64,
    noise: Option<f64>,
) -> Option<LineReading> {
    let near = read_line(amplitude, position)?;
    let far = noise.and_then(|noise| {
        let reach = (SEARCH_BINS + FLUCTUATION_FRACTION * position).min(reach);
        highest_peak(amplitude, position, reach)
            .filter(|peak| peak.amplitude > near.amplitude && peak.amplitude >= DETECTION_RATIO * noise)
    });
    Some(far.unwrap_or(near))
}

fn highest_peak(amplitude: &[f64], position: f64, reach: f64) -> Option<LineReading> {
    let first = ((position - reach).ceil() as usize).max(1);
    let last = ((position + reach).floor() as usize).min(amplitude.len() - 2);
    (first..=last)
        .filter(|&k| amplitude[k] > amplitude[k - 1] && amplitude[k] >= amplitude[k + 1])
        .max_by(|&a, &b| amplitude[a].total_cmp(&amplitude[b]))
        .map(|k| interpolate(amplitude, k))
}

/// Interpolates the sine behind the peak at bin `k`. With α the ratio of the higher neighbour to the peak,
/// the Hann window's transform sin(πδ)/(πδ(1−δ²)) gives its distance δ = (2α−1)/(α+1) from the bin, and from
/// that its amplitude.
fn interpolate(amplitude: &[f64], k: usize) -> LineReading {
    let (before, peak, after) = (amplitude[k - 1], amplitude[k], amplitude[k + 1]);
    let side = if after >= before { 1.0 } else { -1.0 };
    let ratio = before.max(after) / peak;
    // Noise can reduce the ratio below the ½ of a line on its bin.
    let distance = ((2.0 * ratio - 1.0) / (ratio + 1.0)).clamp(0.0, 0.5);
    let scalloping = if distance < 1e-9 {
        1.0
    } else {
        (PI * distance).sin() / (PI * distance * (1.0 - distance * distance))
    };
    LineReading { position: k as f64 + side * distance, amplitude: peak / scalloping }
}

/// Returns the root-mean-square amplitude of the noise in one bin from the median of many. In Gaussian noise
/// the amplitude is Rayleigh distributed, with a median of √(ln 2) of its root mean square. A few lines among
/// the bins hardly change the median.
///
/// Reorders `values`; `None` if there are none.
pub(super) fn noise_amplitude(values: &mut [f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    let (_, median, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    Some(*median / MEDIAN_OF_NOISE)
}

/// Returns the root-mean-square amplitude of the noise in one bin near `position`, from up to 32 bins on each
/// side.
///
/// The main lobe of the line is excluded and, given the `spacing` of further lines in bins, theirs too. The
/// bins lie at most `reach` from the line. `None` if fewer than 8 bins remain.
pub(super) fn background(
    amplitude: &[f64],
    position: f64,
    spacing: Option<f64>,
    reach: f64,
    scratch: &mut Vec<f64>,
) -> Option<f64> {
    scratch.clear();
    let clear = MAIN_LOBE_BINS + 0.5 + SEARCH_FRACTION * position;
    let is_between_lines = |bin: usize| {
        let offset = (bin as f64 - position).abs();
        let nearest_line = spacing.map_or(0.0, |spacing| (offset / spacing).round() * spacing);
        offset > clear && (offset - nearest_line).abs() > clear
    };
    let highest = amplitude.len().saturating_sub(2);
    let above = ((position + clear) as usize)..=highest.min((position + reach) as usize);
    let below = (MAIN_LOBE_BINS as usize).max((position - reach).max(0.0) as usize)
        ..=highest.min((position - clear).max(0.0) as usize);
    scratch.extend(above.filter(|&k| is_between_lines(k)).take(BACKGROUND_BINS).map(|k| amplitude[k]));
    scratch.extend(below.rev().filter(|&k| is_between_lines(k)).take(BACKGROUND_BINS).map(|k| amplitude[k]));
    if scratch.len() < MIN_BACKGROUND_BINS {
        return None;
    }
    noise_amplitude(scratch)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::super::spectrum::hann_amplitude;
    use super::super::transform::Transforms;
    use super::*;

    fn spectrum(mut samples: Vec<f64>) -> Vec<f64> {
        let (mut bins, mut amplitude) = (Vec::new(), Vec::new());
        let length = samples.len();
        Transforms::default().forward(&mut samples, &mut bins);
        hann_amplitude(&bins, length, &mut amplitude);
        amplitude
    }

    fn sine(length: usize, position: f64, phase: f64) -> Vec<f64> {
        (0..length).map(|i| 2.5 * (2.0 * PI * position * i as f64 / length as f64 + phase).sin()).collect()
    }

    /// Closed form: the amplitude 2.5 put in. The project's aim is 0.1 % between bins.
    #[test]
    fn a_sine_between_bins_reads_within_a_tenth_of_a_percent() {
        for length in [512, 4999, 8192] {
            for step in 0..=20 {
                for phase in [0.0, 0.7, 1.9] {
                    let position = 60.0 + f64::from(step) / 20.0;
                    let reading = read_line(&spectrum(sine(length, position, phase)), 60.5).unwrap();
                    assert!(
                        (reading.amplitude / 2.5 - 1.0).abs() < 1e-3,
                        "{length} {position} {phase}: {reading:?}"
                    );
                    assert!(
                        (reading.position - position).abs() < 2e-3,
                        "{length} {position} {phase}: {reading:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn lines_that_do_not_fit_are_not_read() {
        let amplitude = vec![1.0; 33];
        assert_eq!(read_line(&amplitude, 1.5), None);
        assert_eq!(read_line(&amplitude, 30.5), None);
        assert_eq!(read_line(&amplitude, 1e12), None);
        assert_eq!(read_line(&amplitude, f64::NAN), None);
        assert_eq!(read_line(&[], 0.0), None);
        assert!(read_line(&amplitude, 30.0).is_some());
    }

    #[test]
    fn a_wandering_mesh_line_is_read_where_it_stands_out() {
        let mut x = sine(80_000, 20_000.0, 0.0);
        x.iter_mut().zip(sine(80_000, 20_006.2, 1.0)).for_each(|(x, y)| *x += 2.0 * y);
        let amplitude = spectrum(x);
        let read = |reach, noise| read_mesh_line(&amplitude, 20_000.0, reach, noise).unwrap();
        assert!((read(100.0, Some(1.2)).position - 20_006.2).abs() < 0.01);
        for (reach, noise) in [(100.0, Some(1.3)), (5.0, Some(1.2)), (100.0, None)] {
            assert!((read(reach, noise).position - 20_000.0).abs() < 0.01);
        }
    }

    #[test]
    fn the_flank_of_a_stronger_line_is_read_on_the_bin() {
        let amplitude: Vec<f64> = (0..40).map(|k| 100.0 - f64::from(k)).collect();
        assert_eq!(read_line(&amplitude, 20.2).unwrap().amplitude, 80.0);
    }

    /// White noise of unit variance: E|A|² of a one-sided Hann bin is 4·1.5/N (equivalent noise bandwidth 1.5
    /// bins).
    #[test]
    fn background_is_the_noise_between_lines() {
        let length = 20_000;
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut x = sine(length, 4000.3, 0.2);
        for (i, x) in x.iter_mut().enumerate() {
            let noise: f64 = StandardNormal.sample(&mut random);
            *x += noise + 2.0 * (2.0 * PI * (4016.3 * i as f64 / length as f64)).cos();
        }
        let amplitude = spectrum(x);
        let expected = (4.0 * 1.5 / length as f64).sqrt();
        let mut scratch = Vec::new();
        let mean: f64 = (0..40)
            .map(|i| {
                background(&amplitude, 4000.3 + 100.0 * f64::from(i), Some(16.0), 200.0, &mut scratch)
                    .unwrap()
            })
            .sum::<f64>()
            / 40.0;
        assert!((mean / expected - 1.0).abs() < 0.05, "{mean} {expected}");
        let beside = background(&amplitude, 4000.3, Some(16.0), 200.0, &mut scratch).unwrap();
        assert!((beside / expected - 1.0).abs() < 0.4, "{beside} {expected}");
    }

    #[test]
    fn too_few_bins_give_no_background() {
        assert_eq!(background(&[1.0; 100], 50.0, None, 5.0, &mut Vec::new()), None);
        assert_eq!(background(&[1.0; 12], 6.0, None, 50.0, &mut Vec::new()), None);
    }
}
