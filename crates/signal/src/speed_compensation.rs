//! Speed-fluctuation compensation of the mesh lines, so that features of records at a fluctuating speed and
//! at a constant speed agree.

use std::f64::consts::TAU;

use flankwatch_fourier::{Complex, FftDirection};

use super::comb::{HARMONICS, SHAFT_RESOLVED_BINS};
use super::line::{MAIN_LOBE_BINS, noise_amplitude, read_line};
use super::mesh_phase::MeshBand;
use super::record_spectrum::RecordSpectrum;
use super::shaft_angle::{AngleSource, ShaftAngle};
use super::spectrum::{HANN_BANDWIDTH_BINS, hann_amplitude};
use super::speed_fluctuation::SpeedFluctuation;
use super::transform::Transforms;

/// From this harmonic on, a narrow line means that the speed is constant.
const DECISIVE_HARMONIC: usize = 4;

/// A line is wide if the energy around it exceeds this many times that of a single line ...
const MIN_WIDE_ENERGY: f64 = 1.15;

/// ... and its amplitude exceeds the noise by this ratio.
const MIN_CLEAR_RATIO: f64 = 4.0;

/// Largest phase error of the highest harmonic that needs no better angle: 2 % of its amplitude.
const MAX_ERROR_DEG: f64 = 12.0;

/// Fluctuations that move the highest harmonic's phase by at most this to either side are not compensated.
const MIN_SWING_TURNS: f64 = 0.1;

/// Half-width of the compensated band around each mesh harmonic, in shaft rates: the sidebands that features
/// read, and a margin.
const REACH_SHAFTS: f64 = 2.75;

/// Position of the mesh in one record.
#[derive(Debug, Clone, Copy)]
pub(super) struct Mesh {
    /// The mesh frequency in bins.
    pub(super) bins: f64,
    /// Teeth of the shaft.
    pub(super) teeth: u32,
    /// Sampling rate in hertz.
    pub(super) sample_rate_hz: f64,
}

impl Mesh {
    /// Returns the mesh in the transform of a record of `length` samples.
    fn band(self, bins: &[Complex<f64>], length: usize) -> MeshBand<'_> {
        MeshBand {
            bins,
            length,
            sample_rate_hz: self.sample_rate_hz,
            teeth: self.teeth,
            mesh_hz: self.bins * self.sample_rate_hz / length as f64,
        }
    }
}

/// The compensation of a transform, and the original bins and amplitudes.
pub(super) struct SpeedCompensation {
    /// The mean mesh frequency in bins: that of the compensated lines.
    pub(super) mesh_bins: f64,
    bins: Vec<Complex<f64>>,
    amplitude: Vec<f64>,
}

impl SpeedCompensation {
    /// Restores the original transform. The next compensation of this record returns the same one.
    pub(super) fn undo(self, work: &mut RecordSpectrum) {
        let bins = std::mem::replace(&mut work.bins, self.bins);
        let amplitude = std::mem::replace(&mut work.amplitude, self.amplitude);
        work.compensated = (bins, amplitude);
        work.compensated_mesh_bins = Some(self.mesh_bins);
    }

    /// Puts the compensated transform in the place of the original one.
    fn apply(mesh_bins: f64, work: &mut RecordSpectrum) -> Self {
        let (bins, amplitude) = std::mem::take(&mut work.compensated);
        Self {
            mesh_bins,
            bins: std::mem::replace(&mut work.bins, bins),
            amplitude: std::mem::replace(&mut work.amplitude, amplitude),
        }
    }
}

