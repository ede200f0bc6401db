//! The ensemble: pairs drawn around the described one, each worn from new to the library's last depth.
//!
//! One library gives the effect of one shape of wear on one pair. The mesh damping, the stiffness of the
//! bodies, the small errors of the teeth and the place of the deepest wear are not known of a real machine;
//! each of them affects how the mesh lines change with depth. The estimate therefore compares a record with
//! many drawn pairs (see [`prior`]) and lets the records weight them.

mod depths;
mod file;
mod line_changes;
mod member;
mod prior;

use std::sync::Arc;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::control::Counter;
use super::file::hex;
use super::{BuildControl, Library, LibraryError};
use flankwatch_gear::MODEL_VERSION;

use depths::depths_um;
pub(crate) use depths::end_um;
pub use depths::{DEPTHS, REPORTED};
pub use file::{decode_ensemble, encode_ensemble};
use line_changes::LineChanges;
pub use line_changes::MESH_LINES;
pub(crate) use line_changes::{DepthChanges, LANES, Lanes};
use member::Simulated;
pub(crate) use member::line_name;
pub use member::{FlankPlace, Member, VARIANTS};

/// Members used for provisional estimates while the rest are simulated.
pub const FIRST_MEMBERS: usize = 96;

/// Version of the prior; it changes when other pairs are drawn, or when they are simulated differently.
const PRIOR_VERSION: &str = "prior-9";

/// Size of the ensemble.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EnsembleSettings {
    /// Number of drawn pairs; 0 for the described pair alone.
    pub members: usize,
}

impl Default for EnsembleSettings {
    fn default() -> Self {
        Self { members: 1280 }
    }
}

impl EnsembleSettings {
    /// Settings for the described pair alone.
    pub fn described_alone() -> Self {
        Self { members: 0 }
    }

    /// Settings for the first members of this ensemble, which are simulated in seconds.
    #[must_use]
    pub fn first(self) -> Self {
        Self { members: self.members.min(FIRST_MEMBERS) }
    }
}

/// Possible pairs of a machine, each simulated at a series of wear depths.
#[derive(Debug, Clone)]
pub struct Ensemble {
    id: String,
    described: Arc<Library>,
    depths_um: Vec<f64>,
    members: Vec<Member>,
    changes: LineChanges,
}

/// Returns the id of an ensemble: a hash of everything that it depends on.
pub fn ensemble_id(library_id: &str, settings: &EnsembleSettings) -> String {
    let inputs = format!("{library_id} {MODEL_VERSION} {PRIOR_VERSION} {}", settings.members);
    hex(inputs.as_bytes())[..16].to_owned()
}

impl Ensemble {
    /// Creates an ensemble with the described library as the only member.
    pub fn of(library: Arc<Library>) -> Self {
        let id = ensemble_id(library.id(), &EnsembleSettings::described_alone());
        let described = Simulated::described(&library, &depths_um(library.max_wear_um()));
        Self::from_members(id, library, vec![described])
    }

    fn from_members(id: String, described: Arc<Library>, members: Vec<Simulated>) -> Self {
        let (members, changes): (Vec<Member>, Vec<Vec<f32>>) =
            members.into_iter().map(|Simulated { member, changes }| (member, changes)).unzip();
        let depths_um = depths_um(described.max_wear_um());
        let changes = LineChanges::of(&changes, variants(&members));
        Self { id, described, depths_um, members, changes }
    }

    /// Returns the members with the changes of their lines.
    fn simulated(&self) -> impl Iterator<Item = Simulated> {
        let both = self.members.iter().cloned().zip(self.changes.tables());
        both.map(|(member, changes)| Simulated { member, changes })
    }

    /// Draws and simulates the members, in parallel. The result depends on the library and the settings
    /// alone. The members of a smaller ensemble of the same library are the first ones of a larger ensemble.
    ///
    /// Drawn pairs that cannot be simulated are skipped.
    ///
    /// # Errors
    /// [`LibraryError::Cancelled`]; [`LibraryError::Gear`] of the first pair where none can be simulated.
    pub fn build(
        library: Arc<Library>,
        settings: &EnsembleSettings,
        control: &BuildControl<'_>,
    ) -> Result<Self, LibraryError> {
        Self::of(Arc::clone(&library)).extended(settings, control)
    }

    /// Returns the ensemble with these settings, reusing the members of this one.
    ///
    /// # Errors
    /// As [`Ensemble::build`].
    pub fn extended(
        &self,
        settings: &EnsembleSettings,
        control: &BuildControl<'_>,
    ) -> Result<Self, LibraryError> {
        let described = Arc::clone(&self.described);
        if settings.members == 0 {
            return Ok(Self::of(described));
        }
        let mut members: Vec<Simulated> =
            self.simulated().filter(|simulated| simulated.member.draw.is_some()).collect();
        let first =
            members.iter().filter_map(|simulated| simulated.member.draw).max().map_or(0, |last| last + 1);
        let groups = settings.members.div_ceil(VARIANTS);
        let counter = Counter::new(control, groups.saturating_sub(first));
        let drawn: Vec<Result<Vec<Simulated>, LibraryError>> = (first..groups)
            .into_par_iter()
            .map(|draw| {
                control.check()?;
                let group = Simulated::drawn(self.described.pair(), draw, &self.depths_um);
                counter.add(1);
                group.map_err(LibraryError::from)
            })
            .collect();
        let mut refused = None;
        for group in drawn {
            match group {
                Ok(group) => members.extend(group),
                Err(LibraryError::Cancelled) => return Err(LibraryError::Cancelled),
                Err(error) => refused = refused.or(Some(error)),
            }
        }
        match refused {
            Some(error) if members.is_empty() => Err(error),
            _ => Ok(Self::from_members(ensemble_id(described.id(), settings), described, members)),
        }
    }

