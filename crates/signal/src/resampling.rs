//! Resampling of a record at equal steps of its shaft angle.

use pulp::{Simd, WithSimd};

use super::angle_record::AngleRecord;
use super::interpolation::{Kernel, PASSBAND, REACH};
use super::not_computed::NotComputed;
use super::record::RecordOf;
use super::shaft_angle::ShaftAngle;
use super::sums::mean_of;
use super::transform::smooth_at_least;

/// Fewest whole turns that are averaged.
pub(super) const MIN_TURNS: usize = 4;

/// Largest growth of a record by resampling: a record whose speed varies more is rejected.
const MAX_GROWTH: f64 = 4.0;

/// Resamples records. Its buffers are reused from record to record, as newly mapped memory pages cost up to a
/// tenth of the work.
#[derive(Default)]
pub(super) struct Resampler {
    /// Interpolator, created when first needed.
    kernel: Option<Kernel>,
    /// The samples around one turn, the record's mean removed.
    centred: Vec<f32>,
    /// The angles of one turn's samples, in turns.
    steps: Vec<f64>,
    positions: Vec<f64>,
    /// Buffer of a record that is no longer needed.
    spare: Vec<f32>,
}

impl Resampler {
    /// Resamples the whole turns of a record over a known `angle`. At least 16 samples are needed before and
    /// after them.
    ///
    /// The number of samples per turn is at least that of the slowest turn, so nothing is aliased. A value
    /// between samples is Σ xᵢ·sinc(t − i)·w(t − i) / Σ sinc·w over the 32 samples around it, w the Blackman
    /// window: flat to 0.42 of the sampling rate. `orders` is the highest order to preserve.
    ///
    /// # Errors
    /// [`NotComputed::TooFewTurns`] below 4, [`NotComputed::AboveNyquist`] if `orders` lies above 0.42 of the
    /// sampling rate in the fastest turn, [`NotComputed::SpeedVaries`] if the speed varies so much that the
    /// record would grow more than fourfold.
    pub(super) fn resample(
        &mut self,
        record: &RecordOf<'_>,
        angle: &ShaftAngle,
        orders: f64,
    ) -> Result<AngleRecord, NotComputed> {
        let samples = record.samples();
        let rate_hz = record.sample_rate_hz();
        if samples.len() <= 2 * REACH {
            return Err(NotComputed::TooShort);
        }
        let min_samples_per_turn = rate_hz / angle.lowest_speed_hz();
        let reaches_orders = min_samples_per_turn > 2.0 * orders;
        if !reaches_orders {
            return Err(NotComputed::AboveNyquist);
        }
        let known = angle.revolutions();
        let max_samples = MAX_GROWTH * samples.len() as f64;
        if min_samples_per_turn >= samples.len() as f64 {
            return Err(NotComputed::TooFewTurns);
        }
        // An even number.
        let samples_per_turn =
            2 * smooth_at_least((min_samples_per_turn.ceil() as usize).div_ceil(2), &[2, 3, 5, 7]);
        // Pulses may extend far beyond the record: its ends determine which turns it contains.
        let position = |revolution: f64| angle.time_s(revolution, &mut 0) * rate_hz;
        let (begin, end) = (REACH as f64, (samples.len() - 1 - REACH) as f64);
        let (low, high) = (known[0].ceil(), known[1].floor());
        let first = first_satisfying(low, high, |revolution| position(revolution) >= begin);
        let past =
            first_satisfying(first, high + 1.0, |revolution| revolution > high || position(revolution) > end);
        let turns = past - 1.0 - first;
        let enough = turns >= MIN_TURNS as f64 && position(first) >= begin;
        if !enough {
            return Err(NotComputed::TooFewTurns);
        }
        if turns * samples_per_turn as f64 > max_samples {
            return Err(NotComputed::SpeedVaries);
        }
        let turns = turns as usize;
        let mut interval = 0;
        let mut start = |turn: usize| angle.time_s(first + turn as f64, &mut interval) * rate_hz;
        let (shortest_turn, _) = (1..=turns).fold((f64::INFINITY, start(0)), |(shortest, start_of), turn| {
            let end = start(turn);
            (shortest.min(end - start_of), end)
        });
        let highest_order = PASSBAND * shortest_turn;
        if highest_order < orders {
            return Err(NotComputed::AboveNyquist);
        }
        let Self { kernel, centred, steps, positions, spare } = self;
        let kernel = kernel.get_or_insert_with(Kernel::new);
        let mean = kernel.arch().dispatch(Mean(samples));
        steps.clear();
        steps.extend((0..samples_per_turn).map(|j| j as f64 / samples_per_turn as f64));
        positions.resize(samples_per_turn, 0.0);
        let mut resampled = std::mem::take(spare);
        resampled.resize(turns * samples_per_turn, 0.0);
        let mut interval = 0;
        for (turn, resampled) in resampled.chunks_exact_mut(samples_per_turn).enumerate() {
            let from = first + turn as f64;
            kernel.arch().dispatch(TurnPositions {
                angle,
                from,
                steps,
                rate_hz,
                interval: &mut interval,
                positions,
            });
            // A copy of this turn alone stays in the fastest cache.
            let [from, to] = [positions[0], positions[samples_per_turn - 1]].map(|end| end as usize);
            let before = from.saturating_sub(REACH);
            let samples = &samples[before..(to + REACH + 1).min(samples.len())];
            kernel.arch().dispatch(Centring { samples, mean, before: before as f64, centred, positions });
            kernel.interpolate(centred, positions, resampled);
        }
        Ok(AngleRecord {
            unit: record.unit().into(),
            samples_per_turn,
            turns,
            highest_order: highest_order as usize,
            samples: resampled,
            angle: angle.source(),
        })
    }

