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
/// Names and units: `rms`, `peak`, `omx` and `mesh_1` … `mesh_H` are in the record's unit; `kurtosis` and `crest_factor`
/// have none.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Indicators {
    /// Value by indicator name.
    pub values: BTreeMap<String, f64>,
    /// Reason by the name of an indicator that is missing.
    pub absent: BTreeMap<String, Absence>,
}

impl Indicators {
    /// The value of an indicator, where it could be computed.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.values.get(name).copied()
    }
}
