//! Following a mesh harmonic's phase through a record, and with it the shaft's angle.

use std::cmp::Ordering;
use std::f64::consts::TAU;

use realfft::num_complex::Complex;
use rustfft::FftDirection;

use super::phases::phases_of;
use super::shaft_angle::{AngleSource, ShaftAngle};
use super::sums::mean_of;
use super::transform::Transforms;

/// Harmonics that are tried; the one that gives the angle best is taken.
const HARMONICS: u32 = 5;

/// The same where the wander of the speed is known roughly.
const HARMONICS_ALONG: u32 = 10;

/// Reach of the band around a line whose frequency is known, in shaft rates: just short of the first
/// sidebands.
const KNOWN_REACH_SHAFTS: f64 = 0.9;

/// The widest band around a harmonic, as a part of its frequency: its neighbours must stay outside.
const WIDEST_REACH_MESHES: f64 = 0.45;

/// What the band reaches beyond the tolerance of the speed.
const TOLERANCE_MARGIN: f64 = 0.02;

/// The followed line's own band in shaft rates: half way to the first sidebands.
const LINE_REACH_SHAFTS: f64 = 0.45;

/// Steps of following the phase that was left by the one before.
const STEPS: usize = 3;

/// The line is lost where its amplitude falls below this part of its root mean square.
const LOST_LINE: f64 = 0.25;

/// A line must stand this far above the background, as a ratio of amplitudes.
const MIN_RATIO: f64 = 4.0;

/// From this ratio on no turn of the phase is lost or gained in noise, and the harmonic with the least error
/// of the angle is the best one; below it the one that stands out most.
const SAFE_RATIO: f64 = 8.0;

/// Turns at each end that are left out: the band's filter has not settled there.
const UNSETTLED_TURNS: f64 = 1.0;

/// The unwindowed transform of a record, and what is known of its mesh.
#[derive(Clone, Copy)]
pub(super) struct MeshBand<'a> {
    /// Bins 0 to ⌊N/2⌋.
    pub(super) bins: &'a [Complex<f64>],
    /// N.
    pub(super) length: usize,
    /// In hertz.
    pub(super) sample_rate_hz: f64,
    /// Teeth of the shaft.
    pub(super) teeth: u32,
    /// The mesh frequency that is expected, in hertz.
    pub(super) mesh_hz: f64,
}

