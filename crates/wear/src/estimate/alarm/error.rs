//! What cannot be used or done.

use thiserror::Error;

use super::AlarmState;

/// Why a rule cannot be used or an action not be done.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum AlarmError {
    /// A number of the rule.
    #[error("{field} is {value}, expected {expected}")]
    Field {
        /// Which number.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would have been right.
        expected: &'static str,
    },
    /// Neither level is given.
    #[error("the alarm has neither a warning nor a danger level, expected at least one")]
    NoLevel,
    /// A rate without the stretch of time over which the change is measured.
    #[error(
        "the alarm on a rate has no over_s, expected the number of seconds over which the change is measured"
    )]
    NoRateWindow,
    /// The alarm is in a state in which this cannot be done.
    #[error("the alarm is {}, expected {expected}", state.name())]
    State {
        /// Its state.
        state: AlarmState,
        /// The states that would have been right.
        expected: &'static str,
    },
}
