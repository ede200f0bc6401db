//! Units of acceleration and conversion of records between them.

use crate::{Record, RecordError};

/// Standard acceleration of free fall in m/s².
const G_M_S2: f64 = 9.806_65;

/// Returns one `unit` in m/s², or `None` if it is not a unit of acceleration.
pub(super) fn in_m_s2(unit: &str) -> Option<f64> {
    match unit {
        "m/s2" | "m/s²" | "m/s^2" => Some(1.0),
        "mm/s2" | "mm/s²" | "mm/s^2" => Some(1e-3),
        "g" => Some(G_M_S2),
        "mg" => Some(1e-3 * G_M_S2),
        _ => None,
    }
}

/// Returns the factor that converts values from one unit to another, or `None` if the units differ and are
/// not both units of acceleration.
pub fn unit_factor(from: &str, to: &str) -> Option<f64> {
    if from == to {
        return Some(1.0);
    }
    Some(in_m_s2(from)? / in_m_s2(to)?)
}

impl Record {
    /// Converts the samples to `unit`: one of m/s², mm/s², g and mg.
    ///
    /// # Errors
    /// [`RecordError::Unit`] if no conversion is known; [`RecordError::NotFinite`] if a converted sample
    /// overflows.
    pub fn in_unit(self, unit: &str) -> Result<Self, RecordError> {
        if self.unit() == unit {
            return Ok(self);
        }
        let Some(factor) = unit_factor(self.unit(), unit) else {
            return Err(RecordError::Unit {
                channel: self.channel().to_owned(),
                found: self.unit().to_owned(),
                expected: unit.to_owned(),
                is_acceleration: in_m_s2(unit).is_some(),
            });
        };
        self.scaled(factor, unit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use jiff::Timestamp;

    fn record(unit: &str) -> Record {
        Record::new("1", Timestamp::UNIX_EPOCH, 1000.0, unit, vec![1.0, -2.0]).unwrap()
    }

    #[test]
    fn only_accelerations_are_converted() {
        for (from, to, first) in [
            ("g", "m/s2", 9.806_65_f32),
            ("m/s²", "m/s2", 1.0),
            ("mm/s2", "m/s2", 0.001),
            ("m/s2", "mg", 101.971_62),
        ] {
            let converted = record(from).in_unit(to).unwrap();
            assert_eq!(converted.unit(), to);
            assert!(
                (converted.samples()[0] - first).abs() <= 1e-6 * first,
                "{from} to {to}: {:?}",
                converted.samples()
            );
        }
        for (from, to) in [("V", "m/s2"), ("m/s2", "V"), ("1", "g")] {
            let error = record(from).in_unit(to).unwrap_err().to_string();
            assert!(error.contains(from) && error.contains(to), "{error}");
            assert_eq!(error.contains("converts to it"), to != "V", "{error}");
        }
        let great = Record::new("1", Timestamp::UNIX_EPOCH, 1000.0, "g", vec![f32::MAX]).unwrap();
        assert!(matches!(great.in_unit("m/s2"), Err(RecordError::NotFinite { .. })));
    }
}