/// Replaces the bins around the mesh harmonics by those that the record would have at its mean speed: the
/// band's analytic signal is derotated by the harmonic's multiple of the mesh phase fluctuation. `None` if
/// the speed does not fluctuate or cannot be tracked.
pub(super) fn compensate(
    work: &mut RecordSpectrum,
    mesh: Mesh,
    harmonics: usize,
) -> Option<SpeedCompensation> {
    if let Some(mesh_bins) = work.compensated_mesh_bins {
        return Some(SpeedCompensation::apply(mesh_bins, work));
    }
    let ahead = Fluctuation::of_record(work, mesh, harmonics)?;
    let mean_bins = ahead.mean_hz * f64::from(mesh.teeth) * work.length as f64 / mesh.sample_rate_hz;
    if ahead.swing() * f64::from(mesh.teeth) * (harmonics as f64) < MIN_SWING_TURNS {
        return None;
    }
    let mut compensated = std::mem::take(&mut work.compensated.0);
    compensated.clone_from(&work.bins);
    for order in 1..=harmonics {
        let centre = order as f64 * mean_bins;
        let inner = REACH_SHAFTS * mean_bins / f64::from(mesh.teeth);
        let reach = inner + ahead.relative_speed * centre;
        let (first, last) = ((centre - reach).ceil(), (centre + reach).floor());
        if first < 1.0 || last >= 0.5 * work.length as f64 {
            continue;
        }
        let (first, last) = (first as usize, last as usize);
        let turns_each = order as f64 * f64::from(mesh.teeth);
        let band = mesh.band(&work.bins, work.length);
        let mut signal = band.analytic(first, last, &mut work.transforms);
        let samples = signal.len();
        for (j, z) in signal.iter_mut().enumerate() {
            let rotation = TAU * turns_each * ahead.revolutions(j as f64 / samples as f64);
            *z *= Complex::from_polar(1.0, -rotation);
        }
        work.transforms.complex(&mut signal, FftDirection::Forward);
        // The analytic signal contains each bin twice over the record's length.
        let scale = work.length as f64 / (2.0 * samples as f64);
        let inner_bins = (centre - inner).ceil() as usize..=(centre + inner).floor() as usize;
        for bin in inner_bins.filter(|bin| (first..=last).contains(bin)) {
            let m = bin - first + 1;
            compensated[bin] = signal[m] * scale;
        }
        work.transforms.recycle_complex(signal);
    }
    hann_amplitude(&compensated, work.length, &mut work.compensated.1);
    work.compensated.0 = compensated;
    Some(SpeedCompensation::apply(mean_bins, work))
}

/// Returns whether an angle is accurate enough for this order: a phase error reduces a line's amplitude by
/// half its square.
fn is_accurate_enough(angle: &ShaftAngle, order: usize) -> bool {
    match angle.source() {
        AngleSource::MeshPhase { angle_error_deg, .. } => angle_error_deg * order as f64 <= MAX_ERROR_DEG,
        _ => true,
    }
}

/// Tracks one harmonic by its own phase, a second time from the mean speed: the comb is found where the speed
/// dwells, which may be an extreme of its swing.
fn track_by_own_phase(band: &MeshBand<'_>, first: &ShaftAngle, transforms: &mut Transforms) -> ShaftAngle {
    let mesh_hz = first.mean_speed_hz() * f64::from(band.teeth);
    let band = MeshBand { mesh_hz, ..*band };
    band.track_known(transforms).unwrap_or_else(|| first.clone())
}

/// Width of the mesh lines over the whole record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum LineWidth {
    /// A high harmonic stands out and is as narrow as at a constant speed.
    Narrow,
    /// A harmonic stands out, and the speed may fluctuate.
    Clear,
    /// No harmonic stands out: they are weak, or smeared over so many bins that they look like noise.
    Unclear,
}

