//! The shaft of a machine without a gear mesh.

use serde::{Deserialize, Serialize};

use super::error::{AssetError, field};

/// The shaft of a machine without a gear mesh, to which the speed of the records refers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ShaftSpec {
    /// Nominal rotational frequency in hertz; if not given, the records contain the speed. A speed or
    /// tachometer in a record takes precedence.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_hz: Option<f64>,
    /// Relative deviation from the nominal speed, as a fraction: the lines of the shaft are searched in this
    /// range, and those of bearings if none is found.
    #[serde(default = "default_tolerance")]
    pub speed_tolerance: f64,
    /// Whether the nominal speed is exact (a synchronous drive) and used without a search.
    #[serde(default)]
    pub speed_is_exact: bool,
}

/// The default covers the slip of an induction motor.
fn default_tolerance() -> f64 {
    0.05
}

impl ShaftSpec {
    pub(super) fn validate(&self) -> Result<(), AssetError> {
        if self.speed_is_exact && self.speed_hz.is_none() {
            return Err(field("shaft.speed_hz", "missing", "a speed, because speed_is_exact is set"));
        }
        let names = ["shaft.speed_hz", "shaft.speed_tolerance"];
        check_speed(names, self.speed_hz.unwrap_or(1.0), self.speed_tolerance)
    }
}

/// Checks a nominal speed and its tolerance; the names are those of their fields.
pub(super) fn check_speed(
    [speed, tolerance]: [&'static str; 2],
    speed_hz: f64,
    speed_tolerance: f64,
) -> Result<(), AssetError> {
    if !(speed_hz > 0.0 && speed_hz <= 10_000.0) {
        return Err(field(speed, speed_hz, "a number above 0 and at most 10000"));
    }
    if !(0.0..=0.5).contains(&speed_tolerance) {
        return Err(field(tolerance, speed_tolerance, "a fraction from 0 to 0.5"));
    }
    Ok(())
}
