//! Everything that is wrong with a description, in the order in which it was found.

use super::GearError;

/// Reasons why a pair cannot be.
#[derive(Debug, Default)]
pub(super) struct Refusals(Vec<GearError>);

impl Refusals {
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(super) fn add(&mut self, error: GearError) {
        self.0.push(error);
    }

    /// The result's value; its error is added.
    pub(super) fn take<T>(&mut self, result: Result<T, GearError>) -> Option<T> {
        result.map_err(|error| self.add(error)).ok()
    }

    /// Adds the result's error.
    pub(super) fn note<T>(&mut self, result: Result<T, GearError>) {
        self.take(result);
    }

    /// The first reason, where there is one.
    pub(super) fn first(self) -> Result<(), GearError> {
        self.0.into_iter().next().map_or(Ok(()), Err)
    }

    pub(super) fn into_vec(self) -> Vec<GearError> {
        self.0
    }
}
