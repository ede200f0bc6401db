//! The verdict of a report in one sentence: the most severe of the raised alarms and of the wear limits.

use std::fmt::Write;

use super::wording::escape;
use super::{Report, quantity_words};
use crate::estimate::{AlarmQuantity, MaintenanceKind, Severity, WearEstimate};

/// Writes the verdict, below the title.
pub(super) fn write(report: &Report, body: &mut String) {
    let (class, word, reason) = verdict(report);
    let _ = write!(body, "<p class=\"verdict {class}\"><strong>{word}</strong> {}.</p>", escape(&reason));
}

/// The class, the word and the reason of the verdict.
fn verdict(report: &Report) -> (&'static str, &'static str, String) {
    let Some(last) = report.records.last() else {
        return ("none", "No verdict:", "there are no records".to_owned());
    };
    let raised = report.alarms.iter().filter_map(|alarm| Some((alarm.severity?, alarm)));
    let limited = wear_beyond(report);
    // A depth alarm repeats the limit, which has more detail.
    let raised = raised.filter(|(severity, alarm)| {
        alarm.quantity != AlarmQuantity::WearUm || limited.as_ref().is_none_or(|(at, _)| at != severity)
    });
    let raised = raised.map(|(severity, alarm)| (severity, quantity_words(&alarm.quantity)));
    let all: Vec<(Severity, String)> = limited.iter().cloned().chain(raised).collect();
    let of = |wanted: Severity| -> Vec<&str> {
        let matching = all.iter().filter(|(severity, _)| *severity == wanted);
        matching.map(|(_, words)| words.as_str()).collect()
    };
    for (severity, word) in [(Severity::Danger, "Danger:"), (Severity::Warning, "Warning:")] {
        let reasons = of(severity);
        if !reasons.is_empty() {
            return (severity.name(), word, reasons.join("; "));
        }
    }
    match last.wear.as_ref().and_then(WearEstimate::determined_depth_um) {
        Some(depth_um) => {
            ("good", "Good:", format!("no active alarms, and the wear depth is {depth_um:.0} µm"))
        }
        None if last.wear_words.is_empty() => ("good", "Good:", "no active alarms".to_owned()),
        None => ("none", "No active alarms.", format!("Wear: {}", last.wear_words)),
    }
}

/// The wear limit that the latest depth exceeds, if any. A depth from before new gears or a new baseline does
/// not count: from the first record after them the wear restarts at zero.
fn wear_beyond(report: &Report) -> Option<(Severity, String)> {
    let last = report.records.last()?;
    let restarts = report.maintenance.iter().filter(|event| {
        matches!(event.kind, MaintenanceKind::GearReplaced | MaintenanceKind::BaselineChosen)
            && event.time <= last.start_time
    });
    let restarted = restarts.map(|event| event.time).max();
    let current = report.records.iter().filter(|record| Some(record.start_time) >= restarted);
    let depth_um = current.rev().find_map(|record| record.wear.as_ref()?.determined_depth_um())?;
    let limits = [(Severity::Danger, report.limits.danger_um), (Severity::Warning, report.limits.warning_um)];
    limits.into_iter().find_map(|(severity, limit_um)| {
        let limit_um = limit_um.filter(|limit_um| depth_um >= *limit_um)?;
        let words = format!("wear depth {depth_um:.0} µm, {} limit {limit_um} µm", severity.name());
        Some((severity, words))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::WearLimits;
    use crate::estimate::{AlarmState, BaselineProgress, MaintenanceEvent, WearStatus};
    use crate::report::page::tests::{estimated, record};
    use crate::report::{ReportedAlarm, ReportedRecord};

    fn words(report: &Report) -> String {
        let (_, word, reason) = verdict(report);
        format!("{word} {reason}")
    }

    #[test]
    fn the_most_severe_reason_decides() {
        let mut report = Report::default();
        assert_eq!(words(&report), "No verdict: there are no records");
        report.records = vec![record(estimated([180.0, 220.0, 250.0]))];
        assert_eq!(words(&report), "Good: no active alarms, and the wear depth is 220 µm");
        report.alarms = vec![ReportedAlarm {
            channel: "in".to_owned(),
            quantity: AlarmQuantity::Indicator("rms".to_owned()),
            rule: None,
            state: AlarmState::Unacknowledged,
            severity: Some(Severity::Warning),
            history: Vec::new(),
        }];
        assert_eq!(words(&report), "Warning: RMS");
        report.limits = WearLimits { warning_um: Some(120.0), danger_um: None };
        assert_eq!(words(&report), "Warning: wear depth 220 µm, warning limit 120 µm; RMS");
        let of_depth = ReportedAlarm { quantity: AlarmQuantity::WearUm, ..report.alarms[0].clone() };
        report.alarms.push(of_depth);
        assert_eq!(words(&report), "Warning: wear depth 220 µm, warning limit 120 µm; RMS");
        report.limits.warning_um = Some(250.0);
        assert_eq!(words(&report), "Warning: RMS; Wear depth (µm)");
        report.limits = WearLimits { warning_um: Some(120.0), danger_um: Some(200.0) };
        assert_eq!(words(&report), "Danger: wear depth 220 µm, danger limit 200 µm");
        let mut body = String::new();
        write(&report, &mut body);
        assert!(
            body.starts_with("<p class=\"verdict danger\"><strong>Danger:</strong> wear depth"),
            "{body}"
        );
    }

    #[test]
    fn a_depth_that_is_not_determined_is_no_verdict() {
        let mut wear = estimated([0.0, 220.0, 240.0]);
        wear.status = WearStatus::NotIdentifiable;
        wear.reason = "the interval covers most of the library".to_owned();
        let limits = WearLimits { warning_um: Some(120.0), danger_um: Some(200.0) };
        let report = Report { limits, records: vec![record(wear)], ..Report::default() };
        let (class, word, reason) = verdict(&report);
        assert_eq!((class, word), ("none", "No active alarms."));
        assert_eq!(reason, "Wear: the interval covers most of the library");
    }

    #[test]
    fn a_depth_of_replaced_gears_is_no_reason() {
        let at = |time: &str| time.parse().unwrap();
        let baseline = BaselineProgress { have: 1, need: 20 };
        let collecting =
            WearEstimate::without_number(WearStatus::CollectingBaseline, "collecting".to_owned(), baseline);
        let next = ReportedRecord { start_time: at("1970-01-02T00:00:00Z"), ..record(collecting) };
        let replaced = |time: &str| MaintenanceEvent {
            time: at(time),
            kind: MaintenanceKind::GearReplaced,
            by: String::new(),
            comment: String::new(),
            inspection: None,
            until: None,
        };
        let mut report = Report {
            limits: WearLimits { warning_um: Some(120.0), danger_um: None },
            records: vec![record(estimated([180.0, 220.0, 250.0])), next],
            ..Report::default()
        };
        let worn = "Warning: wear depth 220 µm, warning limit 120 µm";
        assert_eq!(words(&report), worn);
        // It takes effect with the first record after it.
        report.maintenance = vec![replaced("1970-01-03T00:00:00Z")];
        assert_eq!(words(&report), worn);
        report.maintenance.push(replaced("1970-01-01T12:00:00Z"));
        assert_eq!(words(&report), "No active alarms. Wear: collecting");
    }
}
