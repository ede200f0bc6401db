//! Why a gear pair cannot be modelled.

use thiserror::Error;

/// Why a gear pair, its wear or a run of it cannot be modelled.
#[derive(Debug, Error)]
pub enum GearError {
    /// A field has a value that cannot be used.
    #[error("{field} is {value}, expected {expected}")]
    Field {
        /// Path of the field in the pair file, or the name of the argument.
        field: &'static str,
        /// Its value.
        value: String,
        /// What would have been right.
        expected: String,
    },
    /// Not TOML, or a field is missing, unknown or of the wrong type.
    #[error("not a pair file: {0}")]
    Toml(#[from] toml::de::Error),
    /// A line of a wear table cannot be read.
    #[error("wear table line {line}: {field} is {value:?}, expected {expected}")]
    WearTable {
        /// Line of the CSV text, from 1.
        line: u64,
        /// Column.
        field: &'static str,
        /// What stands there.
        value: String,
        /// What would have been right.
        expected: String,
    },
    /// The wear table is not CSV of three columns.
    #[error("wear table is not csv of gear,radius_mm,depth_um: {0}")]
    WearTableCsv(#[from] csv::Error),
    /// The elastic model of a gear has no sound mesh.
    #[error(
        "the teeth or the ring of gear {gear} cannot be modelled for loaded contact: its elements would be folded"
    )]
    ElasticModel {
        /// Gear, 1 or 2.
        gear: usize,
    },
    /// The worn flanks leave a part of the mesh period without any pair of teeth in contact.
    #[error(
        "no pair of teeth is in contact at phi1 = {phi1_rad:.5} rad: the flanks are worn too deep to carry the mesh over the whole period, \
         expected less wear or the contact rule `loaded`, by which tip edges carry too"
    )]
    NoContact {
        /// Rotational angle φ₁ of the driving gear in rad.
        phi1_rad: f64,
    },
    /// The teeth give way further than their contact is known for.
    #[error(
        "the teeth give way too far under {torque_nm} N·m at phi1 = {phi1_rad:.5} rad for their contact to be worked out: expected a smaller torque, \
         or teeth that are wider or stiffer"
    )]
    Overloaded {
        /// Torque on the driving gear in N·m.
        torque_nm: f64,
        /// Rotational angle φ₁ of the driving gear in rad.
        phi1_rad: f64,
    },
    /// The vibration grows without bound: by the threshold rule teeth never part, and nothing limits what
    /// their changing stiffness stirs up.
    #[error(
        "the vibration grows without bound at {shaft_speed_hz} Hz: the mesh's changing stiffness stirs up a resonance that is hardly damped, expected more \
         damping, another speed or the contact rule `loaded`, by which teeth part"
    )]
    Unstable {
        /// Rotational frequency f₁ of the driving gear in hertz.
        shaft_speed_hz: f64,
    },
    /// A simulation was told to stop.
    #[error("stopped")]
    Stopped,
}

impl GearError {
    /// A [`GearError::Field`].
    pub(super) fn field(
        field: &'static str,
        value: impl std::fmt::Display,
        expected: impl Into<String>,
    ) -> Self {
        Self::Field { field, value: value.to_string(), expected: expected.into() }
    }
}

/// The value where it is finite and within `[least, most]`.
pub(super) fn within(field: &'static str, value: f64, least: f64, most: f64) -> Result<f64, GearError> {
    if value >= least && value <= most {
        Ok(value)
    } else {
        Err(GearError::field(field, value, format!("a number from {least} to {most}")))
    }
}

/// The value where it is finite, above zero and not above `most`.
pub(super) fn positive(field: &'static str, value: f64, most: f64) -> Result<f64, GearError> {
    if value > 0.0 && value <= most {
        Ok(value)
    } else {
        Err(GearError::field(field, value, format!("a number above 0 and not above {most}")))
    }
}