impl MeshBand<'_> {
    /// The shaft's angle by the phase of a harmonic within ± 0.9 shaft rates of `mesh_hz`: for a speed that
    /// varies less than that.
    pub(super) fn track_known(&self, transforms: &mut Transforms) -> Option<ShaftAngle> {
        let reach_hz = KNOWN_REACH_SHAFTS * self.mesh_hz / f64::from(self.teeth);
        self.track(|_| Some(reach_hz), transforms)
    }

    /// The shaft's angle where the speed may be anywhere within this tolerance (a fraction) of the expected
    /// one, and move.
    pub(super) fn track_wide(&self, tolerance: f64, transforms: &mut Transforms) -> Option<ShaftAngle> {
        let part = tolerance + TOLERANCE_MARGIN;
        let reach = |harmonic: f64| {
            (harmonic * part <= WIDEST_REACH_MESHES).then_some(harmonic * part * self.mesh_hz)
        };
        self.track(reach, transforms)
    }

    /// The shaft's angle where it is known roughly: harmonics up to a higher one, as their lines are narrow
    /// once that is taken off. `ahead_periods` is how many periods the mesh is ahead of `mesh_hz` at a part
    /// of the record, its speed within `part` of that.
    pub(super) fn track_along(
        &self,
        ahead_periods: &dyn Fn(f64) -> f64,
        part: f64,
        transforms: &mut Transforms,
    ) -> Option<ShaftAngle> {
        let shaft_hz = self.mesh_hz / f64::from(self.teeth);
        let followed = (1..=HARMONICS_ALONG).filter_map(|harmonic| {
            let reach_hz = KNOWN_REACH_SHAFTS * shaft_hz + part * f64::from(harmonic) * self.mesh_hz;
            self.follow(harmonic, reach_hz, Some(ahead_periods), transforms)
        });
        let followed = followed.collect();
        self.best(followed, transforms)
    }

    fn track(
        &self,
        reach_hz: impl Fn(f64) -> Option<f64>,
        transforms: &mut Transforms,
    ) -> Option<ShaftAngle> {
        let followed = (1..=HARMONICS)
            .filter_map(|harmonic| self.follow(harmonic, reach_hz(f64::from(harmonic))?, None, transforms));
        let followed = followed.collect();
        self.best(followed, transforms)
    }

    /// Follows one harmonic in the band of ± `reach_hz` around where it is expected.
    ///
    /// The band's analytic signal at a low rate gives a frequency over one turn at a time, weighted by power,
    /// and with it a first phase. What the signal's phase differs from it, below 0.45 shaft rates, is added:
    /// three times, as each step brings the line nearer to zero frequency, where sidebands no longer pass.
    /// Where `ahead_periods` is known it gives the first phase instead.
    fn follow(
        &self,
        harmonic: u32,
        reach_hz: f64,
        ahead_periods: Option<&dyn Fn(f64) -> f64>,
        transforms: &mut Transforms,
    ) -> Option<Followed> {
        let duration_s = self.length as f64 / self.sample_rate_hz;
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
        let signal = self.analytic(first, last, transforms);
        let samples = signal.len();
        let turn = (samples as f64 / shaft_bins).round().max(1.0) as usize;
        let (mut phase, mut turned) = (transforms.room(), transforms.complex_room());
        let (mut line, mut steps) = (transforms.complex_room(), transforms.complex_room());
        match ahead_periods {
            None => turn_back_by_frequency(&signal, turn, &mut phase, &mut turned, transforms),
            Some(ahead_periods) => {
                let constant = TAU * (centre_hz * duration_s - (first - 1) as f64) / samples as f64;
                let ahead = |j: usize| TAU * f64::from(harmonic) * ahead_periods(j as f64 / samples as f64);
                phase.extend((0..samples).map(|j| constant * j as f64 + ahead(j)));
                turned
                    .extend(signal.iter().zip(&phase).map(|(z, phase)| z * Complex::from_polar(1.0, -phase)));
            }
        }
        let reach_bins = (LINE_REACH_SHAFTS * shaft_bins).ceil() as usize;
        let mut moves = transforms.room();
        low_pass(&turned, reach_bins, &mut line, transforms);
        for step in 0..STEPS {
            if step > 0 {
                turn_back_by(&mut turned, &line);
                low_pass(&turned, reach_bins, &mut line, transforms);
            }
            let mut left = line[0].arg();
            phase[0] += left;
            steps.clear();
            steps.extend(line.windows(2).map(|pair| pair[1] * pair[0].conj()));
            phases_of(&steps, &mut moves);
            for (phase, step) in phase[1..].iter_mut().zip(&moves) {
                left += step;
                *phase += left;
            }
        }
        let left_out = (UNSETTLED_TURNS * turn as f64) as usize;
        let inside = left_out..samples.saturating_sub(left_out);
        let standing = (inside.len() >= 2).then(|| {
            let (line, signal) = (&line[inside.clone()], &signal[inside]);
            let line_power = mean_of(line, Complex::norm_sqr);
            let rest = (mean_of(signal, Complex::norm_sqr) - line_power).max(0.0);
            let line_bins = (2 * reach_bins + 1) as f64;
            let other_bins = ((last - first + 1) as f64 - line_bins).max(1.0);
            // A computed signal may have nothing at all beside its line.
            let background = (rest * line_bins / other_bins).max(1e-18 * line_power);
            let lowest = line.iter().map(Complex::norm_sqr).fold(f64::INFINITY, f64::min).sqrt();
            ((line_power / background).sqrt(), lowest >= LOST_LINE * line_power.sqrt())
        });
        for room in [signal, turned, line, steps] {
            transforms.keep_complex(room);
        }
        transforms.keep(moves);
        match standing {
            Some((ratio, true)) if ratio >= MIN_RATIO => {
                Some(Followed { harmonic, ratio, orders, first, left_out, phase })
            }
            _ => {
                transforms.keep(phase);
                None
            }
        }
    }

    /// The angle by the harmonic that is followed best.
    fn best(&self, mut followed: Vec<Followed>, transforms: &mut Transforms) -> Option<ShaftAngle> {
        let mut angle = None;
        while angle.is_none()
            && let Some((index, _)) = followed.iter().enumerate().max_by(|(_, a), (_, b)| a.cmp(b))
        {
            let best = followed.remove(index);
            angle = self.angle(&best);
            transforms.keep(best.phase);
        }
        for other in followed {
            transforms.keep(other.phase);
        }
        angle
    }

    fn angle(&self, followed: &Followed) -> Option<ShaftAngle> {
        let Followed { harmonic, ratio, orders, first, left_out, phase } = followed;
        let duration_s = self.length as f64 / self.sample_rate_hz;
        let samples = phase.len();
        let inside = *left_out..samples - left_out;
        // The band was moved down to bin 1.
        let moved = |j: usize| TAU * (first - 1) as f64 * j as f64 / samples as f64;
        let start = phase[*left_out] + moved(*left_out);
        let revolutions = inside.clone().map(|j| (phase[j] + moved(j) - start) / (TAU * orders)).collect();
        let times_s = inside.map(|j| j as f64 * duration_s / samples as f64).collect();
        let source = AngleSource::MeshPhase {
            harmonic: *harmonic,
            line_to_background: *ratio,
            angle_error_deg: followed.angle_error_deg(),
        };
        ShaftAngle::through(revolutions, times_s, source).ok()
    }

    /// The analytic signal of the bins `first` to `last`, moved down to begin at bin 1, at four samples a bin
    /// or somewhat more.
    pub(super) fn analytic(
        &self,
        first: usize,
        last: usize,
        transforms: &mut Transforms,
    ) -> Vec<Complex<f64>> {
        self.analytic_at((4 * (last - first + 1)).next_power_of_two(), first, last, transforms)
    }

    /// The same at two samples a bin or somewhat more.
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
        // Its real part is the band itself, which has each bin twice.
        let scale = 2.0 / self.length as f64;
        let mut signal = transforms.complex_room();
        signal.resize(samples, Complex::default());
        for (place, bin) in signal[1..].iter_mut().zip(&self.bins[first..=last]) {
            *place = bin * scale;
        }
        transforms.complex(&mut signal, FftDirection::Inverse);
        signal
    }
}

