//! The unit of work of a library's build, and where finished ones can be kept.

use serde::{Deserialize, Serialize};

use super::{LibraryError, LibraryState};
use flankwatch_signal::Features;

/// Neighbouring wear states at one torque and every speed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Part {
    /// Index of the first wear state.
    pub(super) first: usize,
    /// Index of the torque.
    pub(super) torque: usize,
    /// The whole states, at the nominal torque alone.
    pub(super) states: Vec<LibraryState>,
    /// Features over the speeds, then over the wear states.
    pub(super) features: Vec<Vec<Features>>,
}

/// Keeps the finished parts of a build, so that a stopped one can go on.
pub(super) trait PartStore: Sync {
    /// The parts of the library `id` that are kept; further ones of it can be added from here on.
    fn open(&self, id: &str) -> Result<Vec<Part>, LibraryError>;

    /// Adds a finished part.
    fn add(&self, part: &Part) -> Result<(), LibraryError>;
}
