//! Errors of the gear model.

use thiserror::Error;

use super::description::DescriptionError;

/// Why a gear pair, its wear or a run of it cannot be modelled.
#[derive(Debug, Error)]
pub enum GearError {
    /// A field has an invalid value.
    #[error("{field} is {value}, expected {expected}")]
    Field {
        /// Path of the field in the pair file, or the name of the argument.
        field: &'static str,
        /// The value.
        value: String,
        /// The expected value.
        expected: String,
    },
    /// Not TOML, or a field is missing, unknown or of the wrong type.
    #[error("not a pair file: {0}")]
    Toml(#[from] DescriptionError),
    /// An invalid line of a wear table.
    #[error("wear table line {line}: {field} is {value:?}, expected {expected}")]
    WearTable {
        /// Line of the CSV text, from 1.
        line: u64,
        /// Column.
        field: &'static str,
        /// Text of the field.
        value: String,
        /// The expected value.
        expected: String,
    },
    /// The wear table is not CSV of three columns.
    #[error("wear table is not CSV with the columns gear,radius_mm,depth_um: {0}")]
    WearTableCsv(#[from] csv::Error),
    /// The elastic model of a gear cannot be meshed.
    #[error(
        "the teeth or the ring of gear {gear} cannot be meshed for loaded contact: finite elements would be inverted"
    )]
    ElasticModel {
        /// Gear, 1 or 2.
        gear: usize,
    },
    /// The worn flanks leave a part of the mesh period without any pair of teeth in contact.
    #[error(
        "no pair of teeth is in contact at phi1 = {phi1_rad:.5} rad: the flanks are worn too deeply for continuous contact over the mesh period, \
         expected less wear or the contact rule `loaded`, under which tip edges carry load too"
    )]
    NoContact {
        /// Rotational angle φ₁ of the driving gear in rad.
        phi1_rad: f64,
    },
    /// The deflection of the teeth exceeds the range of the contact model.
    #[error(
        "the teeth deflect too far under {torque_nm} N·m at phi1 = {phi1_rad:.5} rad for the contact model: expected a smaller torque, \
         or wider or stiffer teeth"
    )]
    Overloaded {
        /// Torque on the driving gear in N·m.
        torque_nm: f64,
        /// Rotational angle φ₁ of the driving gear in rad.
        phi1_rad: f64,
    },
    /// The vibration grows without bound: under the threshold rule teeth never separate, and nothing limits
    /// the parametric resonance of their varying stiffness.
    #[error(
        "the vibration grows without bound at {shaft_speed_hz} Hz: the varying mesh stiffness excites a weakly damped resonance, expected more \
         damping, another speed or the contact rule `loaded`, under which teeth can separate"
    )]
    Unstable {
        /// Rotational frequency f₁ of the driving gear in hertz.
        shaft_speed_hz: f64,
    },
    /// A simulation was stopped on request.
    #[error("stopped")]
    Stopped,
}

impl GearError {
    /// Creates a [`GearError::Field`].
    pub(super) fn field(
        field: &'static str,
        value: impl std::fmt::Display,
        expected: impl Into<String>,
    ) -> Self {
        Self::Field { field, value: value.to_string(), expected: expected.into() }
    }
}

/// Returns the value if it lies within `[min, max]`.
pub(super) fn within(field: &'static str, value: f64, min: f64, max: f64) -> Result<f64, GearError> {
    if value >= min && value <= max {
        Ok(value)
    } else {
        Err(GearError::field(field, value, format!("a number from {min} to {max}")))
    }
}

/// Returns the value if it is finite and at least `min`.
pub(super) fn at_least(field: &'static str, value: f64, min: f64) -> Result<f64, GearError> {
    if value >= min && value.is_finite() {
        Ok(value)
    } else {
        Err(GearError::field(field, value, format!("a finite number of at least {min}")))
    }
}

/// Returns the value if it lies above zero and is at most `max`.
pub(super) fn positive(field: &'static str, value: f64, max: f64) -> Result<f64, GearError> {
    if value > 0.0 && value <= max {
        Ok(value)
    } else {
        Err(GearError::field(field, value, format!("a number above 0 and at most {max}")))
    }
}
