//! The grid of simulated wear states and operating points: its building and its file format.
//!
//! A [`Library`] is simulated once for a gear pair and kept on a [`LibraryCache`] under the hash of
//! everything that it depends on.

mod build;
#[cfg(feature = "files")]
mod cache;
#[cfg(feature = "files")]
mod checkpoint;
mod control;
mod ensemble;
mod file;
mod grid;
mod operating;
mod part;
#[cfg(test)]
pub(crate) mod testing;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use build::{build, library_id};
#[cfg(feature = "files")]
pub use cache::{LibraryCache, build_into, save_library};
#[cfg(feature = "files")]
pub use checkpoint::checkpoint_path;
pub use control::BuildControl;
pub use ensemble::{
    DEPTHS, Ensemble, EnsembleSettings, FIRST_MEMBERS, FlankPlace, MESH_LINES, Member, VARIANTS,
    decode_ensemble, encode_ensemble, ensemble_id,
};
pub(crate) use ensemble::{LANES, Lanes, line_name};
pub use file::{FORMAT_VERSION, decode, encode};
pub use grid::{GridSettings, OperatingRange};

use operating::FeatureCurves;

use flankwatch_gear::{ContactRule, GearError, PairSpec};
use flankwatch_signal::{Features, Indicators, OperatingPoint, RecordError};

/// What a library is and what it was made from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Hash of everything below: the library's name.
    pub id: String,
    /// The gear model's version.
    pub model_version: String,
    /// The features' preprocessing.
    pub preprocessing: String,
    /// The gear pair.
    pub pair: PairSpec,
    /// The grid.
    pub grid: GridSettings,
}

impl Manifest {
    /// Which pairs of teeth were taken to carry the load.
    pub fn contact(&self) -> ContactRule {
        self.pair.dynamics.contact
    }
}

/// One simulated wear state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LibraryState {
    /// Index in the library, from 0 for unworn.
    pub index: usize,
    /// Greatest wear depth in µm.
    pub wear_um: f64,
    /// Turns of the driving gear that this wear took, where Archard's law shaped it.
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

/// Mesh stiffness and transmission error over one mesh period; the four lists have one entry a position.
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

/// A grid of simulated wear states of one gear pair. Its states are those at the nominal operating point; of
/// the grid's others it has the features.
#[derive(Debug, Clone, PartialEq)]
pub struct Library {
    manifest: Manifest,
    states: Vec<LibraryState>,
    /// For each torque and, within it, each speed.
    tables: Vec<FeatureCurves>,
}

impl Library {
    /// Puts a library together; states in rising order of wear, the first unworn; tables by torque and speed.
    fn from_parts(manifest: Manifest, states: Vec<LibraryState>, tables: Vec<FeatureCurves>) -> Self {
        Self { manifest, states, tables }
    }

    /// Hash of everything the library depends on.
    pub fn id(&self) -> &str {
        &self.manifest.id
    }

    /// What the library was made from.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The gear pair.
    pub fn pair(&self) -> &PairSpec {
        &self.manifest.pair
    }

    /// The states at the nominal operating point in rising order of wear.
    pub fn states(&self) -> &[LibraryState] {
        &self.states
    }

    /// Greatest wear depth of the last state in µm.
    pub fn max_wear_um(&self) -> f64 {
        self.states.last().map_or(0.0, |state| state.wear_um)
    }

    /// How far a value that wear hardly moves ([`Features::checks`]) has moved from unworn at a depth in µm,
    /// linear between the states and held at the ends; `None` where a state lacks it.
    pub fn check_change(&self, name: &str, wear_um: f64) -> Option<f64> {
        let value = |index: usize| self.states.get(index)?.features.checks.get(name).copied();
        let upper = self.states.partition_point(|state| state.wear_um <= wear_um);
        let at = if upper == 0 || upper == self.states.len() {
            value(upper.saturating_sub(1))?
        } else {
            let (before, after) = (self.states[upper - 1].wear_um, self.states[upper].wear_um);
            let part = (wear_um - before) / (after - before);
            value(upper - 1)? * (1.0 - part) + value(upper)? * part
        };
        Some(at - value(0)?)
    }

    /// Features that every state has, with their values over the states, at the nominal operating point.
    pub fn feature_curves(&self) -> BTreeMap<&str, Vec<f64>> {
        self.feature_curves_at(&OperatingPoint::default())
    }

    /// The same at an operating point: interpolated linearly over torque and over speed between the grid's
    /// points, and held at the grid's ends. Torque or speed that the point does not say are nominal. Left out
    /// are features that a grid point around it does not have (a harmonic above half the sampling rate).
    pub fn feature_curves_at(&self, point: &OperatingPoint) -> BTreeMap<&str, Vec<f64>> {
        operating::at(&self.manifest.grid, self.pair(), &self.tables, point)
    }

    /// Whether an operating point lies within the grid's torques and speeds, so that
    /// [`Library::feature_curves_at`] need not hold it at an end. A library of the nominal point alone covers
    /// no other.
    pub fn covers(&self, point: &OperatingPoint) -> bool {
        operating::covers(&self.manifest.grid, self.pair(), point)
    }

    /// Torques and speeds that the grid spans.
    pub fn operating_range(&self) -> OperatingRange {
        self.manifest.grid.operating_range(self.pair())
    }
}

/// Why a library could not be built, read or kept.
#[derive(Debug, Error)]
pub enum LibraryError {
    /// A number of the grid cannot be used.
    #[error("library {field} is {value}, expected {expected}")]
    Grid {
        /// Which number.
        field: &'static str,
        /// Its value.
        value: String,
        /// What would have been right.
        expected: &'static str,
    },
    /// The gear model refused the pair.
    #[error("the gear pair cannot be simulated: {0}")]
    Gear(#[source] GearError),
    /// The model's response is not a usable record.
    #[error("the simulated response of wear state {index} is not usable: {source}")]
    Response {
        /// The state.
        index: usize,
        /// What is wrong with it.
        source: RecordError,
    },
    /// It was told to stop.
    #[error("stopped before the library was complete")]
    Cancelled,
    /// The file is not a library, or not the one that was written.
    #[error("damaged library file: {0}")]
    Damaged(String),
    /// The file was written by another version.
    #[error("library format version {found}, expected {FORMAT_VERSION}")]
    Version {
        /// The version found.
        found: u32,
    },
    /// The file system refused.
    #[cfg(feature = "files")]
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: std::path::PathBuf,
        /// What it said.
        source: std::io::Error,
    },
}

impl From<GearError> for LibraryError {
    fn from(error: GearError) -> Self {
        match error {
            GearError::Stopped => Self::Cancelled,
            error => Self::Gear(error),
        }
    }
}
