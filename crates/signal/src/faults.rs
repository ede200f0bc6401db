//! Faults of the samples themselves: clipping and gaps.

use pulp::{Arch, Simd, WithSimd};

use super::not_computed::NotComputed;

/// This many equal samples in a row are a gap.
const GAP_SAMPLES: usize = 64;

/// This many samples in a row at the highest or lowest value are clipped ...
const CLIPPED_SAMPLES: usize = 3;

/// ... if the neighbouring samples differ from it by at least this fraction of the range on average, and by
/// this many of the converter's steps: the slow crest of a low-frequency tone is flat without clipping. A
/// parabola that stays within one step for n samples falls by up to ((n + 1)/(n − 1))² steps at the next one.
const MIN_STEP_FRACTION: f64 = 0.01;
const MIN_CONVERTER_STEPS: f64 = 4.0;

/// This many samples at the highest or lowest value are clipped even if they are not consecutive ...
const MIN_LIMIT_SAMPLES: usize = 8;

/// ... if they outnumber the samples next to the limit by this factor. Those are within `NEAR_FRACTION` of
/// the range, or at the next value. The amplitude density of a vibration falls towards its limits. For a pure
/// tone it rises, but has at most 2.4 times as many samples at the limit as one converter step before.
const MIN_LIMIT_RATIO: usize = 3;
const NEAR_FRACTION: f32 = 0.01;

/// This many neighbours are compared at once, as equal ones are rare.
const STRIDE: usize = 64;

/// Samples at the limits are counted in blocks that stay in the fastest cache.
const BLOCK: usize = 4096;

/// Returns the fault that makes shape indicators meaningless: a gap filled with one value, or clipping.
/// `range` is the lowest and the highest sample.
pub(super) fn fault(samples: &[f32], range: [f32; 2]) -> Option<NotComputed> {
    Arch::new().dispatch(FaultScan { samples, range })
}

/// The scan as plain loops, compiled for each instruction set.
struct FaultScan<'a> {
    samples: &'a [f32],
    range: [f32; 2],
}

impl WithSimd for FaultScan<'_> {
    type Output = Option<NotComputed>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Option<NotComputed> {
        fault_within(self.samples, self.range)
    }
}

#[inline(always)]
fn fault_within(samples: &[f32], [low, high]: [f32; 2]) -> Option<NotComputed> {
    if low >= high {
        let is_single = samples.len() < 2;
        return Some(if is_single { NotComputed::TooShort } else { NotComputed::Constant });
    }
    let mut clipped = [(0_usize, 0.0); 2];
    let mut first = 0;
    while first < samples.len() {
        if let Some(stride) = samples.get(first..=first + STRIDE)
            && !stride.iter().zip(&stride[1..]).fold(false, |equal, (a, b)| equal | (a == b))
        {
            first += STRIDE;
            continue;
        }
        let value = samples[first];
        let run = samples[first..].iter().take_while(|&&x| x == value).count();
        let past = first + run;
        if run >= GAP_SAMPLES {
            return Some(NotComputed::Gaps);
        }
        for (side, limit) in [low, high].into_iter().enumerate() {
            if value == limit && run >= CLIPPED_SAMPLES {
                let beside = [first.checked_sub(1), Some(past).filter(|&past| past < samples.len())];
                for index in beside.into_iter().flatten() {
                    clipped[side].0 += 1;
                    clipped[side].1 += (f64::from(samples[index]) - f64::from(limit)).abs();
                }
            }
        }
        first = past;
    }
    let range = f64::from(high) - f64::from(low);
    let falls = |min: f64| clipped.into_iter().any(|(count, fall)| count > 0 && fall / count as f64 >= min);
    let is_steep = falls(MIN_STEP_FRACTION * range) && falls(MIN_CONVERTER_STEPS * smallest_step(samples));
    (is_steep || accumulates_at_limit(samples, [low, high])).then_some(NotComputed::Clipped)
}

/// Returns the smallest difference between neighbouring samples that are not equal: the converter's step, or
/// almost zero for samples without one.
#[inline(always)]
fn smallest_step(samples: &[f32]) -> f64 {
    let steps = samples.iter().zip(&samples[1..]).map(|(a, b)| (b - a).abs()).filter(|step| *step > 0.0);
    steps.fold(f32::INFINITY, f32::min).into()
}