    /// Returns the ensemble's id, a hash of everything that it depends on.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Returns the library of the pair as it is described.
    pub fn described(&self) -> &Arc<Library> {
        &self.described
    }

    /// Returns the depths in µm at which the members are simulated, from 0 to beyond the library's end, which
    /// is number [`REPORTED`] of them.
    pub fn depths_um(&self) -> &[f64] {
        &self.depths_um
    }

    /// Returns the members, which are equally probable a priori.
    pub fn members(&self) -> &[Member] {
        &self.members
    }

    /// Returns the change of line `line` (0 is the first mesh harmonic) of a member at a depth index: the
    /// natural logarithm of its amplitude over that of the unworn pair; NaN where it is not known.
    pub fn change(&self, member: usize, line: usize, depth: usize) -> f32 {
        self.changes.at(member, line, depth)
    }

    /// Returns the number of groups of members.
    pub fn groups(&self) -> usize {
        self.members.len() / self.variants()
    }

    /// Returns the number of blocks of members side by side. A block has one variant of each of [`LANES`]
    /// groups; the blocks of all variants of these groups follow each other.
    pub(crate) fn blocks(&self) -> usize {
        self.changes.blocks()
    }

    /// Returns the member in a lane of a block. Unused lanes of the last blocks repeat the last group.
    pub(crate) fn member_in(&self, block: usize, lane: usize) -> usize {
        self.changes.member(block, lane)
    }

    /// Returns a member's block and lane.
    pub(crate) fn place_of(&self, member: usize) -> (usize, usize) {
        self.changes.place(member)
    }

    /// Returns the changes of a block's members, by depth and line.
    pub(crate) fn changes_side_by_side(&self, block: usize) -> &[DepthChanges; DEPTHS] {
        self.changes.block(block)
    }

    /// Whether these are the first members of an ensemble with these settings.
    pub fn is_part_of(&self, settings: &EnsembleSettings) -> bool {
        self.variants() > 1 && self.id != ensemble_id(self.described.id(), settings)
    }

    /// Number of consecutive members that form a group with the same gears and the same wear.
    pub fn variants(&self) -> usize {
        variants(&self.members)
    }

    /// Returns the ensemble without one group of members, for scoring the estimate on one of them.
    #[must_use]
    pub fn without_group(&self, group: usize) -> Self {
        let without = group * self.variants()..(group + 1) * self.variants();
        let others = self.simulated().enumerate().filter(|(member, _)| !without.contains(member));
        let members = others.map(|(_, simulated)| simulated).collect();
        Self::from_members(format!("{}-without-{group}", self.id), Arc::clone(&self.described), members)
    }
}

/// Number of consecutive members that form a group.
fn variants(members: &[Member]) -> usize {
    let drawn = members.first().is_some_and(|member| member.draw.is_some());
    if drawn { VARIANTS } else { 1 }
}

#[cfg(test)]
mod tests {
    use super::super::testing::synthetic_library;
    use super::*;

    #[test]
    fn depths_are_close_together_where_wear_is_small() {
        let depths = depths_um(245.0);
        assert_eq!((depths[0], depths[49]), (0.0, 245.0));
        assert!(depths[1] < 1.5 && depths[49] - depths[48] < 9.0);
        assert!(depths[DEPTHS - 1] > 275.0 && end_um(&depths) == 245.0);
        assert!(depths.windows(3).all(|d| d[2] - d[1] > d[1] - d[0]));
    }

    #[test]
    fn the_described_library_is_a_member_by_itself() {
        let library = Arc::new(synthetic_library());
        let ensemble = Ensemble::of(Arc::clone(&library));
        assert_eq!(ensemble.members().len(), 1);
        let curve = &library.feature_curves()["ln_mesh_1"].clone();
        assert!((f64::from(ensemble.change(0, 0, 49)) - (curve[49] - curve[0])).abs() < 1e-6);
        assert_eq!(ensemble.change(0, 0, 0), 0.0);
        // Lines that the library does not have are unknown.
        assert!((0..DEPTHS).all(|depth| ensemble.change(0, 7, depth).is_nan()));
    }

    #[test]
    fn a_smaller_ensemble_is_the_beginning_of_a_larger_one() {
        let library = Arc::new(synthetic_library());
        let settings = |members| EnsembleSettings { members };
        let control = BuildControl::silent();
        let small = Ensemble::build(Arc::clone(&library), &settings(4), &control).unwrap();
        let large = small.extended(&settings(8), &control).unwrap();
        let whole = Ensemble::build(library, &settings(8), &control).unwrap();
        assert_eq!((large.members(), &large.changes), (whole.members(), &whole.changes));
        assert_eq!((large.id(), whole.id()), (whole.id(), whole.id()));
        assert_ne!(small.id(), large.id());
        let read = decode_ensemble(&encode_ensemble(&large), Arc::clone(large.described())).unwrap();
        assert_eq!((read.members(), &read.changes), (large.members(), &large.changes));
    }
}
