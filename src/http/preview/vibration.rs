//! The acceleration of a previewed pair, over few enough mesh periods for a slider step.

use flankwatch_fourier::Planned;
use serde::Serialize;

use crate::gear::{GearError, GearPair, MeshCycle, RunSettings, simulate};

/// Samples per mesh period: the response is flat up to 25 mesh harmonics.
const SAMPLES_PER_PERIOD: usize = 64;

/// Maximum number of simulated mesh periods after the start-up; whole turns if a turn has fewer.
const MAX_PERIODS: usize = 256;

/// Maximum number of turns.
const MAX_TURNS: usize = 4;

/// Number of mesh harmonics returned.
const HARMONICS: usize = 10;

/// Maximum number of returned waveform samples: two turns, or as many whole mesh periods as fit.
const SHOWN_SAMPLES: usize = 4096;

/// Expected acceleration of the pair's response coordinate.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = PreviewVibration)]
pub(crate) struct Vibration {
    /// Samples per second.
    sample_rate_hz: f64,
    /// The first turns or mesh periods in m/s².
    acceleration_m_per_s2: Vec<f32>,
    /// Root mean square of all simulated samples in m/s².
    rms_m_per_s2: f64,
    /// Spacing of the spectrum in orders of the driving shaft.
    order_step: f64,
    /// Peak amplitudes in m/s² from order 0 to half a harmonic beyond the tenth mesh harmonic.
    spectrum_m_per_s2: Vec<f32>,
    #[serde(skip)]
    harmonics: Vec<f64>,
}

impl Vibration {
    /// Peak amplitudes of the first mesh harmonics in m/s².
    pub(crate) fn harmonics(&self) -> &[f64] {
        &self.harmonics
    }
}

/// The length and rate of a simulation.
#[derive(Debug, Clone, Copy)]
pub(crate) struct VibrationPlan {
    periods: usize,
    teeth: usize,
    settings: RunSettings,
}

impl VibrationPlan {
    /// Simulates whole turns, or whole mesh periods of a gear with very many teeth.
    pub(crate) fn new(pair: &GearPair, torque_nm: f64, shaft_speed_hz: f64) -> Self {
        let teeth = pair.gears[0].teeth as usize;
        let periods = match (MAX_PERIODS / teeth).min(MAX_TURNS) {
            0 => MAX_PERIODS,
            turns => turns * teeth,
        };
        let mesh_hz = shaft_speed_hz * teeth as f64;
        let settings = RunSettings {
            shaft_speed_hz,
            torque_nm,
            ..RunSettings::nominal(pair, mesh_hz * SAMPLES_PER_PERIOD as f64, periods as f64 / mesh_hz)
        };
        Self { periods, teeth, settings }
    }

    pub(crate) fn simulate(&self, pair: &GearPair, cycle: &MeshCycle) -> Result<Vibration, GearError> {
        let mut record = simulate(pair, cycle, &self.settings)?;
        // Whole periods, so that lines need no window
        record.resize(self.periods * SAMPLES_PER_PERIOD, 0.0);
        let shown = self.shown_samples();
        let acceleration_m_per_s2 = record[..shown].iter().map(|sample| *sample as f32).collect();
        let rms_m_per_s2 =
            (record.iter().map(|sample| sample * sample).sum::<f64>() / record.len() as f64).sqrt();
        let amplitudes = amplitudes(&mut record);
        let last = (self.periods * (2 * HARMONICS + 1) / 2).min(amplitudes.len() - 1);
        Ok(Vibration {
            sample_rate_hz: self.settings.sample_rate_hz,
            acceleration_m_per_s2,
            rms_m_per_s2,
            order_step: self.teeth as f64 / self.periods as f64,
            spectrum_m_per_s2: amplitudes[..=last].iter().map(|amplitude| *amplitude as f32).collect(),
            harmonics: (1..=HARMONICS).map(|harmonic| amplitudes[harmonic * self.periods]).collect(),
        })
    }

    fn shown_samples(&self) -> usize {
        let turn = self.teeth * SAMPLES_PER_PERIOD;
        let whole = if turn <= SHOWN_SAMPLES { turn } else { SAMPLES_PER_PERIOD };
        let all = self.periods * SAMPLES_PER_PERIOD;
        (SHOWN_SAMPLES / whole).min(all / whole).min(2 * turn / whole) * whole
    }
}

/// Peak amplitudes from 0 to half of the sampling rate; the samples are overwritten.
fn amplitudes(samples: &mut [f64]) -> Vec<f64> {
    let length = samples.len();
    let plan = f64::forward_plan(length);
    let mut bins = plan.make_output_vec();
    if let Err(error) = plan.process(samples, &mut bins) {
        // The plan was made for this length
        tracing::error!(%error, "failed to transform a previewed vibration");
    }
    let scale = 2.0 / length as f64;
    bins.iter().map(|bin| bin.norm() * scale).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gear::PairSpec;

    fn pair(teeth: [u32; 2]) -> GearPair {
        let mut spec = PairSpec::from_toml(include_str!("../../../fixtures/pairs/shen2022.toml")).unwrap();
        (spec.geometry.teeth, spec.geometry.centre_distance_mm) = (teeth, None);
        spec.resolve().unwrap()
    }

    #[test]
    fn the_work_is_bounded_for_any_teeth() {
        for (teeth, periods, shown) in
            [([24, 26], 96, 2 * 24 * 64), ([100, 30], 200, 4096), ([1000, 30], 256, 4096)]
        {
            let plan = VibrationPlan::new(&pair(teeth), 100.0, 10.0);
            assert_eq!((plan.periods, plan.shown_samples()), (periods, shown), "{teeth:?}");
        }
    }

    #[test]
    fn a_sine_has_its_amplitude_at_its_bin() {
        let mut samples: Vec<f64> =
            (0..640).map(|n| 3.0 * (std::f64::consts::TAU * f64::from(n) / 64.0).sin()).collect();
        let found = amplitudes(&mut samples);
        assert!((found[10] - 3.0).abs() < 1e-9 && found[11] < 1e-9);
    }
}
