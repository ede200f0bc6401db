//! Figures 19 to 22: the vibration of the wear states.

use serde::Serialize;

use super::check::Check;
use super::trend::range;
use super::{FigureSettings, FiguresError};
use crate::rank_correlation::rank_correlation;
use flankwatch_gear::{FlankWear, GearPair, MeshCycle, RunSettings, simulate};
use flankwatch_signal::{AnalysisSettings, Analyzer, MeshContext, Spectrum};
use flankwatch_wear::library::response_record;

/// Positions of the mesh cycle that the dynamics use.
const CYCLE_POINTS: usize = 1000;
/// Mesh periods of the time signal that are stored.
const PERIODS_KEPT: f64 = 6.0;
/// Mesh harmonics up to which spectra are stored.
const HARMONICS_KEPT: f64 = 10.5;
/// Number of points of the mean mesh period.
pub(super) const MEAN_PLACES: usize = 125;
/// Number of strongest lines that are classified.
const STRONGEST: usize = 20;
/// Shaft sidebands on either side of a mesh harmonic that count as its own.
const SIDEBANDS: i32 = 2;
/// Least rank correlation of an indicator that counts as rising.
const RISING: f64 = 0.9;

/// Indicators of one wear state (Fig. 22).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct IndicatorState {
    /// Number of the state.
    pub num: u32,
    /// Greatest wear depth in µm.
    pub wear_um: f64,
    /// RMS in m/s².
    pub rms: f64,
    /// Kurtosis.
    pub kurtosis: f64,
    /// First mesh amplitude in m/s².
    pub omx: f64,
}

/// Lines of a spectrum: the strongest of every few bins.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Lines {
    /// Frequency in hertz.
    pub frequency_hz: Vec<f64>,
    /// Peak amplitude in m/s².
    pub amplitude: Vec<f64>,
}

/// The vibration of one wear state in full (Figs. 19 to 21).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Vibration {
    /// Number of the state.
    pub num: u32,
    /// Greatest wear depth in µm.
    pub wear_um: f64,
    /// Time in s.
    pub time_s: Vec<f64>,
    /// Acceleration in m/s².
    pub acceleration_m_per_s2: Vec<f64>,
    /// Mean mesh period of the whole record, from the nominal start of contact, in m/s².
    pub mean_period_m_per_s2: Vec<f64>,
    /// Positions in mesh periods at which the number of carrying pairs changes.
    pub changes: Vec<f64>,
    /// Mean over the mesh periods of each period's greatest magnitude, in m/s².
    pub mean_peak_m_per_s2: f64,
    /// Spectrum.
    pub spectrum: Lines,
    /// Spectrum of the envelope of the whole band.
    pub envelope: Lines,
    /// The strongest lines of the spectrum, strongest first.
    pub strongest: Lines,
    /// Median, over the shaft sidebands of the first ten mesh harmonics, of the ratio of their amplitude to
    /// that half a shaft rate further out.
    pub sideband_to_background: f64,
    /// Root sum square of the envelope's amplitudes at the first ten mesh harmonics in m/s².
    pub envelope_harmonics: f64,
    /// The same at one shaft rate below and above them.
    pub envelope_sidebands: f64,
}

/// Figs. 19 to 22.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VibrationFigures {
    /// Mesh frequency in hertz.
    pub mesh_hz: f64,
    /// Rotational frequency of the driving shaft in hertz.
    pub shaft_hz: f64,
    /// Two states in full.
    pub states: [Vibration; 2],
    /// Indicators of every state.
    pub indicators: Vec<IndicatorState>,
    /// Spearman's rank correlation of RMS, kurtosis and first mesh amplitude with the number of the state.
    pub spearman: [f64; 3],
}

