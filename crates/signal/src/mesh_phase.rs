//! Tracking of a mesh harmonic's phase through a record, which gives the shaft angle.

use std::cmp::Ordering;
use std::f64::consts::TAU;

use flankwatch_fourier::{Complex, FftDirection};
use pulp::{Arch, Simd, WithSimd};
use smallvec::SmallVec;

use super::comb;
use super::phases::{add_phase_steps, phases_of};
use super::shaft_angle::{AngleSource, ShaftAngle};
use super::sums::mean_of;
use super::transform::Transforms;

/// Number of harmonics tried; the one that promises the most accurate angle is used.
const HARMONICS: u32 = 5;

/// Half-width of the band around a line of known frequency, in shaft rates: just short of the first
/// sidebands.
const KNOWN_REACH_SHAFTS: f64 = 0.9;

/// Largest half-width of the band around a harmonic, in mesh frequencies: it must not include the
/// neighbouring harmonics.
const MAX_REACH_MESHES: f64 = 0.45;

/// Margin of the band beyond the tolerance of the speed.
const TOLERANCE_MARGIN: f64 = 0.02;

/// Half-width of the tracked line's own band in shaft rates: half-way to the first sidebands.
const LINE_REACH_SHAFTS: f64 = 0.45;

/// Number of iterations; each tracks the phase left by the one before.
const ITERATIONS: usize = 3;

/// The line counts as lost if its amplitude falls below this fraction of its root mean square.
const MIN_LINE_FRACTION: f64 = 0.25;

/// Smallest amplitude ratio of the line to the background.
const MIN_RATIO: f64 = 4.0;

/// From this ratio on, noise causes no phase slips, and the harmonic with the smallest angle error is the
/// best one; below it, the harmonic with the highest ratio.
const SAFE_RATIO: f64 = 8.0;

/// Turns discarded at each end, where the band filter has not settled.
const UNSETTLED_TURNS: f64 = 1.0;

/// The unwindowed transform of a record, and its mesh.
#[derive(Clone, Copy)]
pub(super) struct MeshBand<'a> {
    /// Bins 0 to ⌊N/2⌋.
    pub(super) bins: &'a [Complex<f64>],
    /// Number N of samples.
    pub(super) length: usize,
    /// Sampling rate in hertz.
    pub(super) sample_rate_hz: f64,
    /// Teeth of the shaft.
    pub(super) teeth: u32,
    /// Expected mesh frequency in hertz.
    pub(super) mesh_hz: f64,
}

