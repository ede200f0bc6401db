//! Indicators of the signals over the shaft angle, and the run means that NA4 and NB4 are relative to.

use serde::{Deserialize, Serialize};

use super::by_name::Name;
use super::gear_signals::GearSignals;
use super::indicators::Indicators;
use super::not_computed::NotComputed;
use super::shaft_angle::AngleSource;

/// Names of all indicators over the shaft angle.
pub(super) const NAMES: [&str; 12] = [
    "omx_tracked",
    "sideband_energy_ratio",
    "sideband_level_factor",
    "fm0",
    "fm4",
    "m6a",
    "m8a",
    "energy_ratio",
    "residual_variance",
    "residual_fourth_moment",
    "mesh_envelope_variance",
    "mesh_envelope_fourth_moment",
];

/// Below this fraction of the average's standard deviation, a signal is rounding of 32-bit samples and
/// transforms.
const ROUNDING: f64 = 1e-7;

/// The shaft angle that a record was analysed over.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct AngleUsed {
    /// Its source and accuracy.
    #[serde(flatten)]
    pub source: AngleSource,
    /// Number of whole turns averaged.
    pub turns: usize,
    /// Why the record's tachometer, if it has one, was not used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tachometer_refused: Option<String>,
}

impl Indicators {
    /// Inserts one reason for which all indicators over the shaft angle are missing.
    pub(super) fn insert_no_angle(&mut self, reason: NotComputed) {
        for name in NAMES {
            self.insert(Name::new_static(name), Err(reason));
        }
    }

    /// Inserts the indicators of a split average and of the mesh line over all turns, with H mesh harmonics
    /// in FM0.
    pub(super) fn insert_over_angle(
        &mut self,
        signals: &GearSignals,
        tracked: Result<f64, NotComputed>,
        harmonics: usize,
    ) {
        self.insert("omx_tracked", tracked);
        let deviation = mean_power(&signals.average, 2).sqrt();
        let ratio = |above: Option<f64>, below: Option<f64>| match (above, below) {
            (Some(above), Some(below)) if below > ROUNDING * deviation => Ok(above / below),
            (Some(_), Some(_)) => Err(NotComputed::NoSignal),
            _ => Err(NotComputed::AboveNyquist),
        };
        let first = signals.mesh_line(1);
        self.insert("sideband_energy_ratio", ratio(signals.sideband_sum(), first));
        self.insert("sideband_level_factor", ratio(signals.first_sidebands(), Some(deviation)));
        let (low, high) = signals
            .average
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &x| (low.min(x), high.max(x)));
        let lines: f64 = (1..=harmonics).map_while(|order| signals.mesh_line(order)).sum();
        self.insert("fm0", ratio(Some(high - low), Some(lines)));
        let difference = mean_power(&signals.difference, 2);
        for (name, power) in [("fm4", 4), ("m6a", 6), ("m8a", 8)] {
            let moment = if difference.sqrt() > ROUNDING * deviation {
                Ok(mean_power(&signals.difference, power) / difference.powi(power / 2))
            } else {
                Err(NotComputed::NoSignal)
            };
            self.insert(name, moment);
        }
        let regular = mean_power(&signals.regular, 2).sqrt();
        self.insert("energy_ratio", ratio(Some(difference.sqrt()), Some(regular)));
        self.insert("residual_variance", Ok(mean_power(&signals.residual, 2)));
        self.insert("residual_fourth_moment", Ok(mean_power(&signals.residual, 4)));
        self.insert("mesh_envelope_variance", Ok(mean_power(&signals.mesh_envelope, 2)));
        self.insert(
            Name::new_static("mesh_envelope_fourth_moment"),
            Ok(mean_power(&signals.mesh_envelope, 4)),
        );
    }
}

/// The mean of a signal's variance over the records of a run: the state of NA4 (Zakrajsek 1994) and of NB4,
/// one per channel. It survives a round trip through JSON bit for bit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct RunMean {
    records: u64,
    variances: f64,
}

impl RunMean {
    /// Adds a record with E\[r²\] and E\[r⁴\] of its signal, in time order. Returns E\[r⁴\] / (mean of
    /// E\[r²\] over the run including this record)², which equals N·Σr⁴/(mean of Σr²)² if all records have
    /// the same number of samples per turn. Values that are not finite are ignored.
    pub fn update(&mut self, variance: f64, fourth_moment: f64) -> Result<f64, NotComputed> {
        let usable = variance >= 0.0 && variance.is_finite() && fourth_moment.is_finite();
        if !usable {
            return Err(NotComputed::NoSignal);
        }
        self.records += 1;
        self.variances += variance;
        let mean = self.variances / self.records as f64;
        let value = fourth_moment / (mean * mean);
        if value.is_finite() { Ok(value) } else { Err(NotComputed::NoSignal) }
    }

    /// Returns the number of records added.
    pub fn records(&self) -> u64 {
        self.records
    }
}

/// The state of NA4 and NB4 of one channel.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct RunMeans {
    residual: RunMean,
    mesh_envelope: RunMean,
}

impl RunMeans {
    /// Adds the indicators of one record, in time order. Returns `na4` and `nb4` or why they are missing;
    /// empty if the indicators over the shaft angle were not requested.
    pub fn update(&mut self, indicators: &Indicators) -> Indicators {
        let mut result = Indicators::default();
        for (name, run, signal) in
            [("na4", &mut self.residual, "residual"), ("nb4", &mut self.mesh_envelope, "mesh_envelope")]
        {
            let (variance, fourth) = (format!("{signal}_variance"), format!("{signal}_fourth_moment"));
            match (indicators.get(&variance), indicators.get(&fourth), indicators.absent.get(&variance)) {
                (Some(variance), Some(fourth), _) => result.insert(name, run.update(variance, fourth)),
                (_, _, Some(&reason)) => result.insert(name, Err(reason)),
                _ => {}
            }
        }
        result
    }
}

/// Mean of an even power of a zero-mean signal, in short partial sums to limit rounding.
fn mean_power(signal: &[f64], power: i32) -> f64 {
    let sums = signal.chunks(64).map(|chunk| chunk.iter().map(|x| x.powi(power)).sum::<f64>());
    sums.sum::<f64>() / signal.len() as f64
}
