//! Errors of alarm rules and actions.

use thiserror::Error;

use super::AlarmState;

/// Why a rule is invalid or an action is not possible.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum AlarmError {
    /// A number of the rule is out of range.
    #[error("{field} is {value}, expected {expected}")]
    Field {
        /// Name of the field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// The expected value.
        expected: &'static str,
    },
    /// The rule has no level.
    #[error("the alarm has neither a warning nor a danger level, expected at least one")]
    NoLevel,
    /// A rule on a rate has no time over which the change is measured.
    #[error(
        "the alarm on a rate has no over_s, expected the number of seconds over which the change is measured"
    )]
    NoRateWindow,
    /// The action is not possible in the alarm's state.
    #[error("the alarm is {}, expected {expected}", state.name())]
    State {
        /// Its state.
        state: AlarmState,
        /// The expected states.
        expected: &'static str,
    },
}
