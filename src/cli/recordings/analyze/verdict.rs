//! The one-line summary of a channel's records.

use jiff::Timestamp;

use super::record::AnalyzedRecord;
use crate::estimate::{Novelty, WearEstimate, WearStatus};

/// Summarises the records of one channel, in time order.
pub(super) fn verdict(records: &[&AnalyzedRecord]) -> String {
    let Some(last) = records.last() else {
        return String::new();
    };
    let estimates: Option<Vec<&WearEstimate>> = records.iter().map(|record| record.wear.as_ref()).collect();
    match estimates {
        Some(estimates) => of_estimates(&estimates, last.time, Machine::of(last)),
        None => format!("no wear estimate: {}", last.wear_reason),
    }
}

/// What is described of the machine.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Machine {
    WithoutMesh,
    Mesh,
    GearPair,
}

impl Machine {
    fn of(record: &AnalyzedRecord) -> Self {
        match (record.has_mesh, record.has_pair) {
            (false, _) => Self::WithoutMesh,
            (true, false) => Self::Mesh,
            (true, true) => Self::GearPair,
        }
    }
}

/// Summarises a channel's estimates; the last of them is of the record that starts at `last`.
fn of_estimates(estimates: &[&WearEstimate], last: Timestamp, machine: Machine) -> String {
    let Some(latest) = estimates.last() else {
        return String::new();
    };
    match latest.status {
        WearStatus::Estimated => worn(estimates, latest, last),
        WearStatus::Provisional if latest.median_um.is_some() => {
            format!("provisional: {}", worn(estimates, latest, last))
        }
        WearStatus::NoMesh => "normal: the last record matches the baseline".to_owned(),
        WearStatus::CollectingBaseline if machine != Machine::GearPair => {
            let baseline = latest.baseline;
            format!("collecting the baseline: {} of {} records", baseline.have, baseline.need)
        }
        WearStatus::OutsideLibrary if machine == Machine::WithoutMesh => {
            format!("abnormal {}: {}", since(estimates), cause_without_mesh(latest))
        }
        WearStatus::OutsideLibrary => format!("not wear {}: {}", since(estimates), cause(latest)),
        WearStatus::SensorFault => format!("sensor fault {}: {}", since(estimates), cause(latest)),
        WearStatus::CollectingBaseline => {
            let baseline = latest.baseline;
            format!(
                "collecting the baseline: {} of {} records; wear is estimated after that",
                baseline.have, baseline.need
            )
        }
        WearStatus::NotIdentifiable => {
            format!("wear cannot be determined from these records: {}", latest.reason)
        }
        _ => format!("no wear estimate: {}", latest.reason),
    }
}

fn worn(estimates: &[&WearEstimate], wear: &WearEstimate, last: Timestamp) -> String {
    let depth = match (wear.at_least_um, wear.median_um, wear.low_um, wear.high_um) {
        (Some(least), ..) => format!("worn at least {least:.0} µm"),
        (_, Some(median), Some(low), Some(high)) => format!("worn {median:.0} µm ({low:.0} to {high:.0})"),
        _ => wear.reason.clone(),
    };
    if let Some(prognosis) = &wear.prognosis {
        let [early, median] = [prognosis.p05, prognosis.median].map(|time| span(last, time));
        let late = prognosis.p95.map_or_else(|| "much later".to_owned(), |time| span(last, time));
        let limit = prognosis.limit_um;
        return format!(
            "{depth} and growing; reaches the limit of {limit:.0} µm in about {median} ({early} to {late})"
        );
    }
    match wear.above_limit {
        Some(probability) if probability >= 0.5 => {
            format!("{depth}; above the limit with {:.0} % probability", 100.0 * probability)
        }
        _ => depth + &growth(estimates, wear),
    }
}

/// Says since which record the wear has grown: growth means that the first and the last interval do not
/// overlap. Unlike a prognosis, this needs no limit.
fn growth(estimates: &[&WearEstimate], latest: &WearEstimate) -> String {
    let first = estimates.iter().position(|estimate| estimate.status == latest.status);
    let before = first.and_then(|first| Some((first + 1, estimates[first].high_um?)));
    match before.zip(latest.low_um) {
        Some(((record, highest), lowest)) if highest < lowest => {
            format!("; growing since record {record}")
        }
        _ => "; no growth detected".to_owned(),
    }
}

/// Says which of the latest records have the status of the last one.
fn since(estimates: &[&WearEstimate]) -> String {
    let is_same =
        |estimate: &&&WearEstimate| Some(estimate.status) == estimates.last().map(|last| last.status);
    let count = estimates.iter().rev().take_while(is_same).count();
    let first = estimates.len() - count + 1;
    if count == 1 { format!("in record {first}") } else { format!("since record {first}") }
}

/// Names the fault of the sensor or the machine, without the "not wear" that the line already says.
fn cause(wear: &WearEstimate) -> String {
    let Some(novelty) = &wear.novelty else { return wear.reason.clone() };
    match (novelty.sensor_fault, novelty.suspected_fault) {
        (Some(fault), _) => fault.words().to_owned(),
        (None, Some(fault)) => {
            let words = fault.words();
            likely(words.strip_suffix(", not wear").unwrap_or(words), novelty)
        }
        (None, None) => wear.reason.clone(),
    }
}

