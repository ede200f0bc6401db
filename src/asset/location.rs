//! The location of a mesh, and its measuring points.

use jiff::civil::Date;
use serde::{Deserialize, Serialize};

use super::error::{AssetError, field};

/// Maximum number of measuring points of an asset.
const MAX_POINTS: usize = 64;

/// Maximum sensitivity, in any unit.
const MAX_SENSITIVITY: f64 = 1e12;

/// Maximum length of a text in a description, in characters.
const MAX_TEXT: usize = 200;

/// Maximum length of the name of a unit in bytes.
pub(crate) const MAX_UNIT_BYTES: usize = 64;

/// The location of a mesh; meshes of one gearbox have the first three fields in common.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Location {
    /// The site.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site: Option<String>,
    /// The machine at the site.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub machine: Option<String>,
    /// The gearbox of the machine.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gearbox: Option<String>,
    /// The mesh in the gearbox.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mesh: Option<String>,
}

/// A measuring point and its sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MeasuringPoint {
    /// The channel of its records.
    pub channel: String,
    /// Its position on the machine.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<String>,
    /// The direction in which it measures.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axis: Option<String>,
    /// Unit of its samples if the recording does not give it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// Sensitivity in `sensitivity_unit`, for information only: samples are already in their unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensitivity: Option<f64>,
    /// Unit of the sensitivity, such as `mV/(m/s2)`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensitivity_unit: Option<String>,
    /// The sensor's serial number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// Date of its last calibration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>, format = Date)]
    pub calibrated_on: Option<Date>,
    /// Date on which the next calibration is due.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>, format = Date)]
    pub calibration_due: Option<Date>,
}

impl Location {
    /// Whether no field is given.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    pub(super) fn validate(&self) -> Result<(), AssetError> {
        check_text("location.site", self.site.as_deref())?;
        check_text("location.machine", self.machine.as_deref())?;
        check_text("location.gearbox", self.gearbox.as_deref())?;
        check_text("location.mesh", self.mesh.as_deref())
    }
}

pub(super) fn validate(points: &[MeasuringPoint]) -> Result<(), AssetError> {
    if points.len() > MAX_POINTS {
        return Err(field("points", format!("a list of {}", points.len()), "at most 64 measuring points"));
    }
    for (index, point) in points.iter().enumerate() {
        check_text("points.channel", Some(&point.channel))?;
        if points[..index].iter().any(|other| other.channel == point.channel) {
            return Err(field("points.channel", format!("{:?}", point.channel), "each channel at most once"));
        }
        check_text("points.place", point.place.as_deref())?;
        check_text("points.axis", point.axis.as_deref())?;
        check_unit("points.unit", point.unit.as_deref())?;
        check_text("points.sensitivity_unit", point.sensitivity_unit.as_deref())?;
        check_text("points.serial", point.serial.as_deref())?;
        if let Some(sensitivity) = point.sensitivity
            && !(sensitivity > 0.0 && sensitivity <= MAX_SENSITIVITY)
        {
            return Err(field("points.sensitivity", sensitivity, "a number above 0 and at most 1e12"));
        }
    }
    Ok(())
}

/// Checks the name of a unit.
pub(super) fn check_unit(name: &'static str, unit: Option<&str>) -> Result<(), AssetError> {
    match unit {
        Some(unit) if unit.len() > MAX_UNIT_BYTES => {
            Err(field(name, format!("{unit:?}"), "a unit of at most 64 bytes"))
        }
        _ => check_text(name, unit),
    }
}

pub(super) fn check_text(name: &'static str, text: Option<&str>) -> Result<(), AssetError> {
    match text {
        Some(text)
            if text.trim().is_empty()
                || text.chars().count() > MAX_TEXT
                || text.chars().any(char::is_control) =>
        {
            Err(field(name, format!("{text:?}"), "1 to 200 characters, none of them control characters"))
        }
        _ => Ok(()),
    }
}
