//! Condition indicators of one record.

use serde::{Deserialize, Serialize};

use super::band::{Band, BandQuantity};
use super::bearing;
use super::by_name::{ByName, Name};
use super::not_computed::NotComputed;
use super::velocity::VELOCITY_RMS;

/// Identifier of the method behind the indicators, and of its precision. Stored indicators with another
/// identifier are recomputed.
pub const INDICATORS: &str = "indicators-4";

/// The condition indicators of one record by name. Indicators that cannot be computed are omitted with a
/// reason, never zero.
///
/// | name | definition | unit |
/// | --- | --- | --- |
/// | `rms` | √(Σx²/N), Eq. (32): the mean is **not** removed, a sensor that is not AC-coupled shows its offset here | the record's |
/// | `peak` | max\|x\|, the mean not removed | the record's |
/// | `crest_factor` | `peak`/`rms` | none |
/// | `kurtosis` | E[((x − μ)/σ)⁴], Eq. (32): population σ, not excess (Gaussian 3, sine 1.5) | none |
/// | `omx` | amplitude of the first mesh line: `mesh_1` | the record's |
/// | `mesh_h` | peak amplitude of the line at h × mesh frequency, h = 1 …: Hann window, amplitude-corrected, interpolated between bins | the record's |
/// | `velocity_rms` | root mean square of the velocity from 10 to 1000 Hz, as in ISO 20816; of records of at least 0.5 s | mm/s |
/// | `bearing_…_bpfo`, `_bpfi`, `_bsf`, `_ftf` | for each configured bearing: root sum square of the first three harmonics of the frequency in the envelope spectrum | the record's |
/// | `bearing_…_to_background` | for the same lines: root mean square of the ratios of amplitude to noise amplitude in one bin; about 1 in noise | none |
/// | `band_…` | root mean square of a band that the user defines: see [`Band`](super::Band) | the record's, or mm/s |
///
/// Over the angle of the driving shaft, by [`Analyzer::condition`](super::Analyzer::condition): x
/// is the synchronous average over at least 4 turns, its mean removed, g its regular signal (shaft orders 1
/// and 2, all mesh harmonics), r = x − g the residual, d the difference (r without the first-order sidebands
/// of every mesh harmonic), z the number of teeth, A(k) the amplitude of x at shaft order k.
///
/// | name | definition | unit |
/// | --- | --- | --- |
/// | `omx_tracked` | the first mesh line in the Hann spectrum over orders of all turns, read as `mesh_1` | the record's |
/// | `sideband_energy_ratio` | Σ_{k=1..6} (A(z − k) + A(z + k)) / A(z) | none |
/// | `sideband_level_factor` | (A(z − 1) + A(z + 1)) / σ(x) | none |
/// | `fm0` | (max x − min x) / Σ_{h=1..H} A(hz), H = 10 or as far as 0.42 of the sampling rate (Stewart 1977) | none |
/// | `fm4`, `m6a`, `m8a` | E\[d⁴\]/E\[d²\]², E\[d⁶\]/E\[d²\]³, E\[d⁸\]/E\[d²\]⁴: Gaussian 3, 15, 105 (Martin 1989) | none |
/// | `energy_ratio` | σ(d)/σ(g); some authors divide by the sidebands too | none |
/// | `residual_variance`, `residual_fourth_moment` | E\[r²\], E\[r⁴\]: the inputs of NA4 (see [`RunMean`](super::RunMean)) | the record's², ⁴ |
/// | `na4`, `nb4` | E\[r⁴\] over the squared mean of E\[r²\] of all records of the channel up to this one (Zakrajsek 1994), for the residual and for the mesh line's envelope: by [`RunMeans`](super::RunMeans), not from one record alone | none |
/// | `novelty` | −log₁₀ of the probability that a record of the best-fitting wear state deviates as much as this one: from the estimate, not from one record alone | none |
/// | `mesh_envelope_variance`, `mesh_envelope_fourth_moment` | the same moments of the envelope of orders z − 6 to z + 6, its mean removed: the inputs of NB4 | the record's², ⁴ |
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Indicators {
    /// Value by indicator name.
    #[serde(rename = "indicators")]
    #[cfg_attr(feature = "openapi", schema(value_type = std::collections::BTreeMap<String, f64>))]
    pub values: ByName<f64>,
    /// Reason by the name of an indicator that could not be computed.
    #[serde(default)]
    #[cfg_attr(feature = "openapi", schema(value_type = std::collections::BTreeMap<String, NotComputed>))]
    pub absent: ByName<NotComputed>,
}

impl Indicators {
    /// Inserts a value or the reason why there is none.
    pub(super) fn insert(&mut self, name: impl Into<Name>, value: Result<f64, NotComputed>) {
        match value {
            Ok(value) => self.values.insert(name, value),
            Err(reason) => self.absent.insert(name, reason),
        }
    }

    /// Adds `others`, which replace entries of the same name.
    pub fn extend(&mut self, others: Indicators) {
        for name in others.values.keys() {
            self.absent.remove(name);
        }
        for name in others.absent.keys() {
            self.values.remove(name);
        }
        self.values.extend(others.values);
        self.absent.extend(others.absent);
    }

    /// Returns the unit of an indicator of a record in `unit`, `"1"` if it is dimensionless. `bands` are the
    /// user-defined ones.
    pub fn unit(name: &str, unit: &str, bands: &[Band]) -> String {
        const DIMENSIONLESS: [&str; 12] = [
            "novelty",
            "kurtosis",
            "crest_factor",
            "sideband_energy_ratio",
            "sideband_level_factor",
            "fm0",
            "fm4",
            "m6a",
            "m8a",
            "energy_ratio",
            "na4",
            "nb4",
        ];
        let is_velocity = |band: &Band| band.quantity == BandQuantity::Velocity && band.indicator() == name;
        if DIMENSIONLESS.contains(&name) || bearing::is_ratio(name) {
            "1".to_owned()
        } else if name.ends_with("_variance") {
            format!("({unit})^2")
        } else if name.ends_with("_fourth_moment") {
            format!("({unit})^4")
        } else if name == VELOCITY_RMS || bands.iter().any(is_velocity) {
            "mm/s".to_owned()
        } else {
            unit.to_owned()
        }
    }

    /// Returns the value of an indicator, if it could be computed.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.values.get(name).copied()
    }
}
