//! Statements about a figure, and whether the model bears them out.

use serde::Serialize;

/// One statement of the paper's text about a figure, in words of our own, held against this model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// Number of the figure in the paper.
    pub figure: u32,
    /// What is said.
    pub statement: &'static str,
    /// What counts as holding.
    pub criterion: &'static str,
    /// What the model gives, with units.
    pub measured: String,
    /// Whether it holds.
    pub holds: bool,
}

impl Check {
    pub(super) fn new(
        figure: u32,
        statement: &'static str,
        criterion: &'static str,
        measured: String,
        holds: bool,
    ) -> Self {
        Self { figure, statement, criterion, measured, holds }
    }
}

/// The values one after another, each by `format`.
pub(super) fn listed<T>(values: impl IntoIterator<Item = T>, format: impl Fn(T) -> String) -> String {
    values.into_iter().map(format).collect::<Vec<_>>().join(", ")
}
