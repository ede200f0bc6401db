//! The shaft speed of a record: given with it, or found from its mesh comb.

use serde::{Deserialize, Serialize};

/// What is known of the mesh before a record is looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeshContext {
    /// Teeth on the shaft whose speed is meant (the driving gear, the pinion).
    pub teeth: u32,
    /// That shaft's nominal rotational frequency in hertz.
    pub nominal_shaft_speed_hz: f64,
    /// How far from nominal the speed may be, as a fraction (0.05 for ± 5 %).
    pub tolerance: f64,
    /// Whether the nominal speed is exact, so that no search is needed.
    pub nominal_is_exact: bool,
}

/// Where a shaft speed came from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SpeedSource {
    /// Given with the record.
    Record,
    /// The asset's nominal speed, declared exact.
    Asset,
    /// Found from the comb of mesh harmonics within the tolerance around nominal.
    MeshComb,
}

/// A record's shaft speed and where it came from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ShaftSpeed {
    /// Rotational frequency of the driving shaft in hertz.
    pub shaft_speed_hz: f64,
    /// Where it came from.
    pub source: SpeedSource,
    /// Mesh frequency in hertz: teeth × shaft speed.
    pub mesh_frequency_hz: f64,
    /// How far the comb stands above the background, as a ratio of amplitudes; `None` where no comb was looked for.
    pub comb_to_background: Option<f64>,
}
