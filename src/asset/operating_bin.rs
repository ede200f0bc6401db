//! Operating bins: ranges of speed and load, because a trend at one operating point is more informative than
//! one over all.

use serde::{Deserialize, Serialize};

use super::error::{AssetError, field};

/// Maximum number of bins of an asset.
const MAX_BINS: usize = 16;

/// Maximum magnitude of an edge of a bin.
const MAX_EDGE: f64 = 1e12;

/// A range of operating points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct OperatingBin {
    /// Its name: 1 to 64 characters, none of them control characters.
    #[schema(example = "full load")]
    pub name: String,
    /// Speeds of the driving shaft in hertz, from the first up to, not including, the second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = json!([24.0, 26.0]))]
    pub shaft_speed_hz: Option<[f64; 2]>,
    /// Torques on the driving shaft in N·m, from the first up to, not including, the second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = json!([80.0, 120.0]))]
    pub torque_nm: Option<[f64; 2]>,
}

impl OperatingBin {
    /// Whether it contains an operating point. A point with unknown speed or torque is in no bin with a range
    /// of that quantity.
    pub fn holds(&self, shaft_speed_hz: Option<f64>, torque_nm: Option<f64>) -> bool {
        let within = |range: Option<[f64; 2]>, value: Option<f64>| {
            range.is_none_or(|[low, high]| value.is_some_and(|value| low <= value && value < high))
        };
        within(self.shaft_speed_hz, shaft_speed_hz) && within(self.torque_nm, torque_nm)
    }

    fn overlaps(&self, other: &Self) -> bool {
        let meet = |one: Option<[f64; 2]>, two: Option<[f64; 2]>| {
            one.zip(two).is_none_or(|(one, two)| one[0] < two[1] && two[0] < one[1])
        };
        meet(self.shaft_speed_hz, other.shaft_speed_hz) && meet(self.torque_nm, other.torque_nm)
    }
}

pub(super) fn validate(bins: &[OperatingBin]) -> Result<(), AssetError> {
    if bins.len() > MAX_BINS {
        return Err(field("operating_bins", format!("a list of {}", bins.len()), "at most 16 bins"));
    }
    for (index, bin) in bins.iter().enumerate() {
        let name = bin.name.as_str();
        let is_usable =
            !name.trim().is_empty() && name.chars().count() <= 64 && !name.chars().any(char::is_control);
        if !is_usable || bins[..index].iter().any(|other| other.name == name) {
            return Err(field(
                "operating_bins.name",
                format!("{name:?}"),
                "a unique name of 1 to 64 characters, none of them control characters",
            ));
        }
        let ranges = [
            ("operating_bins.shaft_speed_hz", bin.shaft_speed_hz),
            ("operating_bins.torque_nm", bin.torque_nm),
        ];
        for (name, range) in ranges {
            if let Some([low, high]) = range
                && !(low >= -MAX_EDGE && low < high && high <= MAX_EDGE)
            {
                return Err(field(
                    name,
                    format!("[{low}, {high}]"),
                    "two numbers from -1e12 to 1e12, the lower one first",
                ));
            }
        }
        if ranges.iter().all(|(_, range)| range.is_none()) {
            return Err(field(
                "operating_bins",
                format!("{name:?}"),
                "a range of speed or of torque in each bin",
            ));
        }
        if let Some(other) = bins[..index].iter().find(|other| other.overlaps(bin)) {
            return Err(field(
                "operating_bins",
                format!("{:?} and {name:?}", other.name),
                "bins that do not overlap",
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bin(name: &str, shaft_speed_hz: Option<[f64; 2]>, torque_nm: Option<[f64; 2]>) -> OperatingBin {
        OperatingBin { name: name.to_owned(), shaft_speed_hz, torque_nm }
    }

    #[test]
    fn a_bin_contains_its_lower_edge_and_not_its_upper_one() {
        let both = bin("a", Some([10.0, 20.0]), Some([0.0, 5.0]));
        assert!(both.holds(Some(10.0), Some(0.0)));
        for (speed, torque) in
            [(Some(20.0), Some(1.0)), (Some(15.0), None), (None, Some(1.0)), (Some(15.0), Some(5.0))]
        {
            assert!(!both.holds(speed, torque), "{speed:?} {torque:?}");
        }
        assert!(bin("b", Some([10.0, 20.0]), None).holds(Some(15.0), None));
    }

    #[test]
    fn adjacent_bins_are_accepted_and_overlapping_ones_refused() {
        let slow = bin("slow", Some([10.0, 20.0]), None);
        assert!(validate(&[slow.clone(), bin("fast", Some([20.0, 30.0]), None)]).is_ok());
        let of_one_speed =
            [bin("a", Some([1.0, 2.0]), Some([0.0, 5.0])), bin("b", Some([1.0, 2.0]), Some([5.0, 9.0]))];
        assert!(validate(&of_one_speed).is_ok());
        for other in [
            bin("fast", Some([19.0, 30.0]), None),
            bin("loaded", None, Some([1.0, 2.0])),
            bin("slow", Some([20.0, 30.0]), None),
            bin("empty", None, None),
            bin("back", Some([30.0, 25.0]), None),
            bin("", Some([30.0, 35.0]), None),
        ] {
            assert!(validate(&[slow.clone(), other.clone()]).is_err(), "{other:?}");
        }
        let many: Vec<_> =
            (0..17).map(|n| bin(&n.to_string(), Some([f64::from(n), f64::from(n) + 1.0]), None)).collect();
        assert!(validate(&many).is_err());
    }
}
