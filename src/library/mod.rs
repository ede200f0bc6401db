//! The grid of simulated wear states: its building and its file format.
//!
//! A [`Library`] is simulated once for a gear pair and kept on a [`LibraryShelf`] under the hash of everything that it depends on.

mod build;
mod file;
mod shelf;
#[cfg(test)]
pub(crate) mod testing;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use build::{build, library_id};
pub use file::{FORMAT_VERSION, decode, encode};
pub use shelf::{LibraryShelf, keep};

use crate::gear::{ContactRule, GearError, PairSpec};
use crate::signal::{Features, Indicators, RecordError};

/// The grid of wear states and how each is simulated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GridSettings {
    /// Number of wear states, equally spaced from unworn to `max_wear_um`.
    pub states: usize,
    /// Greatest wear depth of the last state in µm.
    pub max_wear_um: f64,
    /// Length of each simulated record in seconds.
    pub seconds: f64,
    /// Sampling rate of each simulated record in hertz.
    pub sample_rate_hz: f64,
    /// Seed of the random error.
    pub seed: u64,
}

impl Default for GridSettings {
    /// The paper's grid: 50 states of 5 µm from 0 to 0.245 mm.
    fn default() -> Self {
        Self {
            states: 50,
            max_wear_um: 245.0,
            seconds: 2.0,
            sample_rate_hz: 20_000.0,
            seed: 1,
        }
    }
}

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

/// A grid of simulated wear states of one gear pair.
#[derive(Debug, Clone, PartialEq)]
pub struct Library {
    manifest: Manifest,
    states: Vec<LibraryState>,
}

impl Library {
    /// Puts a library together; states in rising order of wear, the first unworn.
    pub(crate) fn from_parts(manifest: Manifest, states: Vec<LibraryState>) -> Self {
        Self { manifest, states }
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

    /// The states in rising order of wear.
    pub fn states(&self) -> &[LibraryState] {
        &self.states
    }

    /// Greatest wear depth of the last state in µm.
    pub fn max_wear_um(&self) -> f64 {
        self.states.last().map_or(0.0, |state| state.wear_um)
    }

    /// Features that every state has, with their values over the states.
    pub fn feature_curves(&self) -> BTreeMap<&str, Vec<f64>> {
        let Some(first) = self.states.first() else { return BTreeMap::new() };
        first
            .features
            .values
            .keys()
            .filter_map(|name| {
                let curve: Option<Vec<f64>> = self.states.iter().map(|state| state.features.values.get(name).copied()).collect();
                Some((name.as_str(), curve?))
            })
            .collect()
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
        value: f64,
        /// What would have been right.
        expected: &'static str,
    },
    /// The gear model refused the pair.
    #[error("the gear pair cannot be simulated: {0}")]
    Gear(#[from] GearError),
    /// The model's response is not a usable record.
    #[error("the simulated response of wear state {index} is not usable: {source}")]
    Response {
        /// The state.
        index: usize,
        /// What is wrong with it.
        source: RecordError,
    },
    /// The file is not a library, or not the one that was written.
    #[error("damaged library file: {0}")]
    Damaged(String),
    /// The file was written by a newer version.
    #[error("library format version {found}, expected {FORMAT_VERSION}")]
    Version {
        /// The version found.
        found: u32,
    },
    /// The file system refused.
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: std::path::PathBuf,
        /// What it said.
        source: std::io::Error,
    },
}
