//! The lines of a spectrum that stand out from the noise. Positions are in bins.

use super::comb::HARMONICS;
use super::line::{DETECTION_RATIO, MEDIAN_OF_NOISE, fits, noise_amplitude};
use super::mesh_context::MeshContext;
use super::smeared_comb::{MIN_LIKELIHOOD, SmearedLines};
use super::sums::mean_of;

/// A line's ratio to the noise is limited to this, as one strong line is no comb.
const MAX_LINE_RATIO: f64 = 32.0;

/// The logarithm of a smeared line's likelihood ratio is limited to this. The limit is high, because
/// sidebands smear into each other between the lines of a comb.
const MAX_SMEARED_LIKELIHOOD: f64 = 1000.0;

/// A line counts for a harmonic within this fraction of its position plus this many bins.
pub(super) const REACH_FRACTION: f64 = 7e-4;
pub(super) const REACH_BINS: f64 = 1.0;

/// Bins per noise estimate: the median over these and as many around them.
const NOISE_BINS: usize = 128;

/// Lowest noise relative to the highest line: below it lie the skirts of lines in a record with hardly any
/// noise.
const NOISE_FLOOR: f64 = 1e-3;

/// The lines of a spectrum: for each bin the logarithm of the ratio of a line within reach to the noise, 0
/// without a line.
pub(super) struct SpectrumLines<'a> {
    log_ratios: &'a mut [f64],
    /// The mean over all bins.
    mean: f64,
}

impl<'a> SpectrumLines<'a> {
    /// Finds the narrow lines of a spectrum.
    pub(super) fn of(amplitude: &[f64], scratch: &mut Vec<f64>, log_ratios: &'a mut Vec<f64>) -> Self {
        let length = amplitude.len();
        log_ratios.clear();
        log_ratios.resize(length, 0.0);
        let min_noise = NOISE_FLOOR * highest(amplitude);
        for start in (0..length).step_by(NOISE_BINS) {
            let end = (start + NOISE_BINS).min(length);
            let around = &amplitude[start.saturating_sub(NOISE_BINS / 2)..(end + NOISE_BINS / 2).min(length)];
            if has_no_line(highest(&amplitude[start..end]), around, min_noise) {
                continue;
            }
            scratch.clear();
            scratch.extend_from_slice(around);
            let Some(noise) =
                noise_amplitude(scratch).map(|noise| noise.max(min_noise)).filter(|noise| *noise > 0.0)
            else {
                continue;
            };
            for bin in start.max(1)..end.min(length - 1) {
                let here = amplitude[bin];
                if here < DETECTION_RATIO * noise || here < amplitude[bin - 1] || here < amplitude[bin + 1] {
                    continue;
                }
                let value = (here / noise).min(MAX_LINE_RATIO).ln();
                let reach = (REACH_BINS + REACH_FRACTION * bin as f64) as usize;
                for log_ratio in &mut log_ratios[bin.saturating_sub(reach)..=(bin + reach).min(length - 1)] {
                    *log_ratio = log_ratio.max(value);
                }
            }
        }
        let mean = mean_of(log_ratios, |log_ratio| *log_ratio);
        Self { log_ratios, mean }
    }

    /// Adds lines that a fluctuating speed smears.
    pub(super) fn add(&mut self, smeared: &SmearedLines) {
        for (bin, log_ratio) in self.log_ratios.iter_mut().enumerate() {
            let likelihood = smeared.at(bin as f64);
            if likelihood >= MIN_LIKELIHOOD {
                *log_ratio = log_ratio.max(likelihood.min(MAX_SMEARED_LIKELIHOOD).ln());
            }
        }
        self.mean = mean_of(self.log_ratios, |log_ratio| *log_ratio);
    }

    /// Excludes the lines of the other configured meshes.
    pub(super) fn exclude_other_meshes(&mut self, mesh: f64, context: &MeshContext) {
        if context.others.is_empty() {
            return;
        }
        let shaft = mesh / f64::from(context.teeth.max(1));
        for (bin, log_ratio) in
            self.log_ratios.iter_mut().enumerate().filter(|(_, log_ratio)| **log_ratio > 0.0)
        {
            let reach = 2.0 * (REACH_BINS + REACH_FRACTION * bin as f64);
            if context.others.has_line_near(bin as f64 / shaft, reach / shaft) {
                *log_ratio = 0.0;
            }
        }
    }

    /// Returns the logarithm of the ratio to the noise of a line at this position, 0 without one.
    pub(super) fn at(&self, position: f64) -> f64 {
        self.log_ratios.get((position + 0.5) as usize).copied().unwrap_or(0.0)
    }

    /// Returns the number of bins.
    pub(super) fn bins(&self) -> usize {
        self.log_ratios.len()
    }

    /// Returns how many harmonics of a mesh have a line, and how many lie in the spectrum.
    pub(super) fn harmonics(&self, mesh: f64) -> [u32; 2] {
        let positions = (1..=HARMONICS).map(|order| order as f64 * mesh);
        let sought = positions.take_while(|position| fits(*position, self.bins()));
        sought.fold([0, 0], |[found, sought], position| {
            [found + u32::from(self.at(position) > 0.0), sought + 1]
        })
    }

    /// Returns what a position has on average: some have a line by chance.
    pub(super) fn mean(&self) -> f64 {
        self.mean
    }
}

fn highest(amplitude: &[f64]) -> f64 {
    let (blocks, rest) = amplitude.as_chunks::<8>();
    let max = |a: f64, b: f64| if b > a { b } else { a };
    let mut parts = [0.0; 8];
    for block in blocks {
        parts.iter_mut().zip(block).for_each(|(part, value)| *part = max(*part, *value));
    }
    parts.into_iter().chain(rest.iter().copied()).fold(0.0, max)
}

/// Returns whether even the highest bin is not above the noise estimated from the median of the bins
/// `around`. Most blocks have no line, and counting the bins below a level takes a tenth of the time of
/// finding their median.
fn has_no_line(highest: f64, around: &[f64], min_noise: f64) -> bool {
    if highest < DETECTION_RATIO * min_noise {
        return true;
    }
    // The median is above this level if at most half of the bins are at or below it.
    let level = highest / DETECTION_RATIO * MEDIAN_OF_NOISE * (1.0 + 1e-9);
    let below = around.iter().map(|a| u32::from(*a <= level)).sum::<u32>();
    below as usize <= around.len() / 2
}