/// Computes one state: its indicators, and its full vibration where it is drawn.
pub(super) fn state(
    pair: &GearPair,
    settings: &FigureSettings,
    num: u32,
    drawn: bool,
) -> Result<(IndicatorState, Option<Vibration>), FiguresError> {
    let wear_um = settings.step_um * f64::from(num);
    let cycle = MeshCycle::compute(pair, &FlankWear::from_shape(pair, wear_um * 1e-3)?, CYCLE_POINTS)?;
    let run = RunSettings::nominal(pair, settings.sample_rate_hz, settings.seconds);
    let signal = simulate(pair, &cycle, &run)?;
    let teeth = pair.gears[0].teeth;
    let record = response_record(&run, &signal)?;
    let mesh = MeshContext::at_exact_speed([teeth, 0], run.shaft_speed_hz);
    let mut analyzer = Analyzer::new(AnalysisSettings::default());
    let analysis = analyzer.analyze(&record, &mesh);
    let of =
        |name: &'static str| analysis.indicators.get(name).ok_or(FiguresError::NoIndicator { num, name });
    let indicators =
        IndicatorState { num, wear_um, rms: of("rms")?, kurtosis: of("kurtosis")?, omx: of("omx")? };
    if !drawn {
        return Ok((indicators, None));
    }
    let mesh_hz = run.shaft_speed_hz * f64::from(teeth);
    let spectrum = analyzer.amplitude_spectrum(&record);
    let envelope = analyzer.envelope_spectrum(&record, [0.0, 0.5 * run.sample_rate_hz])?;
    let kept = ((PERIODS_KEPT / mesh_hz * run.sample_rate_hz) as usize).min(signal.len());
    let period = run.sample_rate_hz / mesh_hz;
    let vibration = Vibration {
        num,
        wear_um,
        time_s: (0..kept).map(|n| n as f64 / run.sample_rate_hz).collect(),
        mean_period_m_per_s2: mean_period(&signal, period),
        changes: changes(&cycle),
        mean_peak_m_per_s2: mean_peak(&signal, period),
        spectrum: drawn_lines(&spectrum, HARMONICS_KEPT * mesh_hz),
        envelope: drawn_lines(&envelope, HARMONICS_KEPT * mesh_hz),
        strongest: strongest(&spectrum, 0.5 * run.shaft_speed_hz),
        sideband_to_background: sideband_to_background(&spectrum, mesh_hz, run.shaft_speed_hz),
        envelope_harmonics: root_sum_square(&envelope, mesh_hz, &[0.0]),
        envelope_sidebands: root_sum_square(&envelope, mesh_hz, &[-run.shaft_speed_hz, run.shaft_speed_hz]),
        acceleration_m_per_s2: signal[..kept].to_vec(),
    };
    Ok((indicators, Some(vibration)))
}

/// Mean of all mesh periods of `period` samples.
fn mean_period(signal: &[f64], period: f64) -> Vec<f64> {
    let mut sums = vec![(0.0, 0_u32); MEAN_PLACES];
    for (n, value) in signal.iter().enumerate() {
        let place = (n as f64 / period).rem_euclid(1.0);
        let (sum, count) = &mut sums[((place * MEAN_PLACES as f64) as usize).min(MEAN_PLACES - 1)];
        *sum += value;
        *count += 1;
    }
    sums.iter().map(|(sum, count)| sum / f64::from((*count).max(1))).collect()
}

/// Mean of the greatest magnitudes of the mesh periods.
fn mean_peak(signal: &[f64], period: f64) -> f64 {
    let count = (signal.len() as f64 / period) as usize;
    let peak = |i: usize| {
        let (start, end) = ((i as f64 * period) as usize, ((i + 1) as f64 * period) as usize);
        signal[start..end].iter().fold(0.0, |most: f64, value| most.max(value.abs()))
    };
    (0..count).map(peak).sum::<f64>() / count.max(1) as f64
}

/// Positions in mesh periods at which the number of carrying pairs changes.
fn changes(cycle: &MeshCycle) -> Vec<f64> {
    let pairs = &cycle.pairs_in_contact;
    let before = |i: usize| pairs[(i + pairs.len() - 1) % pairs.len()];
    let places = (0..pairs.len()).filter(|i| pairs[*i] != before(*i));
    places.map(|i| i as f64 / pairs.len() as f64).collect()
}

/// Returns the strongest line of every few bins up to a frequency.
fn drawn_lines(spectrum: &Spectrum, up_to_hz: f64) -> Lines {
    let last = ((up_to_hz / spectrum.resolution_hz) as usize).min(spectrum.amplitude.len());
    let group = (2.0 / spectrum.resolution_hz).round().max(1.0) as usize;
    let mut lines = Lines::default();
    for (i, bins) in spectrum.amplitude[..last].chunks(group).enumerate() {
        let strongest = (0..bins.len()).max_by(|a, b| bins[*a].total_cmp(&bins[*b])).unwrap_or(0);
        lines.frequency_hz.push(spectrum.frequency_hz(i * group + strongest));
        lines.amplitude.push(bins[strongest]);
    }
    lines
}

/// Returns the strongest local maxima of a spectrum, strongest first. Maxima within `apart_hz` of a stronger
/// one are its side lobes and are skipped.
fn strongest(spectrum: &Spectrum, apart_hz: f64) -> Lines {
    let amplitude = &spectrum.amplitude;
    let mut peaks: Vec<usize> = (1..amplitude.len().saturating_sub(1))
        .filter(|k| amplitude[*k] > amplitude[k - 1] && amplitude[*k] >= amplitude[k + 1])
        .collect();
    peaks.sort_by(|a, b| amplitude[*b].total_cmp(&amplitude[*a]));
    let apart = (apart_hz / spectrum.resolution_hz) as usize;
    let mut lines: Vec<usize> = Vec::with_capacity(STRONGEST);
    for peak in peaks {
        if lines.len() == STRONGEST {
            break;
        }
        if lines.iter().all(|line| line.abs_diff(peak) > apart) {
            lines.push(peak);
        }
    }
    Lines {
        frequency_hz: lines.iter().map(|k| spectrum.frequency_hz(*k)).collect(),
        amplitude: lines.iter().map(|k| amplitude[*k]).collect(),
    }
}

