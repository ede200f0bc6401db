//! Alarm states, actions on alarms, and the entries of an alarm's history.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::Severity;
use crate::estimate::MaintenanceKind;

/// State of an alarm.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum AlarmState {
    /// Not raised.
    #[default]
    Normal,
    /// Raised and not acknowledged.
    Unacknowledged,
    /// Raised and acknowledged.
    Acknowledged,
    /// Returned to normal without having been acknowledged.
    ReturnedUnacknowledged,
    /// Shelved by a user until a given time.
    Shelved,
}

impl AlarmState {
    /// Returns its name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Normal => "normal",
            Self::Unacknowledged => "unacknowledged",
            Self::Acknowledged => "acknowledged",
            Self::ReturnedUnacknowledged => "returned_unacknowledged",
            Self::Shelved => "shelved",
        }
    }
}

/// An action on an alarm, by a user or automatic.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum AlarmAction {
    /// Acknowledge the alarm.
    Acknowledge,
    /// Shelve the alarm until a given time.
    Shelve {
        /// Time at which the shelving expires.
        until: Timestamp,
    },
    /// End the shelving.
    Unshelve,
    /// Add a comment.
    Comment,
    /// Automatic: the shelving has expired.
    ShelvingOver,
    /// Automatic: the time without a record calls for a different severity.
    Stale {
        /// The severity that the time without a record calls for; absent where a record has arrived.
        severity: Option<Severity>,
        /// Seconds without a record.
        silent_s: u64,
    },
    /// Automatic: all channels together call for a different severity.
    Joint {
        /// The severity that they call for.
        severity: Option<Severity>,
        /// Their latest reading.
        value: f64,
    },
}

impl AlarmAction {
    /// Returns the severity and the reading of an automatic action on missing records or on all channels
    /// together; `None` for other actions.
    pub fn automatic_reading(&self) -> Option<(Option<Severity>, f64)> {
        match *self {
            Self::Stale { severity, silent_s } => Some((severity, silent_s as f64)),
            Self::Joint { severity, value } => Some((severity, value)),
            _ => None,
        }
    }
}

/// An action that was taken, with its place among the readings.
///
/// The place is after the latest record at that moment, not the time of the clock: while a recording is
/// replayed, users acknowledge what it has shown so far, not what it will show.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ActionTaken {
    /// Time of the action by the clock.
    pub time: Timestamp,
    /// The action comes after the records that begin at this time or earlier.
    pub after: Timestamp,
    /// The action.
    pub action: AlarmAction,
    /// The severity that was shown to the user; an acknowledgement does not cover a higher one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seen: Option<Severity>,
    /// Who did it.
    pub by: String,
    /// Comment.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub comment: String,
}

/// One reading of the quantity that a rule watches.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AlarmReading {
    /// Time of the record.
    pub time: Timestamp,
    /// The value. `None` (no wear depth, or the indicator is absent) neither raises nor clears an alarm.
    pub value: Option<f64>,
}

/// An entry of an alarm's history.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "openapi", schema(as = AlarmHistoryEntry))]
pub struct AlarmChange {
    /// Time of the record, event or action that caused it.
    pub time: Timestamp,
    /// The state after it.
    pub state: AlarmState,
    /// The severity after it; absent where the alarm is not raised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub severity: Option<Severity>,
    /// The reading that caused it, in the unit of the quantity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<f64>,
    /// The action that caused it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<AlarmAction>,
    /// The maintenance that caused it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub maintenance: Option<MaintenanceKind>,
    /// Who did it; empty where a reading caused it.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub by: String,
    /// Comment.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub comment: String,
}

impl AlarmChange {
    /// Whether both changes are equal but for their readings, whose last digits may differ when recomputed.
    pub fn is_equivalent_to(&self, other: &Self) -> bool {
        let value = other.value;
        Self { value, ..self.clone() } == *other
    }
}