/// Returns whether samples accumulate at a limit: many more at it than next to it.
#[inline(always)]
fn accumulates_at_limit(samples: &[f32], limits: [f32; 2]) -> bool {
    let [low, high] = limits;
    // Both in one pass: there are rarely enough to look further.
    let (mut at_low, mut at_high) = (0_usize, 0_usize);
    for block in samples.chunks(BLOCK) {
        let count = |limit: f32| block.iter().map(|&x| u32::from(x == limit)).sum::<u32>() as usize;
        at_low += count(low);
        at_high += count(high);
    }
    let is_many = |at_limit: usize, limit: f32| {
        at_limit >= MIN_LIMIT_SAMPLES && outnumbers_neighbours(samples, limit, at_limit, high - low)
    };
    is_many(at_low, low) || is_many(at_high, high)
}

/// Returns whether the samples at a limit outnumber those next to it by far.
#[inline(always)]
fn outnumbers_neighbours(samples: &[f32], limit: f32, at_limit: usize, range: f32) -> bool {
    let distance = |x: f32| (x - limit).abs();
    let nearest = samples.iter().filter(|&&x| x != limit).map(|&x| distance(x)).fold(f32::INFINITY, f32::min);
    let reach = nearest.max(NEAR_FRACTION * range);
    let next = samples.iter().filter(|&&x| x != limit && distance(x) <= reach).count();
    at_limit >= MIN_LIMIT_RATIO * next
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    fn fault(samples: &[f32]) -> Option<NotComputed> {
        let low = samples.iter().copied().fold(f32::INFINITY, f32::min);
        let high = samples.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        super::fault(samples, [low, high])
    }

    fn sine(period: f64, limit: f32) -> Vec<f32> {
        let levels = 32_767.0;
        (0..5000)
            .map(|i| ((TAU * f64::from(i) / period).sin() * levels).round() as f32 / levels as f32)
            .map(|x| x.clamp(-1.0, limit))
            .collect()
    }

    #[test]
    fn clipped_and_missing_samples_are_detected() {
        assert_eq!(fault(&sine(50.3, 0.9)), Some(NotComputed::Clipped));
        let mut gap = sine(50.3, 1.0);
        gap[1000..1064].fill(0.25);
        assert_eq!(fault(&gap), Some(NotComputed::Gaps));
        assert_eq!(fault(&[2.5; 10]), Some(NotComputed::Constant));
        assert_eq!(fault(&[2.5]), Some(NotComputed::TooShort));
    }

    /// Impacts and noise that pass the limit for one or two samples each.
    #[test]
    fn single_samples_accumulating_at_a_limit_are_detected() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let normal: Vec<f32> = (0..20_000).map(|_| StandardNormal.sample(&mut random)).collect();
        for limit in [1.5, 2.0, 2.5] {
            let clipped: Vec<f32> = normal.iter().map(|x| x.clamp(-limit, limit)).collect();
            assert_eq!(fault(&clipped), Some(NotComputed::Clipped), "{limit}");
        }
        // Whole, at every coarseness of the converter down to 5 bits.
        for steps in [4.0, 16.0, 256.0, 8192.0] {
            let rounded: Vec<f32> = normal.iter().map(|x| (x * steps).round() / steps).collect();
            assert_eq!(fault(&rounded), None, "{steps} steps a standard deviation");
        }
    }

    /// The crest of a coarsely quantised tone is flat and ends by a step above 1 % of the range.
    #[test]
    fn a_coarse_tone_is_clipped_only_where_it_is_cut() {
        for amplitude in [10.0, 20.0, 40.0, 100.0] {
            for period in [40.3, 45.7, 100.7, 400.0] {
                for offset in [0.0, 0.2, 0.49] {
                    let tone: Vec<f32> = (0..20_000)
                        .map(|i| (TAU * f64::from(i) / period).sin() * (amplitude + offset))
                        .map(|x| x.round() as f32)
                        .collect();
                    assert_eq!(fault(&tone), None, "{amplitude} {period} {offset}");
                    let limit = (0.8 * amplitude).round() as f32;
                    let cut: Vec<f32> = tone.iter().map(|x| x.min(limit)).collect();
                    assert!(fault(&cut).is_some(), "{amplitude} {period} {offset}");
                }
            }
        }
    }

    /// 16 bits give a tone of 1000 samples a period some equal samples at its crest.
    #[test]
    fn whole_crests_are_not_clipped() {
        for period in [2.1, 3.0, 4.0, 7.3, 50.3, 400.0, 1000.0, 2500.0] {
            assert_eq!(fault(&sine(period, 1.0)), None, "{period}");
        }
        assert_eq!(fault(&[1.0, 2.0]), None);
    }
}
