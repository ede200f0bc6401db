//! Identifiers of assets.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::error::AssetError;

/// An asset's identifier in URLs and topics: 1 to 64 of `a-z`, `0-9`, `-`, `_`, starting with a letter or
/// digit.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(try_from = "String", into = "String")]
#[schema(value_type = String, pattern = "^[a-z0-9][a-z0-9_-]{0,63}$", example = "gearbox-1")]
pub struct AssetId(String);

impl AssetId {
    /// Checks an identifier.
    pub fn new(id: impl Into<String>) -> Result<Self, AssetError> {
        let id = id.into();
        let first_is_alphanumeric =
            id.chars().next().is_some_and(|c| c.is_ascii_lowercase() || c.is_ascii_digit());
        let rest_is_usable =
            id.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_');
        if first_is_alphanumeric && rest_is_usable && id.len() <= 64 {
            Ok(Self(id))
        } else {
            Err(AssetError::Id(id))
        }
    }

    /// The identifier as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for AssetId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl TryFrom<String> for AssetId {
    type Error = AssetError;

    fn try_from(id: String) -> Result<Self, AssetError> {
        Self::new(id)
    }
}

impl From<AssetId> for String {
    fn from(id: AssetId) -> Self {
        id.0
    }
}
