//! Errors of a previewed description, with the field at fault.

use serde::Serialize;

use crate::gear::GearError;
use crate::http::problem::shortened;

/// An invalid field.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = PreviewRefusal)]
pub(crate) struct Refusal {
    /// What is wrong.
    detail: String,
    /// The field's path, starting with `gear` as in an asset; none if no single field is at fault.
    #[serde(skip_serializing_if = "Option::is_none")]
    field: Option<String>,
    /// Its value.
    #[serde(skip_serializing_if = "Option::is_none")]
    value: Option<String>,
    /// What was expected.
    #[serde(skip_serializing_if = "Option::is_none")]
    expected: Option<String>,
}

impl Refusal {
    pub(crate) fn of_field(
        field: impl Into<String>,
        value: impl ToString,
        expected: impl Into<String>,
    ) -> Self {
        let (field, value, expected) = (field.into(), shortened(&value.to_string()), expected.into());
        Self {
            detail: format!("{field} is {value}, expected {expected}"),
            field: Some(field),
            value: Some(value),
            expected: Some(expected),
        }
    }

    /// An error in the pair's own fields.
    pub(crate) fn of_pair(error: &GearError) -> Self {
        match error {
            GearError::Field { field, value, expected } => {
                Self::of_field(format!("gear.pair.{field}"), value, expected)
            }
            other => Self::in_words(other),
        }
    }

    /// An error in the conditions, whose torque and speed replace the pair's.
    pub(crate) fn of_conditions(error: &GearError) -> Self {
        match error {
            GearError::Field { field, value, expected } => {
                let name = match *field {
                    "operation.torque_nm" | "operation.output_torque_nm" | "torque_nm" => "torque_nm",
                    "operation.shaft_speed_hz" | "shaft_speed_hz" => "shaft_speed_hz",
                    "wear depth in mm" => "wear_um",
                    other => other,
                };
                Self::of_field(name, value, expected)
            }
            other => Self::in_words(other),
        }
    }

    pub(crate) fn in_words(error: &impl ToString) -> Self {
        Self { detail: error.to_string(), field: None, value: None, expected: None }
    }
}