/// Greatest amplitude within 1.5 bins of a frequency.
fn line_at(spectrum: &Spectrum, frequency_hz: f64) -> f64 {
    let place = frequency_hz / spectrum.resolution_hz;
    let (first, last) = ((place - 1.5).ceil().max(0.0) as usize, (place + 1.5).floor() as usize);
    let bins = spectrum.amplitude.get(first..=last.min(spectrum.amplitude.len().saturating_sub(1)));
    bins.unwrap_or_default().iter().copied().fold(0.0, f64::max)
}

/// Root sum square of the lines at each of these distances from the first ten mesh harmonics.
fn root_sum_square(spectrum: &Spectrum, mesh_hz: f64, beside_hz: &[f64]) -> f64 {
    let lines = (1..=10).flat_map(|h| beside_hz.iter().map(move |beside| f64::from(h) * mesh_hz + beside));
    lines.map(|frequency| line_at(spectrum, frequency).powi(2)).sum::<f64>().sqrt()
}

/// Median ratio of the sidebands' amplitudes to those half a shaft rate further out.
fn sideband_to_background(spectrum: &Spectrum, mesh_hz: f64, shaft_hz: f64) -> f64 {
    let sides = (1..=10).flat_map(|h| [-shaft_hz, shaft_hz].map(|beside| (f64::from(h) * mesh_hz, beside)));
    let mut ratios: Vec<f64> = sides
        .map(|(harmonic, beside)| {
            line_at(spectrum, harmonic + beside)
                / line_at(spectrum, harmonic + 1.5 * beside).max(f64::MIN_POSITIVE)
        })
        .collect();
    ratios.sort_by(f64::total_cmp);
    ratios[ratios.len() / 2]
}

/// Number of lines that are mesh harmonics or their nearest shaft sidebands.
fn of_the_mesh(lines: &Lines, mesh_hz: f64, shaft_hz: f64, resolution_hz: f64) -> usize {
    let belongs = |frequency: &&f64| {
        let harmonic = (*frequency / mesh_hz).round();
        (-SIDEBANDS..=SIDEBANDS).any(|n| {
            (**frequency - harmonic * mesh_hz - f64::from(n) * shaft_hz).abs() <= 1.5 * resolution_hz
        }) && harmonic >= 1.0
    };
    lines.frequency_hz.iter().filter(belongs).count()
}

/// Returns the time between the two impacts of the mean mesh period, in parts of the period. An impact is the
/// greatest magnitude within a third of a period after a change of the number of carrying pairs.
fn interval_of_impacts(state: &Vibration) -> Option<f64> {
    let [first, second] = *state.changes.as_slice() else {
        return None;
    };
    let mean = state.mean_period_m_per_s2.iter().sum::<f64>() / MEAN_PLACES as f64;
    let impact = |change: f64, next: f64| {
        let reach = (next - change).rem_euclid(1.0).min(0.33);
        let start = (change * MEAN_PLACES as f64).floor() as usize;
        let places = start..start + (reach * MEAN_PLACES as f64).ceil() as usize;
        let magnitude = |place: usize| (state.mean_period_m_per_s2[place % MEAN_PLACES] - mean).abs();
        places.max_by(|a, b| magnitude(*a).total_cmp(&magnitude(*b)))
    };
    let (one, two) = (impact(first, second)? as f64, impact(second, first)? as f64);
    Some(((two - one) / MEAN_PLACES as f64).rem_euclid(1.0))
}

impl VibrationFigures {
    /// Assembles the states.
    pub(super) fn new(pair: &GearPair, indicators: Vec<IndicatorState>, states: [Vibration; 2]) -> Self {
        let column = |value: fn(&IndicatorState) -> f64| {
            let by_wear = (0_u32..).zip(&indicators).map(|(number, state)| (f64::from(number), value(state)));
            rank_correlation(&by_wear.collect::<Vec<_>>()).unwrap_or(0.0)
        };
        let shaft_hz = pair.spec.operation.shaft_speed_hz;
        Self {
            mesh_hz: shaft_hz * f64::from(pair.gears[0].teeth),
            shaft_hz,
            states,
            spearman: [column(|state| state.rms), column(|state| state.kurtosis), column(|state| state.omx)],
            indicators,
        }
    }

