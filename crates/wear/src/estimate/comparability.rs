//! Which records can be compared with a baseline. A record that is too short or sampled too slowly shows
//! neither wear nor faults.

use serde::{Deserialize, Serialize};

use flankwatch_signal::{Extent, Features};

/// Logarithm of the ratio of two sampling rates below which they count as equal.
const SAME_RATE: f64 = 0.1;

/// Logarithm of the ratio of two lengths below which they count as equal.
const SAME_LENGTH: f64 = 0.2;

/// Why a record cannot be compared.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rejection {
    /// The reason in a sentence.
    pub(super) reason: String,
    /// What the record has and what is needed, in a few words.
    pub(super) short: String,
}

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
    /// Whether the records separate mesh lines from their sidebands.
    #[serde(rename = "apart")]
    resolves_sidebands: Option<bool>,
}

/// Whether a record separates mesh lines from their sidebands; `None` where speed or length is unknown.
fn resolves_sidebands(record: &Features) -> Option<bool> {
    let speed_hz = record.operating_point.shaft_speed_hz.filter(|_| record.has_mesh())?;
    Some(record.extent?.seconds >= Extent::min_seconds_to_separate_lines(speed_hz))
}

/// Whether two records can be part of one baseline.
pub(super) fn can_share_baseline(one: &Features, other: &Features) -> bool {
    let same_length = |one: Extent, other: Extent| (one.seconds / other.seconds).ln().abs() < SAME_LENGTH;
    let same = one.extent.zip(other.extent).is_none_or(|(one, other)| same_length(one, other));
    same || resolves_sidebands(one) == resolves_sidebands(other)
}

impl Comparability {
    /// Summarises the records of a baseline.
    pub(super) fn of<'a>(records: impl Iterator<Item = &'a Features> + Clone) -> Self {
        let speeds = records.clone().filter_map(|record| record.operating_point.shaft_speed_hz);
        Self {
            seconds: mean(records.clone().filter_map(|record| Some(record.extent?.seconds))),
            shaft_speed_hz: mean(speeds),
            sample_rate_hz: mean(records.clone().filter_map(|record| Some(record.extent?.sample_rate_hz))),
            resolves_sidebands: records.into_iter().next().and_then(resolves_sidebands),
        }
    }

    /// Returns why a record cannot be compared because of its length.
    pub(super) fn rejection(&self, record: &Features) -> Option<Rejection> {
        let seconds = record.extent?.seconds;
        if (seconds / self.seconds?).ln().abs() < SAME_LENGTH {
            return None;
        }
        let speed_hz = record.operating_point.shaft_speed_hz.or(self.shaft_speed_hz)?;
        let needed_s = Extent::min_seconds_to_separate_lines(speed_hz);
        match (self.resolves_sidebands?, seconds >= needed_s) {
            (true, false) => Some(Rejection {
                reason: format!(
                    "not comparable with the baseline: the record is {seconds:.2} s long, and it takes {needed_s:.2} s to separate the mesh lines from their sidebands"
                ),
                short: format!("{} s, {} s needed", two_decimals(seconds), two_decimals(needed_s)),
            }),
            (false, true) => Some(Rejection {
                reason: format!(
                    "not comparable with the baseline: the record is {seconds:.2} s long, and the baseline's are shorter than the {needed_s:.2} s that it takes to separate the mesh lines from their sidebands"
                ),
                short: format!("{} s, below {} s needed", two_decimals(seconds), two_decimals(needed_s)),
            }),
            _ => None,
        }
    }

    /// Whether a record covers the same frequency range as the baseline: the checks between the mesh
    /// harmonics are one sum over all of them.
    pub(super) fn reaches_as_high(&self, record: &Features) -> bool {
        match (self.sample_rate_hz, record.extent) {
            (Some(rate_hz), Some(extent)) => (extent.sample_rate_hz / rate_hz).ln().abs() < SAME_RATE,
            _ => true,
        }
    }

    /// Returns the ratio, at least 1, of the variance of a shorter record's values to the baseline's.
    pub(super) fn scatter(&self, record: &Features) -> f64 {
        match (self.seconds, record.extent) {
            (Some(seconds), Some(extent)) if extent.seconds > 0.0 => (seconds / extent.seconds).max(1.0),
            _ => 1.0,
        }
    }
}

/// Returns why a record is rejected where its sampling rate is below `needed_hz`, the least that gives enough
/// of the baseline's values.
pub(super) fn sampled_too_slowly(record: &Features, needed_hz: f64) -> Option<Rejection> {
    let rate_hz = record.extent?.sample_rate_hz;
    (rate_hz < needed_hz).then(|| Rejection {
        reason: format!(
            "not comparable with the baseline: sampled at {rate_hz:.0} Hz, expected at least {needed_hz:.0} Hz"
        ),
        short: format!("{rate_hz:.0} Hz, {needed_hz:.0} Hz needed"),
    })
}

/// Formats a length in seconds with at most two decimals.
fn two_decimals(seconds: f64) -> String {
    let text = format!("{seconds:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
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
    fn records_that_resolve_sidebands_are_not_compared_with_records_that_do_not() {
        let long = Comparability::of([record(1.0), record(0.5)].iter());
        assert_eq!(long.rejection(&record(0.26)), None);
        let why = long.rejection(&record(0.2)).unwrap();
        assert!(why.reason.contains("0.20 s") && why.reason.contains("0.25 s"), "{why:?}");
        assert_eq!(why.short, "0.2 s, 0.25 s needed");
        let short = Comparability::of([record(0.2)].iter());
        assert_eq!(short.rejection(&record(0.1)), None);
        assert_eq!(Comparability::of([record(0.26)].iter()).rejection(&record(0.24)), None, "nearly as long");
        assert_eq!(short.rejection(&record(1.0)).unwrap().short, "1 s, below 0.25 s needed");
    }

    #[test]
    fn a_baseline_has_records_of_similar_length_or_resolution() {
        assert!(can_share_baseline(&record(0.24), &record(0.26)));
        assert!(can_share_baseline(&record(0.3), &record(3.0)));
        assert!(!can_share_baseline(&record(0.2), &record(0.3)));
    }

    #[test]
    fn a_shorter_record_scatters_more() {
        let baseline = Comparability::of([record(1.0)].iter());
        assert_eq!(baseline.scatter(&record(0.5)), 2.0);
        assert_eq!(baseline.scatter(&record(2.0)), 1.0);
        assert_eq!(baseline.scatter(&Features::default()), 1.0);
    }

    #[test]
    fn a_rate_that_is_too_low_is_reported_with_the_one_needed() {
        assert_eq!(sampled_too_slowly(&record(1.0), 12_000.0), None);
        let why = sampled_too_slowly(&record(1.0), 16_000.0).unwrap();
        assert!(why.reason.contains("12800 Hz") && why.reason.contains("16000 Hz"), "{why:?}");
        assert_eq!(why.short, "12800 Hz, 16000 Hz needed");
    }
}
