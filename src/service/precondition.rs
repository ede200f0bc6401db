//! Preconditions of changes to an asset: that its description is, or is not, one that the client has seen.

use sha2::{Digest, Sha256};

use super::error::ServiceError;
use crate::store::{Asset, StoreError};

/// The condition on an asset's description under which a change is allowed; the default allows any.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Precondition {
    /// Entity tags of which the description must have one; `*` matches any.
    pub matches: Option<Vec<String>>,
    /// Entity tags of which the description must have none; `*` matches any.
    pub matches_none: Option<Vec<String>>,
}

/// Identifies an asset's description.
pub fn description_tag(asset: &Asset) -> Result<String, ServiceError> {
    let spec = serde_json::to_vec(&asset.spec).map_err(StoreError::damaged("spec", &asset.spec.id))?;
    let mut hash = Sha256::new();
    hash.update(asset.created_at.as_nanosecond().to_le_bytes());
    hash.update(spec);
    Ok(hex::encode(&hash.finalize()[..12]))
}

impl Precondition {
    /// Whether there is no condition.
    pub(crate) fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Checks the condition against an asset.
    ///
    /// # Errors
    /// [`ServiceError::Precondition`].
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
