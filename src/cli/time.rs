//! Times on the command line.

use jiff::Timestamp;

/// Parses a time in RFC 3339.
pub(super) fn parse_time(text: &str) -> Result<Timestamp, String> {
    text.parse().map_err(|_| "expected a time such as 2026-01-31T08:00:00Z".to_owned())
}
