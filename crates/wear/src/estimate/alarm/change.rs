//! What happens to an alarm: the states it goes through, what people do, and the entries of its history.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::Severity;
use crate::estimate::MaintenanceKind;

/// Where an alarm stands.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum AlarmState {
    /// Nothing is the matter.
    #[default]
    Normal,
    /// Raised, and nobody has said that they know.
    Unacknowledged,
    /// Raised, and somebody knows.
    Acknowledged,
    /// It was raised and is over, and nobody has said that they know.
    ReturnedUnacknowledged,
    /// Put aside by somebody until a time.
    Shelved,
}

impl AlarmState {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::Normal, Self::Unacknowledged, Self::Acknowledged, Self::ReturnedUnacknowledged, Self::Shelved];

    /// Its name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Normal => "normal",
            Self::Unacknowledged => "unacknowledged",
            Self::Acknowledged => "acknowledged",
            Self::ReturnedUnacknowledged => "returned_unacknowledged",
            Self::Shelved => "shelved",
        }
    }

    /// The one of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.name() == name)
    }
}

/// What a person does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum AlarmAction {
    /// They know.
    Acknowledge,
    /// They want to hear no more of it until a time.
    Shelve {
        /// Until when.
        until: Timestamp,
    },
    /// They want to hear of it again.
    Unshelve,
    /// They have something to say.
    Comment,
    /// Nobody: the time that it was put aside until has come.
    ShelvingOver,
    /// Nobody: so long no record has come that the severity is another one.
    Stale {
        /// The severity that the time without a record calls for; none where one has come.
        severity: Option<Severity>,
        /// Seconds without a record.
        silent_s: u64,
    },
    /// Nobody: all channels together call for another severity.
    Joint {
        /// The severity that they call for.
        severity: Option<Severity>,
        /// Their latest reading.
        value: f64,
    },
}

impl AlarmAction {
    /// The severity and the reading of what nobody did: of silence, or of all channels together.
    pub fn automatic_reading(&self) -> Option<(Option<Severity>, f64)> {
        match *self {
            Self::Stale { severity, silent_s } => Some((severity, silent_s as f64)),
            Self::Joint { severity, value } => Some((severity, value)),
            _ => None,
        }
    }
}

/// What a person did, with its place among the readings.
///
/// The place is after the latest record there was, and not the time of the clock: of a recording that is
/// replayed, people acknowledge what it has shown so far, not what it will show.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ActionTaken {
    /// When, by the clock.
    pub time: Timestamp,
    /// It comes after the records that begin at this time or earlier.
    pub after: Timestamp,
    /// What was done.
    pub action: AlarmAction,
    /// The severity that was shown: nobody acknowledges a worse one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seen: Option<Severity>,
    /// Who did it.
    pub by: String,
    /// What they said.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub comment: String,
}

/// One reading of what a rule watches.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AlarmReading {
    /// When.
    pub time: Timestamp,
    /// The value; none where there is none (no wear is claimed, an indicator is absent), which neither raises
    /// nor clears.
    pub value: Option<f64>,
}

/// An entry of an alarm's history.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "openapi", schema(as = AlarmHistoryEntry))]
pub struct AlarmChange {
    /// When: the time of the record or event that caused it, or when somebody did something.
    pub time: Timestamp,
    /// The state after it.
    pub state: AlarmState,
    /// The severity after it; none where nothing is raised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub severity: Option<Severity>,
    /// The reading that caused it, in the unit of the quantity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<f64>,
    /// What a person did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<AlarmAction>,
    /// The maintenance that caused it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub maintenance: Option<MaintenanceKind>,
    /// Who did it; empty where a reading caused it.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub by: String,
    /// What they said.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub comment: String,
}

impl AlarmChange {
    /// Whether both tell the same: readings that were computed again may differ in their last digits.
    pub fn is_equivalent_to(&self, other: &Self) -> bool {
        let value = other.value;
        Self { value, ..self.clone() } == *other
    }
}
