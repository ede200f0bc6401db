//! What people did to a machine that the estimate has to know.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

/// The kind of a maintenance event.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum MaintenanceKind {
    /// The gear pair was replaced: wear begins at zero again, and a new baseline is learnt.
    GearReplaced,
    /// The sensor was replaced, moved or fastened again: a new baseline is learnt, and wear goes on from where it was.
    SensorReplaced,
    /// The machine runs at another speed or load from now on: as for a replaced sensor.
    RegimeChanged,
}

/// Something that was done to a machine. Events and records are folded together in the order of their times; an event comes before a
/// record of the same time.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct MaintenanceEvent {
    /// When it was done.
    pub time: Timestamp,
    /// What was done.
    pub kind: MaintenanceKind,
    /// Who did it.
    #[serde(default)]
    pub by: String,
    /// In the words of whoever did it.
    #[serde(default)]
    pub comment: String,
}
