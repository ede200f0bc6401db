//! One simulated wear state.

use flankwatch_signal::{Features, Indicators};
use serde::{Deserialize, Serialize};

/// One simulated wear state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LibraryState {
    /// Index in the library, from 0 for unworn.
    pub index: usize,
    /// Greatest wear depth in µm.
    pub wear_um: f64,
    /// Turns of the driving gear to this wear, where it follows Archard's law.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub driving_turns: Option<f64>,
    /// Indicators of the simulated response.
    #[serde(flatten)]
    pub indicators: Indicators,
    /// Features of the simulated response.
    pub features: Features,
    /// Mesh stiffness and transmission error over one mesh period.
    pub cycle: CycleTable,
}

/// Mesh stiffness and transmission error over one mesh period. The four lists have one entry per position.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct CycleTable {
    /// Angle φ₁ of the driving tooth in rad.
    pub phi1_rad: Vec<f64>,
    /// Mesh stiffness in N/m.
    pub stiffness_n_per_m: Vec<f64>,
    /// Unloaded static transmission error in rad of the driven gear.
    pub uste_rad: Vec<f64>,
    /// Tooth pairs that carry the load.
    pub pairs_in_contact: Vec<u32>,
}