impl MeshBand<'_> {
    /// Returns the duration of the record in seconds.
    pub(super) fn duration_s(&self) -> f64 {
        self.length as f64 / self.sample_rate_hz
    }

    /// Determines the shaft angle from the phase of a harmonic within ± 0.9 shaft rates of `mesh_hz`, for a
    /// speed that varies less than that.
    pub(super) fn track_known(&self, transforms: &mut Transforms) -> Option<ShaftAngle> {
        let reach_hz = KNOWN_REACH_SHAFTS * self.mesh_hz / f64::from(self.teeth);
        self.track(|_| Some(reach_hz), transforms)
    }

    /// Determines the shaft angle if the speed may vary anywhere within this relative tolerance of the
    /// expected one.
    pub(super) fn track_wide(&self, tolerance: f64, transforms: &mut Transforms) -> Option<ShaftAngle> {
        let part = tolerance + TOLERANCE_MARGIN;
        let reach =
            |harmonic: f64| (harmonic * part <= MAX_REACH_MESHES).then_some(harmonic * part * self.mesh_hz);
        self.track(reach, transforms)
    }

    /// Determines the shaft angle if it is known roughly. Higher harmonics can be used, as their lines are
    /// narrow once the rough angle is removed. `ahead_periods` returns how many periods the mesh is ahead of
    /// `mesh_hz` at a fraction of the record; its speed lies within the fraction `part` of `mesh_hz`.
    pub(super) fn track_with_estimate(
        &self,
        ahead_periods: &dyn Fn(f64) -> f64,
        part: f64,
        transforms: &mut Transforms,
    ) -> Option<ShaftAngle> {
        let shaft_hz = self.mesh_hz / f64::from(self.teeth);
        let begun = (1..=comb::HARMONICS as u32).filter_map(|harmonic| {
            let reach_hz = KNOWN_REACH_SHAFTS * shaft_hz + part * f64::from(harmonic) * self.mesh_hz;
            self.begin(harmonic, reach_hz, Some(ahead_periods), transforms)
        });
        self.best(begun.collect(), transforms)
    }

    fn track(
        &self,
        reach_hz: impl Fn(f64) -> Option<f64>,
        transforms: &mut Transforms,
    ) -> Option<ShaftAngle> {
        let begun = (1..=HARMONICS)
            .filter_map(|harmonic| self.begin(harmonic, reach_hz(f64::from(harmonic))?, None, transforms));
        self.best(begun.collect(), transforms)
    }

    /// Begins to track one harmonic in the band of ± `reach_hz` around its expected frequency.
    ///
    /// The band's analytic signal at a low sampling rate gives a frequency over one turn at a time, weighted
    /// by power, and from that a first phase. If `ahead_periods` is known, it gives the first phase instead.
    fn begin(
        &self,
        harmonic: u32,
        reach_hz: f64,
        ahead_periods: Option<&dyn Fn(f64) -> f64>,
        transforms: &mut Transforms,
    ) -> Option<TrackedHarmonic> {
        let duration_s = self.duration_s();
        let orders = f64::from(harmonic) * f64::from(self.teeth);
        let shaft_bins = self.mesh_hz / f64::from(self.teeth) * duration_s;
        let centre_hz = f64::from(harmonic) * self.mesh_hz;
        let first = ((centre_hz - reach_hz) * duration_s).ceil();
        let last = ((centre_hz + reach_hz) * duration_s).floor();
        let usable = first >= 1.0
            && last < 0.5 * self.length as f64
            && last - first >= 2.0
            && shaft_bins > 2.0 * UNSETTLED_TURNS;
        if !usable {
            return None;
        }
        let (first, last) = (first as usize, last as usize);
        let samples = analytic_length(first, last);
        let turn = (samples as f64 / shaft_bins).round().max(1.0) as usize;
        let margin = (UNSETTLED_TURNS * turn as f64) as usize;
        if samples < 2 * margin + 2 {
            return None;
        }
        let signal = self.analytic(first, last, transforms);
        let (mut phase, mut derotated) = (transforms.buffer(), transforms.complex_buffer());
        match ahead_periods {
            None => derotate_by_frequency(&signal, turn, &mut phase, &mut derotated, transforms),
            Some(ahead_periods) => {
                let constant = TAU * (centre_hz * duration_s - (first - 1) as f64) / samples as f64;
                let ahead = |j: usize| TAU * f64::from(harmonic) * ahead_periods(j as f64 / samples as f64);
                phase.extend((0..samples).map(|j| constant * j as f64 + ahead(j)));
                derotated
                    .extend(signal.iter().zip(&phase).map(|(z, phase)| z * Complex::from_polar(1.0, -phase)));
            }
        }
        let mut begun = TrackedHarmonic {
            harmonic,
            ratio: 0.0,
            orders,
            first,
            bins: last - first + 1,
            reach_bins: (LINE_REACH_SHAFTS * shaft_bins).ceil() as usize,
            margin,
            phase,
            derotated,
            line: transforms.complex_buffer(),
            is_finished: false,
        };
        transforms.recycle_complex(signal);
        begun.low_pass(transforms);
        Some(begun)
    }

    /// Returns the angle from the harmonic with the best tracking quality. The first low-pass shows it almost
    /// as well as the last one, so a harmonic is tracked to the end only when it is the best one.
    fn best(&self, mut begun: TrackedHarmonics, transforms: &mut Transforms) -> Option<ShaftAngle> {
        let mut angle = None;
        while angle.is_none()
            && let Some((index, _)) = begun.iter().enumerate().max_by(|(_, a), (_, b)| a.cmp(b))
        {
            if !begun[index].is_finished && begun[index].finish(transforms) {
                continue;
            }
            let best = begun.remove(index);
            if best.is_finished {
                angle = self.angle(&best, transforms);
            }
            best.recycle(transforms);
        }
        for other in begun {
            other.recycle(transforms);
        }
        angle
    }

    fn angle(&self, tracked: &TrackedHarmonic, transforms: &mut Transforms) -> Option<ShaftAngle> {
        let TrackedHarmonic { harmonic, ratio, orders, first, margin, phase, .. } = tracked;
        let duration_s = self.duration_s();
        let samples = phase.len();
        let settled = *margin..samples - margin;
        // The band was shifted down to bin 1.
        let shift = |j: usize| TAU * (first - 1) as f64 * j as f64 / samples as f64;
        let start = phase[*margin] + shift(*margin);
        let [mut revolutions, mut times_s, buffer] = [(); 3].map(|()| transforms.buffer());
        revolutions.extend(settled.clone().map(|j| (phase[j] + shift(j) - start) / (TAU * orders)));
        times_s.extend(settled.map(|j| j as f64 * duration_s / samples as f64));
        let source = AngleSource::MeshPhase {
            harmonic: *harmonic,
            line_to_background: *ratio,
            angle_error_deg: tracked.angle_error_deg(),
        };
        ShaftAngle::through(revolutions, times_s, buffer, source).ok()
    }

    /// Returns the analytic signal of the bins `first` to `last`, shifted down to start at bin 1, with at
    /// least four samples per bin.
    pub(super) fn analytic(
        &self,
        first: usize,
        last: usize,
        transforms: &mut Transforms,
    ) -> Vec<Complex<f64>> {
        self.analytic_at(analytic_length(first, last), first, last, transforms)
    }

    /// Like [`analytic`](Self::analytic), with at least two samples per bin.
    pub(super) fn analytic_sparse(
        &self,
        first: usize,
        last: usize,
        transforms: &mut Transforms,
    ) -> Vec<Complex<f64>> {
        self.analytic_at((2 * (last - first + 2)).next_power_of_two(), first, last, transforms)
    }

    fn analytic_at(
        &self,
        samples: usize,
        first: usize,
        last: usize,
        transforms: &mut Transforms,
    ) -> Vec<Complex<f64>> {
        // The real part is the band itself, in which each bin occurs twice.
        let scale = 2.0 / self.length as f64;
        let mut signal = transforms.complex_buffer();
        signal.resize(samples, Complex::default());
        for (target, bin) in signal[1..].iter_mut().zip(&self.bins[first..=last]) {
            *target = bin * scale;
        }
        transforms.complex(&mut signal, FftDirection::Inverse);
        signal
    }
}

