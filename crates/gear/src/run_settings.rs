//! Settings of one run of a pair.

use super::error::{positive, within};
use super::{GearError, GearPair};

/// Largest number of samples of one run.
const MAX_SAMPLES: f64 = 1e8;

/// Settings of one run, which differ from record to record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RunSettings {
    /// Sampling rate in hertz.
    pub sample_rate_hz: f64,
    /// Duration in seconds.
    pub seconds: f64,
    /// Rotational frequency f₁ of the driving gear in hertz.
    pub shaft_speed_hz: f64,
    /// Torque T₁ on the driving gear in N·m; the driven torque follows in the pair's ratio.
    pub torque_nm: f64,
    /// Seed of the random error.
    pub seed: u64,
    /// Angle of the driving shaft at the first sample in turns; at 0 a tooth pair is at its nominal start of
    /// contact and both sines of Eq. (26) are zero.
    pub start_phase_turns: f64,
}

impl RunSettings {
    /// Returns a run at the pair's own torque, speed and seed from angle 0.
    pub fn nominal(pair: &GearPair, sample_rate_hz: f64, seconds: f64) -> Self {
        Self {
            sample_rate_hz,
            seconds,
            shaft_speed_hz: pair.spec.operation.shaft_speed_hz,
            torque_nm: pair.spec.operation.torque_nm,
            seed: pair.spec.errors.seed,
            start_phase_turns: 0.0,
        }
    }

    pub(super) fn check(&self) -> Result<(), GearError> {
        positive("sample_rate_hz", self.sample_rate_hz, 1e8)?;
        positive("seconds", self.seconds, 1e8)?;
        positive("shaft_speed_hz", self.shaft_speed_hz, 1e4)?;
        positive("torque_nm", self.torque_nm, 1e9)?;
        within("start_phase_turns", self.start_phase_turns, -1e6, 1e6)?;
        within("seconds × sample_rate_hz", self.seconds * self.sample_rate_hz, 1.0, MAX_SAMPLES)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::shen2022;
    use super::RunSettings;
    use crate::{FlankWear, MeshCycle, simulate};

    #[test]
    fn invalid_settings_are_rejected() {
        let pair = shen2022();
        let cycle = MeshCycle::compute(&pair, &FlankWear::none(), 1000).unwrap();
        let run = RunSettings::nominal(&pair, 20_000.0, 0.1);
        let cases = [
            ("sample_rate_hz", RunSettings { sample_rate_hz: f64::NAN, ..run }),
            ("seconds", RunSettings { seconds: 0.0, ..run }),
            ("seconds × sample_rate_hz", RunSettings { seconds: 1e7, ..run }),
            ("shaft_speed_hz", RunSettings { shaft_speed_hz: -1.0, ..run }),
            ("torque_nm", RunSettings { torque_nm: 0.0, ..run }),
            ("start_phase_turns", RunSettings { start_phase_turns: f64::INFINITY, ..run }),
        ];
        for (field, run) in cases {
            let refusal = simulate(&pair, &cycle, &run).unwrap_err().to_string();
            assert!(refusal.starts_with(&format!("{field} is ")), "{refusal}");
        }
    }
}