/// Says a fault as a likelihood, with the other faults that the record suggests.
fn likely(words: &str, novelty: &Novelty) -> String {
    let also: Vec<&str> = novelty.other_suspected_faults.iter().map(|fault| fault.short()).collect();
    match also.is_empty() {
        true => format!("most likely {words}"),
        false => format!("most likely {words}; also possible: {}", also.join(", ")),
    }
}

/// Names the suspected fault of a machine without a gear mesh, with its line in the envelope spectrum.
fn cause_without_mesh(wear: &WearEstimate) -> String {
    let Some((novelty, fault)) =
        wear.novelty.as_ref().and_then(|novelty| Some((novelty, novelty.suspected_fault?)))
    else {
        return wear.reason.clone();
    };
    let line = novelty.envelope_line.as_ref().map(|line| format!("; {}", line.words()));
    likely(fault.words_without_mesh(), novelty) + &line.unwrap_or_default()
}

/// Formats the time between two moments, in the largest unit of which there are at least two.
fn span(from: Timestamp, to: Timestamp) -> String {
    let seconds = to.duration_since(from).as_secs_f64().max(0.0);
    let units = [(365.25 * 86_400.0, "years"), (86_400.0, "days"), (3600.0, "hours"), (60.0, "minutes")];
    let largest = units.into_iter().find(|(unit_s, _)| seconds >= 2.0 * unit_s);
    let (unit_s, name) = largest.unwrap_or((1.0, "seconds"));
    format!("{:.0} {name}", seconds / unit_s)
}

#[cfg(test)]
mod tests {
    use jiff::SignedDuration;

    use super::*;
    use crate::estimate::{BaselineProgress, Prognosis, SuspectedFault};

    fn wear(status: WearStatus) -> WearEstimate {
        WearEstimate::without_number(status, "reason".to_owned(), BaselineProgress { have: 8, need: 20 })
    }

    fn summary(estimates: &[WearEstimate]) -> String {
        of_estimates(&estimates.iter().collect::<Vec<_>>(), Timestamp::UNIX_EPOCH, Machine::GearPair)
    }

    #[test]
    fn wear_is_reported_with_its_growth() {
        let mut worn = WearEstimate {
            median_um: Some(85.2),
            low_um: Some(60.0),
            high_um: Some(110.0),
            ..wear(WearStatus::Estimated)
        };
        assert_eq!(summary(&[worn.clone()]), "worn 85 µm (60 to 110); no growth detected");
        let little = WearEstimate {
            median_um: Some(10.0),
            low_um: Some(0.0),
            high_um: Some(30.0),
            ..wear(WearStatus::Estimated)
        };
        let grown = [wear(WearStatus::CollectingBaseline), little, worn.clone()];
        assert_eq!(summary(&grown), "worn 85 µm (60 to 110); growing since record 2");
        let after = |days: i64| Timestamp::UNIX_EPOCH + SignedDuration::from_hours(24 * days);
        worn.prognosis = Some(Prognosis {
            rate_um_per_day: 5.0,
            limit_um: 200.0,
            median: after(23),
            p05: after(10),
            p95: None,
        });
        let expected = "worn 85 µm (60 to 110) and growing; reaches the limit of 200 µm in about 23 days (10 days to much later)";
        assert_eq!(summary(&[worn]), expected);
    }

    #[test]
    fn a_machine_without_a_gear_pair_is_summarised_without_wear() {
        let of = |status, machine| of_estimates(&[&wear(status)], Timestamp::UNIX_EPOCH, machine);
        let without_pair = of(WearStatus::CollectingBaseline, Machine::Mesh);
        assert_eq!(without_pair, "collecting the baseline: 8 of 20 records");
        let summary = |status| of(status, Machine::WithoutMesh);
        assert_eq!(summary(WearStatus::NoMesh), "normal: the last record matches the baseline");
        for status in [WearStatus::CollectingBaseline, WearStatus::OutsideLibrary] {
            assert!(!summary(status).contains("wear"), "{}", summary(status));
        }
    }

    #[test]
    fn a_fault_is_reported_with_its_first_record() {
        let novelty = Novelty {
            p_value: 1e-9,
            score: 9.0,
            outside: true,
            sensor_fault: None,
            suspected_fault: Some(SuspectedFault::OneTooth),
            other_suspected_faults: Vec::new(),
            band_hz: None,
            envelope_line: None,
            lasting: None,
            largest_deviations: Vec::new(),
        };
        let cracked = WearEstimate { novelty: Some(novelty), ..wear(WearStatus::OutsideLibrary) };
        let all = [
            wear(WearStatus::CollectingBaseline),
            cracked.clone(),
            wear(WearStatus::Estimated),
            cracked.clone(),
            cracked,
        ];
        let cause = "most likely one tooth differs from the others: a crack or chip";
        assert_eq!(summary(&all), format!("not wear since record 4: {cause}"));
        assert_eq!(summary(&all[..2]), format!("not wear in record 2: {cause}"));
        assert!(summary(&all[..1]).contains("8 of 20 records"));
        let mut several = all[1].clone();
        several.novelty.as_mut().unwrap().other_suspected_faults = vec![SuspectedFault::ImpulsiveEnergy];
        let also = "also possible: a bearing fault or looseness";
        assert_eq!(summary(&[several]), format!("not wear in record 1: {cause}; {also}"));
    }
}