/// Number of samples of the analytic signal of the bins `first` to `last`.
fn analytic_length(first: usize, last: usize) -> usize {
    (4 * (last - first + 1)).next_power_of_two()
}

/// The harmonics that are tracked.
type TrackedHarmonics = SmallVec<[TrackedHarmonic; comb::HARMONICS]>;

/// A harmonic that is tracked, and its phase.
struct TrackedHarmonic {
    harmonic: u32,
    /// Amplitude ratio of the line to the background.
    ratio: f64,
    /// Periods of the harmonic per turn of the shaft.
    orders: f64,
    /// First bin of the band, and number of its bins.
    first: usize,
    bins: usize,
    /// Largest distance of the line's bins from zero.
    reach_bins: usize,
    /// Samples discarded at each end.
    margin: usize,
    /// Phase per sample of the band's signal.
    phase: Vec<f64>,
    /// The band's signal relative to its phase so far.
    derotated: Vec<Complex<f64>>,
    /// The line in it.
    line: Vec<Complex<f64>>,
    /// Whether the phase is complete and the line is clear.
    is_finished: bool,
}

impl TrackedHarmonic {
    /// Completes the phase. Returns whether the line stands out and is not lost anywhere.
    ///
    /// The phase of the signal relative to the first one, below 0.45 shaft rates, is added, three times: each
    /// iteration brings the line closer to zero frequency, where sidebands no longer pass.
    fn finish(&mut self, transforms: &mut Transforms) -> bool {
        let mut increments = transforms.buffer();
        increments.resize(self.line.len() - 1, 0.0);
        let mut left = 0.0;
        for step in 0..ITERATIONS {
            if step > 0 {
                derotate_by_phase(&mut self.derotated, &mut self.line);
                self.low_pass(transforms);
            }
            left += self.line[0].arg();
            add_phase_steps(&self.line, &mut increments);
        }
        // Once for all iterations, as each addition waits for the one before.
        self.phase[0] += left;
        for (phase, step) in self.phase[1..].iter_mut().zip(&increments) {
            left += step;
            *phase += left;
        }
        transforms.recycle(increments);
        let line = &self.line[self.margin..self.line.len() - self.margin];
        let lowest = line.iter().map(Complex::norm_sqr).fold(f64::INFINITY, f64::min).sqrt();
        let is_lost = lowest < MIN_LINE_FRACTION * mean_of(line, Complex::norm_sqr).sqrt();
        self.is_finished = self.ratio >= MIN_RATIO && !is_lost;
        self.is_finished
    }

    /// Low-passes the derotated signal and compares the line with the rest of the band.
    fn low_pass(&mut self, transforms: &mut Transforms) {
        low_pass(&self.derotated, self.reach_bins, &mut self.line, transforms);
        let settled = self.margin..self.line.len() - self.margin;
        let line = &self.line[settled.clone()];
        let line_power = mean_of(line, Complex::norm_sqr);
        let rest = power_beside(&self.derotated[settled], line);
        let line_bins = (2 * self.reach_bins + 1) as f64;
        let other_bins = (self.bins as f64 - line_bins).max(1.0);
        // A computed signal may be exactly zero outside its line.
        let background = (rest * line_bins / other_bins).max(1e-18 * line_power);
        self.ratio = (line_power / background).sqrt();
    }

    fn recycle(self, transforms: &mut Transforms) {
        transforms.recycle(self.phase);
        transforms.recycle_complex(self.derotated);
        transforms.recycle_complex(self.line);
    }