fn line_width(work: &mut RecordSpectrum, mesh_bins: f64, shaft_bins: f64) -> LineWidth {
    let RecordSpectrum { amplitude, sorting, .. } = work;
    let reach = 0.45 * shaft_bins;
    let mut width = LineWidth::Unclear;
    // The higher harmonics show a fluctuation more.
    for order in 1..=HARMONICS {
        let centre = order as f64 * mesh_bins;
        let Some(line) = read_line(amplitude, centre) else {
            break;
        };
        let (first, last) = ((centre - reach).ceil() as usize, (centre + reach).floor() as usize);
        if first < 1 || last + 1 >= amplitude.len() || reach < MAIN_LOBE_BINS + 1.0 {
            break;
        }
        sorting.clear();
        let aside = (shaft_bins * 0.5) as usize;
        sorting.extend_from_slice(
            &amplitude[first.saturating_sub(aside)..(last + aside).min(amplitude.len() - 1)],
        );
        let noise = noise_amplitude(sorting).unwrap_or(0.0);
        let bins = (last - first + 1) as f64;
        let energy: f64 = amplitude[first..=last].iter().map(|a| a * a).sum::<f64>();
        let around = (energy - bins * noise * noise) / HANN_BANDWIDTH_BINS;
        let single = line.amplitude * line.amplitude;
        if around > MIN_CLEAR_RATIO * MIN_CLEAR_RATIO * noise * noise {
            if around > MIN_WIDE_ENERGY * single {
                return LineWidth::Clear;
            }
            // Higher harmonics show more: the lowest ones alone prove little, but can be tracked.
            width = if order >= DECISIVE_HARMONIC { LineWidth::Narrow } else { LineWidth::Clear };
        }
    }
    width
}

/// How far a shaft is ahead of its mean speed, over the course of a record.
struct Fluctuation {
    revolutions: [f64; Self::STEPS + 1],
    /// Largest relative deviation of the speed from the mean.
    relative_speed: f64,
    /// The mean speed in hertz.
    mean_hz: f64,
}

impl Fluctuation {
    /// Number of steps over the record; the speed changes slowly.
    const STEPS: usize = 512;

    /// Follows one harmonic of the mesh, or all together if none can be followed. `None` if the shaft is not
    /// resolved or the speed is constant.
    fn of_record(work: &mut RecordSpectrum, mesh: Mesh, harmonics: usize) -> Option<Self> {
        let shaft_bins = mesh.bins / f64::from(mesh.teeth);
        if shaft_bins < SHAFT_RESOLVED_BINS {
            return None;
        }
        let width = line_width(work, mesh.bins, shaft_bins);
        if width == LineWidth::Narrow {
            return None;
        }
        let RecordSpectrum { bins, transforms, tracked_angle, .. } = work;
        let band = mesh.band(bins, work.length);
        let by_own_phase = match width {
            LineWidth::Clear => tracked_angle
                .insert(band.track_known(transforms))
                .as_ref()
                .map(|first| track_by_own_phase(&band, first, transforms)),
            _ => None,
        };
        let Some(angle) = by_own_phase else {
            let rough = SpeedFluctuation::of(&band, transforms)?;
            let ahead_periods = |part: f64| rough.ahead_periods(part);
            return Some(match band.track_with_estimate(&ahead_periods, rough.reach(), transforms) {
                Some(angle) => Self::of_angle(angle, &band, transforms),
                None => Self::of_rough(&rough, &band),
            });
        };
        if is_accurate_enough(&angle, harmonics * mesh.teeth as usize) {
            return Some(Self::of_angle(angle, &band, transforms));
        }
        let first = Self::of(|t| angle.revolution(t), band.mesh_hz / f64::from(mesh.teeth), &band);
        let ahead_periods = |part: f64| first.revolutions(part) * f64::from(mesh.teeth);
        let better = band.track_with_estimate(&ahead_periods, first.relative_speed, transforms);
        let angle = match better {
            Some(better) => {
                angle.recycle(transforms);
                better
            }
            None => angle,
        };
        Some(Self::of_angle(angle, &band, transforms))
    }

    fn of_angle(angle: ShaftAngle, band: &MeshBand<'_>, transforms: &mut Transforms) -> Self {
        let this = Self::of(|t| angle.revolution(t), angle.mean_speed_hz(), band);
        angle.recycle(transforms);
        this
    }

