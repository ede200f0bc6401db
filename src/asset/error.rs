//! What is wrong with an asset's description.

use std::borrow::Cow;
use std::fmt;

use thiserror::Error;

/// Why an asset's description cannot be used.
#[derive(Debug, Error)]
pub enum AssetError {
    /// The name has characters that do not belong in addresses.
    #[error(
        "asset id {0:?} is not usable, expected 1 to 64 characters of a-z, 0-9, - and _, the first a letter or digit"
    )]
    Id(String),
    /// A field has a value that cannot be used.
    #[error("{field} is {value}, expected {expected}")]
    Field {
        /// Path of the field.
        field: &'static str,
        /// Its value.
        value: String,
        /// What would have been right.
        expected: Cow<'static, str>,
    },
    /// The gear pair cannot be built.
    #[error("gear.pair: {0}")]
    Pair(#[from] crate::gear::GearError),
    /// Not TOML, or a field is missing, unknown or of the wrong type.
    #[error("not an asset description: {0}")]
    Toml(#[from] toml::de::Error),
}

pub(super) fn field(
    field: &'static str,
    value: impl fmt::Display,
    expected: impl Into<Cow<'static, str>>,
) -> AssetError {
    AssetError::Field { field, value: value.to_string(), expected: expected.into() }
}
