//! The feature vector that measured and simulated records are compared by.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Features of one record by name, each on a scale where an unknown gain is an offset (natural logarithms of amplitudes)
/// and changes relative to a healthy baseline are differences.
///
/// A feature that the record cannot give (a harmonic above half the sampling rate) is missing from the map.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Features {
    /// Value by feature name, for example `ln_mesh_1`.
    pub values: BTreeMap<String, f64>,
}