    fn of_rough(rough: &SpeedFluctuation, band: &MeshBand<'_>) -> Self {
        let duration_s = band.duration_s();
        let revolution =
            |t: f64| (band.mesh_hz * t + rough.ahead_periods(t / duration_s)) / f64::from(band.teeth);
        Self::of(revolution, revolution(duration_s) / duration_s, band)
    }

    /// Compares the angle in revolutions at each time in seconds with that at the mean speed.
    fn of(revolution: impl Fn(f64) -> f64, mean_hz: f64, band: &MeshBand<'_>) -> Self {
        let step_s = band.duration_s() / Self::STEPS as f64;
        let revolutions = std::array::from_fn(|i| {
            let t = i as f64 * step_s;
            revolution(t) - mean_hz * t
        });
        let fastest = revolutions.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
        Self { revolutions, relative_speed: (fastest / (mean_hz * step_s)).min(0.02), mean_hz }
    }

    /// Returns half the range of the lead, in revolutions.
    fn swing(&self) -> f64 {
        let low = self.revolutions.iter().copied().fold(f64::INFINITY, f64::min);
        let high = self.revolutions.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        0.5 * (high - low)
    }

    /// Returns the lead in revolutions at a fraction of the record, 0 to 1.
    fn revolutions(&self, part: f64) -> f64 {
        let place = part * Self::STEPS as f64;
        let i = (place as usize).min(Self::STEPS - 1);
        self.revolutions[i] + (place - i as f64) * (self.revolutions[i + 1] - self.revolutions[i])
    }
}

#[cfg(test)]
mod tests {
    use jiff::Timestamp;

    use super::super::{AnalysisSettings, Analyzer, MeshContext, Record};
    use super::*;

    /// Harmonics of amplitude 1/h with once-per-turn modulation of depth 0.2; the speed swings by this part
    /// at 0.7 Hz.
    fn features(swing: f64) -> super::super::Features {
        let (rate_hz, shaft_hz, swing_hz) = (20_000.0, 16.64, 0.7);
        let samples = (0..40_000).map(|i| {
            let t = f64::from(i) / rate_hz;
            let turn = TAU * shaft_hz * (t + swing * (1.0 - (TAU * swing_hz * t).cos()) / (TAU * swing_hz));
            let lines: f64 = (1..=10)
                .map(|h| {
                    (1.0 + 0.2 * turn.cos()) / f64::from(h)
                        * (24.0 * f64::from(h) * turn + f64::from(h * h)).sin()
                })
                .sum();
            // A little that is neither.
            (lines + 0.01 * (f64::from(i * i % 977) / 977.0 - 0.5)) as f32
        });
        let record = Record::new("1", Timestamp::UNIX_EPOCH, rate_hz, "g", samples.collect()).unwrap();
        let mesh = MeshContext::new([24, 0], 16.64, 0.05);
        Analyzer::new(AnalysisSettings::default()).analyze(&record, &mesh).features
    }

    /// The amplitudes put in, whatever the speed does: ln(1/h), sidebands 0.1·√2/h; within 8 %, as the first
    /// and the last turn are not followed.
    #[test]
    fn lines_at_a_wandering_speed_read_as_at_a_constant_one() {
        for swing in [0.0, 0.002, 0.005, -0.005] {
            let got = features(swing);
            for order in 1..=10 {
                let line = got.values[&format!("ln_mesh_{order}")];
                assert!((line + f64::from(order).ln()).abs() < 0.08, "{swing} {order}: {line}");
            }
            for order in 1..=4 {
                let sideband = got.values[&format!("ln_sideband_{order}")];
                let expected = (0.1 * 2.0_f64.sqrt() / f64::from(order)).ln();
                assert!((sideband - expected).abs() < 0.15, "{swing} {order}: {sideband} {expected}");
            }
        }
    }
}
