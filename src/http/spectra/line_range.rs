//! The requested part of a spectrum.

use std::ops::Range;

use crate::http::problem::Problem;

/// Tolerance so that a line at an end of the range is included despite rounding.
const ROUNDING: f64 = 1e-9;

/// A range of frequencies in hertz or of orders, both ends included.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LineRange {
    from: f64,
    to: f64,
}

impl LineRange {
    /// The range from the parameters with these names; by default the whole spectrum.
    pub(crate) fn new(names: [&str; 2], from: Option<f64>, to: Option<f64>) -> Result<Self, Problem> {
        let range = Self { from: from.unwrap_or(0.0), to: to.unwrap_or(f64::INFINITY) };
        if range.from >= 0.0 && range.from.is_finite() && range.to > range.from {
            return Ok(range);
        }
        let expected = format!("{} at least 0 and below {}", names[0], names[1]);
        Err(Problem::query(&names.join(", "), format!("{} to {}", range.from, range.to), &expected))
    }

    /// Indices of its lines among `lines` lines spaced by `resolution` from 0.
    pub(crate) fn places(self, lines: usize, resolution: f64) -> Range<usize> {
        let first = (self.from / resolution * (1.0 - ROUNDING)).ceil() as usize;
        let last = (self.to / resolution * (1.0 + ROUNDING)).floor() as usize;
        let end = last.saturating_add(1).min(lines);
        first.min(end)..end
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn places(from: Option<f64>, to: Option<f64>) -> Range<usize> {
        LineRange::new(["from_hz", "to_hz"], from, to).unwrap().places(1001, 0.1)
    }

    #[test]
    fn both_ends_are_included() {
        assert_eq!(places(None, None), 0..1001);
        assert_eq!(places(Some(0.3), Some(0.7)), 3..8);
        assert_eq!(places(Some(0.31), Some(0.69)), 4..7);
        assert_eq!(places(Some(99.95), Some(500.0)), 1000..1001);
        assert!(places(Some(200.0), None).is_empty());
    }

    #[test]
    fn invalid_ranges_are_refused() {
        for (from, to) in [
            (-1.0, 5.0),
            (5.0, 5.0),
            (5.0, 1.0),
            (f64::NAN, 5.0),
            (0.0, f64::NAN),
            (f64::INFINITY, f64::INFINITY),
        ] {
            assert!(LineRange::new(["from_hz", "to_hz"], Some(from), Some(to)).is_err(), "{from} to {to}");
        }
    }
}
