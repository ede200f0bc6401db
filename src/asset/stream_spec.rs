//! Which parts of a live stream become records.

use serde::{Deserialize, Serialize};

use super::error::{AssetError, field};

/// The shortest and the longest record in seconds.
const RECORD_S: std::ops::RangeInclusive<f64> = 0.1..=600.0;

/// The longest interval in seconds: a day.
const LONGEST_INTERVAL_S: f64 = 86_400.0;

/// How records are cut out of the asset's live streams.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StreamSpec {
    /// Length of a record in seconds, 0.1 to 600.
    #[serde(default = "default_record_s")]
    pub record_s: f64,
    /// Seconds from the beginning of one record to the next. The same as `record_s` makes records of all
    /// samples; 0 makes none but on demand.
    #[serde(default = "default_interval_s")]
    pub interval_s: f64,
}

fn default_record_s() -> f64 {
    10.0
}

fn default_interval_s() -> f64 {
    60.0
}

impl Default for StreamSpec {
    fn default() -> Self {
        Self { record_s: default_record_s(), interval_s: default_interval_s() }
    }
}

impl StreamSpec {
    pub(super) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    pub(super) fn validate(&self) -> Result<(), AssetError> {
        if !RECORD_S.contains(&self.record_s) {
            return Err(field("stream.record_s", self.record_s, "a length from 0.1 to 600"));
        }
        if self.interval_s != 0.0 && !(self.record_s..=LONGEST_INTERVAL_S).contains(&self.interval_s) {
            return Err(field(
                "stream.interval_s",
                self.interval_s,
                "0, or at least stream.record_s and at most 86400",
            ));
        }
        Ok(())
    }
}
