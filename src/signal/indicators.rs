//! Condition indicators of one record.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Why an indicator could not be computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Absence {
    /// The shaft speed is neither given nor found in the spectrum.
    NoSpeed,
    /// The record is too short to resolve what the indicator needs.
    TooShort,
    /// The samples do not vary.
    Constant,
    /// The frequency lies above half the sampling rate.
    AboveNyquist,
}

/// The condition indicators of one record by name; those that could not be computed are absent with a reason, never zero.
///
/// | name | definition | unit |
/// | --- | --- | --- |
/// | `rms` | √(Σx²/N), Eq. (32): the mean is **not** removed, a sensor that is not AC-coupled shows its offset here | the record's |
/// | `peak` | max\|x\|, the mean not removed | the record's |
/// | `crest_factor` | `peak`/`rms` | none |
/// | `kurtosis` | E[((x − μ)/σ)⁴], Eq. (32): population σ, not excess (Gaussian 3, sine 1.5) | none |
/// | `omx` | amplitude of the first mesh line: `mesh_1` | the record's |
/// | `mesh_h` | peak amplitude of the line at h × mesh frequency, h = 1 …: Hann window, amplitude-corrected, interpolated between bins | the record's |
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Indicators {
    /// Value by indicator name.
    #[serde(rename = "indicators")]
    pub values: BTreeMap<String, f64>,
    /// Reason by the name of an indicator that is missing.
    #[serde(default)]
    pub absent: BTreeMap<String, Absence>,
}

impl Indicators {
    /// Puts down a value or why there is none.
    pub(super) fn insert(&mut self, name: impl Into<String>, value: Result<f64, Absence>) {
        match value {
            Ok(value) => {
                self.values.insert(name.into(), value);
            }
            Err(absence) => {
                self.absent.insert(name.into(), absence);
            }
        }
    }

    /// The value of an indicator, where it could be computed.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.values.get(name).copied()
    }
}