    fn angle_error_deg(&self) -> f64 {
        360.0 / (TAU * self.orders * self.ratio * 2.0_f64.sqrt())
    }

    /// Compares by tracking quality.
    fn cmp(&self, other: &Self) -> Ordering {
        let quality = |tracked: &Self| {
            if tracked.ratio >= SAFE_RATIO {
                (true, -tracked.angle_error_deg())
            } else {
                (false, tracked.ratio)
            }
        };
        let ((is_safe, this), (other_is_safe, other)) = (quality(self), quality(other));
        is_safe.cmp(&other_is_safe).then(this.total_cmp(&other))
    }
}

/// Mean square of what a signal has beside its line. Little weight is on the ends, where the band filter has
/// settled least.
fn power_beside(signal: &[Complex<f64>], line: &[Complex<f64>]) -> f64 {
    let (mut sum, mut weights) = (0.0, 0.0);
    for (j, (z, line)) in signal.iter().zip(line).enumerate() {
        let place = (j as f64 + 0.5) / signal.len() as f64;
        let weight = (place * (1.0 - place)).powi(2);
        sum += weight * (z - line).norm_sqr();
        weights += weight;
    }
    sum / weights
}

/// Computes the phase from the frequency over `turn` samples around each sample, weighted by power, and the
/// signal derotated by it.
fn derotate_by_frequency(
    signal: &[Complex<f64>],
    turn: usize,
    phase: &mut Vec<f64>,
    derotated: &mut Vec<Complex<f64>>,
    transforms: &mut Transforms,
) {
    let (mut sums, mut steps) = (transforms.complex_buffer(), transforms.complex_buffer());
    let mut sum = Complex::default();
    sums.push(sum);
    sums.extend(signal.windows(2).map(|pair| {
        sum += pair[1] * pair[0].conj();
        sum
    }));
    let half = turn.div_ceil(2);
    let around = |j: usize| sums[(j + 1 + half).min(sums.len() - 1)] - sums[j.saturating_sub(half)];
    steps.extend((0..signal.len() - 1).map(around));
    phases_of(&steps, phase);
    // The rotation is accumulated step by step, without a sine.
    Arch::new().dispatch(UnitPhasors(&mut steps));
    let (mut total, mut rotation) = (0.0, Complex::new(1.0, 0.0));
    derotated.push(signal[0]);
    derotated.extend(signal[1..].iter().zip(&steps).zip(phase.iter_mut()).map(|((z, step), phase)| {
        total += *phase;
        *phase = total;
        rotation *= step.conj();
        z * rotation
    }));
    phase.insert(0, 0.0);
    transforms.recycle_complex(sums);
    transforms.recycle_complex(steps);
}

/// Derotates each sample by the phase of `line`, the latest addition to the tracked phase; leaves phasors of
/// modulus 1 in `line`.
fn derotate_by_phase(signal: &mut [Complex<f64>], line: &mut [Complex<f64>]) {
    Arch::new().dispatch(Derotation { signal, line });
}

/// That, as plain loops compiled for each instruction set.
struct Derotation<'a> {
    signal: &'a mut [Complex<f64>],
    line: &'a mut [Complex<f64>],
}

impl WithSimd for Derotation<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        UnitPhasors(self.line).with_simd(simd);
        for (z, line) in self.signal.iter_mut().zip(self.line) {
            *z *= line.conj();
        }
    }
}

/// Divides each value by its modulus, as a plain loop compiled for each instruction set. Zero, which has no
/// phase, becomes 1.
struct UnitPhasors<'a>(&'a mut [Complex<f64>]);

impl WithSimd for UnitPhasors<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for z in self.0 {
            let square = z.norm_sqr();
            let is_zero = f64::from(u8::from(square == 0.0));
            let scale = (square + is_zero).sqrt().recip();
            *z = Complex::new(z.re * scale + is_zero, z.im * scale);
        }
    }
}

/// Low-passes a signal: keeps the bins within `reach` of zero.
fn low_pass(
    signal: &[Complex<f64>],
    reach: usize,
    line: &mut Vec<Complex<f64>>,
    transforms: &mut Transforms,
) {
    line.clear();
    line.extend_from_slice(signal);
    transforms.complex(line, FftDirection::Forward);
    let scale = 1.0 / signal.len() as f64;
    // The bins from zero up, the rest, and those from zero down.
    let above = (reach + 1).min(line.len());
    let below = line.len().saturating_sub(reach).max(above);
    line[..above].iter_mut().for_each(|bin| *bin *= scale);
    line[above..below].fill(Complex::default());
    line[below..].iter_mut().for_each(|bin| *bin *= scale);
    transforms.complex(line, FftDirection::Inverse);
}

#[cfg(test)]
mod tests;
