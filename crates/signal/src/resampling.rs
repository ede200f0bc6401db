//! Resampling a record evenly over the angle of its shaft.

use pulp::{Simd, WithSimd};

use super::angle_record::AngleRecord;
use super::indicators::NotComputed;
use super::interpolation::{Kernel, REACH};
use super::record::Record;
use super::shaft_angle::ShaftAngle;
use super::sums::mean_of;

/// The fewest whole turns that are averaged.
pub(super) const MIN_TURNS: usize = 4;

/// A record whose speed varies so much that it would grow by more than this when resampled is refused.
const MAX_GROWTH: f64 = 4.0;

/// Resamples records. What it works in is kept from record to record: pages of memory that are new cost as
/// much as a tenth of the work.
#[derive(Default)]
pub(super) struct Resampler {
    /// Interpolation's weights, made when first needed.
    kernel: Option<Kernel>,
    centred: Vec<f64>,
    /// The angles of one turn's samples, in turns.
    steps: Vec<f64>,
    positions: Vec<f64>,
    /// Samples of a record that is not needed any more.
    spare: Vec<f64>,
}

impl Resampler {
    /// Resamples the whole turns of a record whose `angle` is known and that have 16 samples before and after
    /// them.
    ///
    /// As many samples a turn are taken as the record has in its slowest turn or more, so that nothing folds
    /// back. A sample between the record's own is Σ xᵢ·sinc(t − i)·w(t − i) / Σ sinc·w over the 32 samples
    /// around it, w the Blackman window: flat within 10⁻⁴ to 0.4 of the sampling rate. `orders` is the
    /// highest order that must be kept.
    ///
    /// # Errors
    /// [`NotComputed::TooFewTurns`] below 4, [`NotComputed::AboveNyquist`] where `orders` lies above half the
    /// sampling rate at the slowest speed, [`NotComputed::SpeedVaries`] where the speed varies so much that the
    /// record would grow fourfold.
    pub(super) fn resample(
        &mut self,
        record: &Record,
        angle: &ShaftAngle,
        orders: f64,
    ) -> Result<AngleRecord, NotComputed> {
        let samples = record.samples();
        let rate_hz = record.sample_rate_hz();
        if samples.len() <= 2 * REACH {
            return Err(NotComputed::TooShort);
        }
        let least = rate_hz / angle.lowest_speed_hz();
        let holds_orders = least > 2.0 * orders;
        if !holds_orders {
            return Err(NotComputed::AboveNyquist);
        }
        let known = angle.revolutions();
        let most = MAX_GROWTH * samples.len() as f64;
        if least >= samples.len() as f64 {
            return Err(NotComputed::TooFewTurns);
        }
        let samples_per_turn = smooth_at_least(least.ceil() as usize);
        // Pulses may have come for long before and after the record: its ends say which turns it holds.
        let position = |revolution: f64| angle.time_s(revolution, &mut 0) * rate_hz;
        let (begin, end) = (REACH as f64, (samples.len() - 1 - REACH) as f64);
        let (low, high) = (known[0].ceil(), known[1].floor());
        let first = first_such(low, high, |revolution| position(revolution) >= begin);
        let past =
            first_such(first, high + 1.0, |revolution| revolution > high || position(revolution) > end);
        let turns = past - 1.0 - first;
        let enough = turns >= MIN_TURNS as f64 && position(first) >= begin;
        if !enough {
            return Err(NotComputed::TooFewTurns);
        }
        if turns * samples_per_turn as f64 > most {
            return Err(NotComputed::SpeedVaries);
        }
        let turns = turns as usize;
        let Self { kernel, centred, steps, positions, spare } = self;
        let kernel = kernel.get_or_insert_with(Kernel::new);
        centred.resize(samples.len(), 0.0);
        kernel.arch().dispatch(Centring { samples, centred });
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
            kernel.interpolate(centred, positions, resampled);
        }
        Ok(AngleRecord {
            unit: record.unit().to_owned(),
            samples_per_turn,
            turns,
            samples: resampled,
            angle: angle.source(),
        })
    }

    /// Takes back the memory of a record that is not needed any more.
    pub(super) fn take_back(&mut self, turned: AngleRecord) {
        self.spare = turned.samples;
    }

    /// Drops work space.
    pub(super) fn give_back(&mut self) {
        *self = Self { kernel: self.kernel.take(), ..Self::default() };
    }
}

/// A record without its mean: plain loops that are compiled for each kind of processor.
struct Centring<'a> {
    samples: &'a [f32],
    centred: &'a mut [f64],
}

impl WithSimd for Centring<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let mean = mean_of(self.samples, |&x| f64::from(x));
        for (centred, &x) in self.centred.iter_mut().zip(self.samples) {
            *centred = f64::from(x) - mean;
        }
    }
}

/// The places of one turn's samples in the record, computed in the processor's widest registers.
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
        self.angle.samples_along(self.from, self.steps, self.rate_hz, self.interval, self.positions);
    }
}

/// The first whole number from `low` to `high` from which on `holds` (which stays true once it is); `high`
/// where it never does.
fn first_such(low: f64, high: f64, holds: impl Fn(f64) -> bool) -> f64 {
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

/// The smallest even number from `least` on without a prime factor above 7.
fn smooth_at_least(least: usize) -> usize {
    let mut number = least.next_multiple_of(2);
    loop {
        let mut rest = number;
        for prime in [2, 3, 5, 7] {
            while rest.is_multiple_of(prime) {
                rest /= prime;
            }
        }
        if rest == 1 {
            return number;
        }
        number += 2;
    }
}
