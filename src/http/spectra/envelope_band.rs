//! The requested band of an envelope spectrum.

use crate::asset::Segment;
use crate::http::problem::Problem;
use crate::service::{BandChoice, ServiceError};

const NAMES: &str = "band_low_hz, band_high_hz";

/// The band from both ends; none if neither is given.
pub(crate) fn requested(
    low: Option<f64>,
    high: Option<f64>,
    segment: &Segment,
) -> Result<Option<[f64; 2]>, Problem> {
    let half_rate_hz = segment.sample_rate_hz / 2.0;
    match (low, high) {
        (None, None) => Ok(None),
        (Some(low), Some(high)) if low >= 0.0 && low < high && high <= half_rate_hz => Ok(Some([low, high])),
        (low, high) => {
            let end = |hz: Option<f64>| hz.map_or_else(|| "missing".to_owned(), |hz| hz.to_string());
            let found = format!("{} to {}", end(low), end(high));
            let expected = format!("both ends, the lower one first, from 0 to {half_rate_hz} Hz");
            Err(Problem::query(NAMES, found, &expected))
        }
    }
}

/// The problem of a failed envelope spectrum: a requested band may be finer than the record's resolution.
pub(crate) fn refusal(error: ServiceError, choice: BandChoice) -> Problem {
    match error {
        ServiceError::Field { value, expected, .. } if choice != BandChoice::OfAsset => {
            Problem::query(NAMES, value, &expected)
        }
        error => error.into(),
    }
}
