//! The unit of work of a library build, and a store for finished ones.

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
    /// Full states; empty but at the nominal torque.
    pub(super) states: Vec<LibraryState>,
    /// Features by speed, then by wear state.
    pub(super) features: Vec<Vec<Features>>,
}

/// Stores the finished parts of a build, so that it can be resumed.
pub(super) trait PartStore: Sync {
    /// Opens the store for the library `id` and returns its stored parts.
    fn open(&self, id: &str) -> Result<Vec<Part>, LibraryError>;

    /// Adds a finished part.
    fn add(&self, part: &Part) -> Result<(), LibraryError>;
}
