//! The shaft of a machine without a gear mesh.

use serde::{Deserialize, Serialize};

use super::error::{AssetError, field};

/// The shaft whose speed the records are taken at, of a machine without a gear mesh.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ShaftSpec {
    /// Nominal rotational frequency in hertz; where not given, speeds come with the records. A speed or a
    /// tachometer that comes with a record goes before it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_hz: Option<f64>,
    /// How far from nominal the speed may be, as a fraction: the shaft's own lines are looked for there, and
    /// those of bearings where none is found.
    #[serde(default = "default_tolerance")]
    pub speed_tolerance: f64,
    /// The nominal speed is exact (a synchronous drive): it is used as it is.
    #[serde(default)]
    pub speed_is_exact: bool,
}

/// An induction motor's slip.
fn default_tolerance() -> f64 {
    0.05
}

impl ShaftSpec {
    pub(super) fn validate(&self) -> Result<(), AssetError> {
        if self.speed_is_exact && self.speed_hz.is_none() {
            return Err(field("shaft.speed_hz", "missing", "the speed that speed_is_exact is about"));
        }
        let names = ["shaft.speed_hz", "shaft.speed_tolerance"];
        check_speed(names, self.speed_hz.unwrap_or(1.0), self.speed_tolerance)
    }
}

/// Checks a nominal speed and its tolerance, whose fields have these names.
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
