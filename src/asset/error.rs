//! Errors of asset descriptions.

use std::borrow::Cow;
use std::fmt;

use thiserror::Error;

/// Why an asset's description is invalid.
#[derive(Debug, Error)]
pub enum AssetError {
    /// The id is empty, too long, or has characters that are not allowed in URLs.
    #[error(
        "asset id is {0:?}, expected 1 to 64 characters of a-z, 0-9, - and _, starting with a letter or digit"
    )]
    Id(String),
    /// A field has an invalid value.
    #[error("{field} is {value}, expected {expected}")]
    Field {
        /// Path of the field.
        field: &'static str,
        /// Its value.
        value: String,
        /// What was expected.
        expected: Cow<'static, str>,
    },
    /// The gear pair is invalid.
    #[error("gear.pair: {0}")]
    Pair(#[from] crate::gear::GearError),
    /// The text is not TOML, or a field is missing, unknown or of the wrong type.
    #[error("not an asset description: {source}")]
    Toml {
        /// Path of the value at fault; `None` if the text is not TOML.
        path: Option<String>,
        /// The error, with the place in the text.
        source: Box<toml::de::Error>,
    },
}

pub(super) fn field(
    field: &'static str,
    value: impl fmt::Display,
    expected: impl Into<Cow<'static, str>>,
) -> AssetError {
    AssetError::Field { field, value: value.to_string(), expected: expected.into() }
}
