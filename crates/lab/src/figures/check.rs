//! Statements about a figure, and whether they hold for the model.

use serde::Serialize;

/// One statement of the paper's text about a figure, in our own words, tested against this model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// Number of the figure in the paper.
    pub figure: u32,
    /// The statement.
    pub statement: &'static str,
    /// The criterion for it to hold.
    pub criterion: &'static str,
    /// The model's values, with units.
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

/// Formats values as a list separated by commas.
pub(super) fn listed<T>(values: impl IntoIterator<Item = T>, format: impl Fn(T) -> String) -> String {
    values.into_iter().map(format).collect::<Vec<_>>().join(", ")
}