/// One harmonic that stands out, and its phase.
struct Followed {
    harmonic: u32,
    /// Amplitude of the line over the background.
    ratio: f64,
    /// Periods of the harmonic in a turn of the shaft.
    orders: f64,
    /// First bin of the band.
    first: usize,
    /// Samples at each end that have not settled.
    left_out: usize,
    /// By sample of the band's signal.
    phase: Vec<f64>,
}

impl Followed {
    fn angle_error_deg(&self) -> f64 {
        360.0 / (TAU * self.orders * self.ratio * 2.0_f64.sqrt())
    }

    /// Which one is followed better.
    fn cmp(&self, other: &Self) -> Ordering {
        let quality = |followed: &Self| {
            if followed.ratio >= SAFE_RATIO {
                (true, -followed.angle_error_deg())
            } else {
                (false, followed.ratio)
            }
        };
        let ((is_safe, this), (other_is_safe, other)) = (quality(self), quality(other));
        is_safe.cmp(&other_is_safe).then(this.total_cmp(&other))
    }
}

/// The phase by the frequency over `turn` samples around each sample, weighted by power, and the signal turned
/// back by it.
fn turn_back_by_frequency(
    signal: &[Complex<f64>],
    turn: usize,
    phase: &mut Vec<f64>,
    turned: &mut Vec<Complex<f64>>,
    transforms: &mut Transforms,
) {
    let (mut sums, mut steps) = (transforms.complex_room(), transforms.complex_room());
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
    let mut total = 0.0;
    for phase in phase.iter_mut() {
        total += *phase;
        *phase = total;
    }
    phase.insert(0, 0.0);
    // What turns back goes on with each step: no sine is needed.
    let mut back = Complex::new(1.0, 0.0);
    turned.push(signal[0]);
    turned.extend(signal[1..].iter().zip(&steps).map(|(z, step)| {
        let modulus = step.norm_sqr().sqrt();
        if modulus > 0.0 {
            back *= step.conj() / modulus;
        }
        z * back
    }));
    transforms.keep_complex(sums);
    transforms.keep_complex(steps);
}

/// Turns each sample back by the phase of `line` there, which is what was last added to the followed phase.
fn turn_back_by(signal: &mut [Complex<f64>], line: &[Complex<f64>]) {
    for (z, line) in signal.iter_mut().zip(line) {
        let modulus = line.norm_sqr().sqrt();
        // Zero has no phase.
        if modulus > 0.0 {
            *z *= line.conj() / modulus;
        }
    }
}

/// What lies within `reach` bins of zero.
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
    let last = signal.len() - 1;
    for (k, bin) in line.iter_mut().enumerate() {
        *bin = if k <= reach || last - k < reach { *bin * scale } else { Complex::default() };
    }
    transforms.complex(line, FftDirection::Inverse);
}