    /// Recycles the buffer of a record that is no longer needed.
    pub(super) fn recycle(&mut self, angle_record: AngleRecord) {
        self.spare = angle_record.samples;
    }

    /// Frees the buffers.
    pub(super) fn release(&mut self) {
        *self = Self { kernel: self.kernel.take(), ..Self::default() };
    }
}

/// The mean of a record, as a plain loop compiled for each instruction set.
struct Mean<'a>(&'a [f32]);

impl WithSimd for Mean<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        mean_of(self.0, |&x| f64::from(x))
    }
}

/// A copy of a part of a record with its mean removed, and positions counted from that part's start, in the
/// same way.
struct Centring<'a> {
    samples: &'a [f32],
    mean: f64,
    /// The number of samples before this part.
    before: f64,
    centred: &'a mut Vec<f32>,
    positions: &'a mut [f64],
}

impl WithSimd for Centring<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.centred.resize(self.samples.len(), 0.0);
        for (centred, &x) in self.centred.iter_mut().zip(self.samples) {
            *centred = (f64::from(x) - self.mean) as f32;
        }
        for position in self.positions {
            *position -= self.before;
        }
    }
}

/// The positions of one turn's samples in the record, compiled for each instruction set.
struct TurnPositions<'a> {
    angle: &'a ShaftAngle,
    from: f64,
    steps: &'a [f64],
    rate_hz: f64,
    interval: &'a mut usize,
    positions: &'a mut [f64],
}

impl WithSimd for TurnPositions<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.angle.sample_positions(self.from, self.steps, self.rate_hz, self.interval, self.positions);
    }
}

/// Returns the first whole number from `low` to `high` from which on `holds` stays true, or `high` if there
/// is none.
fn first_satisfying(low: f64, high: f64, holds: impl Fn(f64) -> bool) -> f64 {
    let (mut low, mut high) = (low, high.max(low));
    while low < high {
        let middle = (0.5 * (low + high)).floor();
        if holds(middle) {
            high = middle;
        } else {
            low = middle + 1.0;
        }
    }
    low
}
