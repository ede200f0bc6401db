//! What a change of an asset is conditional on: that its description is, or is not, one that the client has
//! seen.

use sha2::{Digest, Sha256};

use super::error::ServiceError;
use crate::store::{Asset, StoreError};

/// Which descriptions an asset may have to be changed; any where nothing is said.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Precondition {
    /// Tags one of which it must have; `*` is any.
    pub matches: Option<Vec<String>>,
    /// Tags of which it must have none; `*` is any.
    pub matches_none: Option<Vec<String>>,
}

/// Identifies an asset's description.
pub fn description_tag(asset: &Asset) -> Result<String, ServiceError> {
    let spec = serde_json::to_vec(&asset.spec).map_err(|source| StoreError::Damaged {
        what: "spec",
        of: asset.spec.id.to_string(),
        source,
    })?;
    let mut hash = Sha256::new();
    hash.update(asset.created_at.as_nanosecond().to_le_bytes());
    hash.update(spec);
    Ok(hex::encode(&hash.finalize()[..12]))
}

impl Precondition {
    /// Whether nothing is asked for.
    pub(crate) fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Checks it against an asset as it is.
    ///
    /// Error: [`ServiceError::Precondition`].
    pub(crate) fn check(&self, asset: &Asset) -> Result<(), ServiceError> {
        if self.is_none() {
            return Ok(());
        }
        let tag = description_tag(asset)?;
        let has = |tags: &Vec<String>| tags.iter().any(|one| one == "*" || *one == tag);
        let fails = self.matches.as_ref().is_some_and(|tags| !has(tags))
            || self.matches_none.as_ref().is_some_and(has);
        if fails {
            return Err(ServiceError::Precondition(asset.spec.id.clone()));
        }
        Ok(())
    }
}
