//! The grid of simulated wear states and operating points, and its file format.
//!
//! A [`Library`] is simulated once for a gear pair and stored in a [`LibraryCache`] under the hash of
//! everything that it depends on.

mod build;
#[cfg(feature = "files")]
mod cache;
#[cfg(feature = "files")]
mod checkpoint;
mod control;
mod ensemble;
mod error;
mod file;
mod grid;
mod operating;
mod part;
mod state;
#[cfg(test)]
pub(crate) mod testing;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

pub use build::{build, library_id, response_record};
#[cfg(feature = "files")]
pub use cache::{LibraryCache, build_into, save_library};
#[cfg(feature = "files")]
pub use checkpoint::checkpoint_path;
pub use control::BuildControl;
pub use ensemble::{
    DEPTHS, Ensemble, EnsembleSettings, FIRST_MEMBERS, FlankPlace, MESH_LINES, Member, REPORTED, VARIANTS,
    decode_ensemble, encode_ensemble, ensemble_id,
};
pub(crate) use ensemble::{DepthChanges, LANES, Lanes, end_um, line_name};
pub use error::LibraryError;
pub use file::{FORMAT_VERSION, decode, encode};
pub use grid::GridSettings;
pub use state::{CycleTable, LibraryState};

use operating::FeatureCurves;

use flankwatch_gear::{ContactRule, PairSpec};
use flankwatch_signal::OperatingPoint;

/// Identity and inputs of a library.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// The library's id: a hash of everything below.
    pub id: String,
    /// The gear model's version.
    pub model_version: String,
    /// Identifier of the features' preprocessing.
    pub preprocessing: String,
    /// The gear pair.
    pub pair: PairSpec,
    /// The grid.
    pub grid: GridSettings,
}

impl Manifest {
    /// Returns the rule for which pairs of teeth carry the load.
    pub fn contact(&self) -> ContactRule {
        self.pair.dynamics.contact
    }
}

/// A grid of simulated wear states of one gear pair. It holds full states at the nominal operating point, and
/// features at the others.
#[derive(Debug, Clone, PartialEq)]
pub struct Library {
    manifest: Manifest,
    states: Vec<LibraryState>,
    /// Feature curves for each torque and, within it, each speed.
    tables: Vec<FeatureCurves>,
}

impl Library {
    /// Creates a library from states in rising order of wear, from unworn, and tables by torque and speed.
    fn from_parts(manifest: Manifest, states: Vec<LibraryState>, tables: Vec<FeatureCurves>) -> Self {
        Self { manifest, states, tables }
    }

    /// Returns the library's id, a hash of everything that it depends on.
    pub fn id(&self) -> &str {
        &self.manifest.id
    }

    /// Returns the inputs of the library.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Returns the gear pair.
    pub fn pair(&self) -> &PairSpec {
        &self.manifest.pair
    }

    /// Returns the states at the nominal operating point in rising order of wear.
    pub fn states(&self) -> &[LibraryState] {
        &self.states
    }

    /// Returns the greatest wear depth of the last state in µm.
    pub fn max_wear_um(&self) -> f64 {
        self.states.last().map_or(0.0, |state| state.wear_um)
    }

    /// Returns the change of one of the [checks](flankwatch_signal::Features::checks) from the unworn state
    /// at a depth in µm, interpolated linearly between the states and constant beyond the ends; `None` where
    /// a state lacks the check.
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

    /// Returns the curves over the states of the features that all have, at the nominal operating point.
    pub fn feature_curves(&self) -> BTreeMap<&str, Vec<f64>> {
        self.feature_curves_at(&OperatingPoint::default())
    }

    /// Returns the feature curves at an operating point, interpolated linearly over torque and speed between
    /// the grid's points and constant beyond its ends. A torque or speed that is not given is nominal.
    /// Features that a surrounding grid point lacks (a harmonic above half the sampling rate) are excluded.
    pub fn feature_curves_at(&self, point: &OperatingPoint) -> BTreeMap<&str, Vec<f64>> {
        operating::at(&self.manifest.grid, self.pair(), &self.tables, point)
    }
}
