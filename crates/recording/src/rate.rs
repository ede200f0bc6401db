//! The sampling rate of a recording that may state it, and may have the times of its samples.

use super::RecordingError;

/// Largest relative difference between a given rate and that of the times.
pub(super) const TOLERANCE: f64 = 1e-3;

/// Returns the stated rate in hertz, else that of the times, whose relative uncertainty is given; `None`
/// without both.
///
/// # Errors
/// The two differ by more than 0.1 %, or there are only times, which do not give the rate within 0.1 %.
pub(super) fn agreed_rate_hz(
    stated: Option<f64>,
    clock: Option<f64>,
    uncertainty: f64,
) -> Result<Option<f64>, RecordingError> {
    match (stated, clock) {
        (Some(stated), Some(clock)) if (stated / clock - 1.0).abs() > TOLERANCE + uncertainty => {
            Err(RecordingError::Rate { stated, clock })
        }
        (None, Some(clock)) if uncertainty > TOLERANCE => Err(RecordingError::field(
            "the sampling rate",
            format!("{clock:.0} Hz ± {:.1} % by the times in the file", 100.0 * uncertainty),
            "times that give it within 0.1 %, or a rate given with the file",
        )),
        (stated, clock) => Ok(stated.or(clock)),
    }
}

/// Returns the rate in hertz of a sampling interval in seconds: a whole one if rounding may have changed it.
pub(super) fn rate_hz_of(interval_s: f64) -> f64 {
    let rate = 1.0 / interval_s;
    let whole = rate.round();
    if whole >= 1.0 && (rate / whole - 1.0).abs() < 1e-6 { whole } else { rate }
}
