//! Tracking of a mesh harmonic's phase through a record, which gives the shaft angle.

use std::f64::consts::TAU;

use flankwatch_fourier::{Complex, FftDirection};
use smallvec::SmallVec;

use super::comb;
use super::shaft_angle::{AngleSource, ShaftAngle};
use super::tracked_harmonic::{TrackedHarmonic, derotate_by_frequency};
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

#[cfg(test)]
mod tests;