    /// Checks Figs. 19 to 22 for records of `seconds`.
    pub(super) fn checks(&self, seconds: f64) -> Vec<Check> {
        let [unworn, worn] = &self.states;
        let period_ms = 1e3 / self.mesh_hz;
        let mut checks = vec![Check::new(
            19,
            "The impacts grow clearly with wear.",
            "mean over the mesh periods of the greatest magnitude at least 1.2 times the unworn one",
            format!("{:.1} and {:.1} m/s²", unworn.mean_peak_m_per_s2, worn.mean_peak_m_per_s2),
            worn.mean_peak_m_per_s2 > 1.2 * unworn.mean_peak_m_per_s2,
        )];
        let between = |state: &Vibration| {
            Some((
                (*state.changes.get(1)? - *state.changes.first()?).rem_euclid(1.0),
                interval_of_impacts(state)?,
            ))
        };
        let (text, holds) = match (between(unworn), between(worn)) {
            (Some(a), Some(b)) => (
                format!(
                    "changes of stiffness {:.3} and {:.3} ms apart, impacts of the mean mesh period {:.2} and {:.2} ms of {period_ms:.3} ms",
                    a.0 * period_ms,
                    b.0 * period_ms,
                    a.1 * period_ms,
                    b.1 * period_ms
                ),
                (a.0 - b.0).abs() > 0.05 && (a.1 - b.1).abs() > 0.05,
            ),
            _ => ("the number of carrying pairs does not change twice per period".to_owned(), false),
        };
        checks.push(Check::new(
            19,
            "The time between the two impacts of a mesh period changes, as the ranges of contact do.",
            "both by more than 5 % of the period",
            text,
            holds,
        ));

        let own = [unworn, worn]
            .map(|state| of_the_mesh(&state.strongest, self.mesh_hz, self.shaft_hz, 1.0 / seconds));
        checks.push(Check::new(
            20,
            "Mesh harmonics and their shaft sidebands are the main lines, worn or not: the spectrum keeps its structure.",
            "all of the 20 strongest lines are mesh harmonics or their first two shaft sidebands",
            format!("{} and {} of {STRONGEST}", own[0], own[1]),
            own == [STRONGEST; 2],
        ));
        let sidebands = [unworn, worn].map(|state| state.sideband_to_background);
        checks.push(Check::new(
            20,
            "The shaft sidebands of the mesh harmonics are visible.",
            "their median at least twice the amplitude half a shaft rate further out",
            format!("{:.2} and {:.2} times", sidebands[0], sidebands[1]),
            sidebands.iter().all(|ratio| *ratio >= 2.0),
        ));
        let mesh_lines = [unworn, worn].map(|drawn| {
            let state = self.indicators.iter().find(|state| state.num == drawn.num);
            state.map_or(f64::NAN, |state| state.omx)
        });
        checks.push(Check::new(
            20,
            "Wear changes the amplitudes of the lines.",
            "the first mesh harmonic by more than 10 %",
            format!("{:.2} and {:.2} m/s²", mesh_lines[0], mesh_lines[1]),
            (mesh_lines[1] / mesh_lines[0] - 1.0).abs() > 0.1,
        ));
        let grows = |statement, before: f64, after: f64| {
            Check::new(
                21,
                statement,
                "root sum square over the first ten mesh harmonics",
                format!("{before:.3} and {after:.3} m/s²"),
                after > before,
            )
        };
        checks.push(grows(
            "In the envelope spectrum the mesh harmonics grow with wear.",
            unworn.envelope_harmonics,
            worn.envelope_harmonics,
        ));
        checks.push(grows(
            "In the envelope spectrum the shaft sidebands of the mesh harmonics grow with wear.",
            unworn.envelope_sidebands,
            worn.envelope_sidebands,
        ));
        let statements = [
            "RMS grows with wear.",
            "Kurtosis grows with wear.",
            "The first mesh amplitude (OMX) grows with wear.",
        ];
        let values = |i: usize| {
            let column = self.indicators.iter().map(move |state| [state.rms, state.kurtosis, state.omx][i]);
            column.collect::<Vec<_>>()
        };
        for (i, statement) in statements.into_iter().enumerate() {
            let values = values(i);
            let (first, last) = (values[0], values[values.len() - 1]);
            checks.push(Check::new(
                22,
                statement,
                "Spearman's rank correlation with NUM at least 0.9",
                format!(
                    "ρ = {:.4}; {first:.3} at the first and {last:.3} at the last state, range {:.3}",
                    self.spearman[i],
                    range(&values)
                ),
                self.spearman[i] >= RISING,
            ));
        }
        checks
    }
}
