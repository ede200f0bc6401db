//! Why a value is missing.

use serde::{Deserialize, Serialize};

/// Why an indicator could not be computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum NotComputed {
    /// The shaft speed is neither given nor found in the spectrum.
    NoSpeed,
    /// The record is too short to resolve what the indicator needs.
    TooShort,
    /// All samples are equal.
    Constant,
    /// The frequency lies above half the sampling rate; over the shaft's angle, above 0.42 of it.
    AboveNyquist,
    /// Fewer than 4 whole turns of the shaft.
    TooFewTurns,
    /// The shaft speed varies so much that resampling over the shaft angle would make the record more than
    /// four times as long.
    SpeedVaries,
    /// Samples are at the converter's limit: 3 or more in a row at the highest or lowest value, which the
    /// signal approaches steeply.
    Clipped,
    /// Samples are missing: 64 or more in a row are equal.
    Gaps,
    /// The denominator is zero.
    NoSignal,
    /// The unit is neither one of acceleration nor one of velocity, so no velocity can be computed.
    NotAcceleration,
    /// The line coincides with one of another mesh that the sensor measures.
    OtherMesh,
    /// The frequency lies above the range of the band's envelope: its width.
    AboveEnvelope,
    /// The record does not separate the line from a multiple of a shaft's rate or from another bearing line.
    OtherLine,
}
