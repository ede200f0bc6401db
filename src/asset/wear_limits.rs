//! The user's limits on wear depth.

use serde::{Deserialize, Serialize};

use super::error::{AssetError, field};

/// The user's limits on wear depth in µm.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WearLimits {
    /// Wear depth from which maintenance should be planned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warning_um: Option<f64>,
    /// Wear depth from which the gear must not be operated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub danger_um: Option<f64>,
}

/// Maximum limit in µm, the same as for an inspection.
const MAX_DEPTH_UM: f64 = 1e5;

impl WearLimits {
    /// Checks the limits of an asset with or without a gear mesh.
    pub(super) fn validate(self, has_gear: bool) -> Result<(), AssetError> {
        for (name, limit) in [("limits.warning_um", self.warning_um), ("limits.danger_um", self.danger_um)] {
            if let Some(limit) = limit
                && !has_gear
            {
                return Err(field(name, limit, "no limit: without gear there is no wear depth"));
            }
            if let Some(limit) = limit
                && !(limit > 0.0 && limit <= MAX_DEPTH_UM)
            {
                return Err(field(name, limit, "a depth above 0 and at most 100000"));
            }
        }
        if let (Some(warning), Some(danger)) = (self.warning_um, self.danger_um)
            && warning > danger
        {
            return Err(field("limits.warning_um", warning, "a depth at or below the danger limit"));
        }
        Ok(())
    }
}
