//! Which records can be compared with a baseline: a record too short or too sparsely sampled says nothing,
//! neither of wear nor of faults.

use serde::{Deserialize, Serialize};

use flankwatch_signal::{Extent, Features};

/// Logarithm of two sampling rates' ratio below which they are the same.
const SAME_RATE: f64 = 0.1;

/// Logarithm of two lengths' ratio below which they are the same: what one record can be compared with, the
/// other can.
const SAME_LENGTH: f64 = 0.2;

/// How the records of a baseline were taken.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Comparability {
    /// Mean length in seconds.
    seconds: Option<f64>,
    /// Mean shaft speed in hertz.
    shaft_speed_hz: Option<f64>,
    /// Mean sampling rate in hertz.
    #[serde(default)]
    sample_rate_hz: Option<f64>,
    /// Whether mesh lines are read apart from their sidebands.
    apart: Option<bool>,
}

/// Whether a record's mesh lines are read apart from their sidebands, where its speed and length are known.
fn lines_are_apart(record: &Features) -> Option<bool> {
    let speed_hz = record.operating_point.shaft_speed_hz.filter(|_| record.has_mesh())?;
    Some(record.extent?.seconds >= Extent::min_seconds_to_separate_lines(speed_hz))
}

/// Whether two records can be part of one baseline.
pub(super) fn go_together(one: &Features, other: &Features) -> bool {
    let same_length = |one: Extent, other: Extent| (one.seconds / other.seconds).ln().abs() < SAME_LENGTH;
    let same = one.extent.zip(other.extent).is_none_or(|(one, other)| same_length(one, other));
    same || lines_are_apart(one) == lines_are_apart(other)
}

impl Comparability {
    /// Of the records of a baseline.
    pub(super) fn of<'a>(records: impl Iterator<Item = &'a Features> + Clone) -> Self {
        let speeds = records.clone().filter_map(|record| record.operating_point.shaft_speed_hz);
        Self {
            seconds: mean(records.clone().filter_map(|record| Some(record.extent?.seconds))),
            shaft_speed_hz: mean(speeds),
            sample_rate_hz: mean(records.clone().filter_map(|record| Some(record.extent?.sample_rate_hz))),
            apart: records.into_iter().next().and_then(lines_are_apart),
        }
    }

    /// Why a record's length makes it incomparable.
    pub(super) fn refuses(&self, record: &Features) -> Option<String> {
        let seconds = record.extent?.seconds;
        if (seconds / self.seconds?).ln().abs() < SAME_LENGTH {
            return None;
        }
        let speed_hz = record.operating_point.shaft_speed_hz.or(self.shaft_speed_hz)?;
        let needed_s = Extent::min_seconds_to_separate_lines(speed_hz);
        match (self.apart?, seconds >= needed_s) {
            (true, false) => Some(format!(
                "not comparable with the baseline: a record of {seconds:.2} s, and {needed_s:.2} s are needed to tell the mesh lines from their sidebands"
            )),
            (false, true) => Some(format!(
                "not comparable with the baseline: a record of {seconds:.2} s, and the baseline's are shorter than the {needed_s:.2} s that tell the mesh lines from their sidebands"
            )),
            _ => None,
        }
    }

    /// Whether a record reaches as high in frequency as the baseline, and no higher: what lies between the
    /// mesh harmonics is one sum over all of them.
    pub(super) fn reaches_as_high(&self, record: &Features) -> bool {
        match (self.sample_rate_hz, record.extent) {
            (Some(rate_hz), Some(extent)) => (extent.sample_rate_hz / rate_hz).ln().abs() < SAME_RATE,
            _ => true,
        }
    }

    /// By how much the variance of a record's values is larger than in the baseline, as the record is
    /// shorter.
    pub(super) fn scatter(&self, record: &Features) -> f64 {
        match (self.seconds, record.extent) {
            (Some(seconds), Some(extent)) if extent.seconds > 0.0 => (seconds / extent.seconds).max(1.0),
            _ => 1.0,
        }
    }
}

/// Why a record that is sampled at this rate lacks too many of the baseline's values: the `needed_hz` is the
/// least rate that gives them.
pub(super) fn sampled_too_slowly(record: &Features, needed_hz: f64) -> Option<String> {
    let rate_hz = record.extent?.sample_rate_hz;
    (rate_hz < needed_hz).then(|| {
        format!(
            "not comparable with the baseline: sampled at {rate_hz:.0} Hz, and {needed_hz:.0} Hz are needed"
        )
    })
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0.0);
    for value in values {
        sum += value;
        count += 1.0;
    }
    (count > 0.0).then(|| sum / count)
}

#[cfg(test)]
mod tests {
    use flankwatch_signal::OperatingPoint;

    use super::*;

    fn record(seconds: f64) -> Features {
        Features {
            values: [("ln_mesh_1".to_owned(), 0.0)].into(),
            operating_point: OperatingPoint { shaft_speed_hz: Some(20.0), ..OperatingPoint::default() },
            extent: Some(Extent { seconds, sample_rate_hz: 12_800.0 }),
            ..Features::default()
        }
    }

    /// 5 bins of 1/T to a shaft rate of 20 Hz: 0.25 s.
    #[test]
    fn lines_and_sidebands_that_run_together_are_not_compared_with_such_that_do_not() {
        let long = Comparability::of([record(1.0), record(0.5)].iter());
        assert_eq!(long.refuses(&record(0.26)), None);
        let why = long.refuses(&record(0.2)).unwrap();
        assert!(why.contains("0.20 s") && why.contains("0.25 s"), "{why}");
        let short = Comparability::of([record(0.2)].iter());
        assert_eq!(short.refuses(&record(0.1)), None);
        assert_eq!(Comparability::of([record(0.26)].iter()).refuses(&record(0.24)), None, "nearly as long");
        assert!(short.refuses(&record(1.0)).is_some());
    }

    #[test]
    fn a_baseline_is_of_records_that_are_alike_in_length_or_in_what_they_tell_apart() {
        assert!(go_together(&record(0.24), &record(0.26)));
        assert!(go_together(&record(0.3), &record(3.0)));
        assert!(!go_together(&record(0.2), &record(0.3)));
    }

    #[test]
    fn a_shorter_record_scatters_more() {
        let baseline = Comparability::of([record(1.0)].iter());
        assert_eq!(baseline.scatter(&record(0.5)), 2.0);
        assert_eq!(baseline.scatter(&record(2.0)), 1.0);
        assert_eq!(baseline.scatter(&Features::default()), 1.0);
    }

    #[test]
    fn a_rate_that_is_too_low_is_said_with_the_one_needed() {
        assert_eq!(sampled_too_slowly(&record(1.0), 12_000.0), None);
        let why = sampled_too_slowly(&record(1.0), 16_000.0).unwrap();
        assert!(why.contains("12800 Hz") && why.contains("16000 Hz"), "{why}");
    }
}
