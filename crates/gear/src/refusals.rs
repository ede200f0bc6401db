//! Collected errors of a description, in the order of the checks.

use super::GearError;

/// Errors of a pair.
#[derive(Debug, Default)]
pub(super) struct Refusals(Vec<GearError>);

impl Refusals {
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(super) fn add(&mut self, error: GearError) {
        self.0.push(error);
    }

    /// Returns the result's value; an error is added.
    pub(super) fn take<T>(&mut self, result: Result<T, GearError>) -> Option<T> {
        result.map_err(|error| self.add(error)).ok()
    }

    /// Adds the error of a check.
    pub(super) fn check<T>(&mut self, result: Result<T, GearError>) {
        self.take(result);
    }

    /// Returns the first error, if any.
    pub(super) fn first(self) -> Result<(), GearError> {
        self.0.into_iter().next().map_or(Ok(()), Err)
    }

    pub(super) fn into_vec(self) -> Vec<GearError> {
        self.0
    }
}
