//! Alarms and maintenance of a machine, as tables and as marks in the charts over time.

use std::fmt::Write;

use jiff::Timestamp;

use super::Report;
use super::chart::Mark;
use super::wording::{INDICATORS, MINUTES, escape};
use crate::estimate::{
    AlarmAction, AlarmChange, AlarmQuantity, AlarmRule, AlarmState, Inspection, MaintenanceEvent,
    MaintenanceKind, PanelChange, RatedQuantity, Severity,
};
use crate::library::FlankPlace;

/// Maximum number of entries of an alarm's history, of which the latest are shown.
const MAX_ENTRIES: usize = 50;

/// One alarm with its history.
#[derive(Debug, Clone)]
pub struct ReportedAlarm {
    /// The measuring channel.
    pub channel: String,
    /// The quantity that it watches.
    pub quantity: AlarmQuantity,
    /// Its rule; `None` if the asset no longer has it.
    pub rule: Option<AlarmRule>,
    /// Its state.
    pub state: AlarmState,
    /// Its severity; `None` if it is not raised.
    pub severity: Option<Severity>,
    /// Its history, oldest first.
    pub history: Vec<AlarmChange>,
}

impl ReportedAlarm {
    /// The alarms of a channel that have changed, from all changes of its rules.
    pub fn of_changes(channel: &str, rules: &[AlarmRule], changes: &[PanelChange]) -> Vec<Self> {
        let of_rule = |(number, rule): (usize, &AlarmRule)| {
            let history: Vec<AlarmChange> =
                changes.iter().filter(|(of, _)| *of == number).map(|(_, change)| change.clone()).collect();
            let last = history.last()?;
            Some(Self {
                channel: channel.to_owned(),
                quantity: rule.quantity.clone(),
                rule: Some(rule.clone()),
                state: last.state,
                severity: last.severity,
                history,
            })
        };
        rules.iter().enumerate().filter_map(of_rule).collect()
    }
}

/// Writes the tables of alarms and maintenance, if there are any.
pub(super) fn sections(report: &Report, body: &mut String) {
    if !report.alarms.is_empty() {
        body.push_str("<h2>Alarms</h2>");
        report.alarms.iter().for_each(|alarm| alarm_table(alarm, body));
    }
    if !report.maintenance.is_empty() {
        let rows: String = report.maintenance.iter().map(maintenance_row).collect();
        let _ = write!(
            body,
            "<h2>Maintenance</h2><table class=\"happened\"><thead><tr><th>Time (UTC)</th><th>Action</th><th>By</th><th>Comment</th></tr></thead>\
             <tbody>{rows}</tbody></table>"
        );
    }
}

/// The marks of raised alarms of a channel, and of maintenance.
pub(super) fn marks(report: &Report, channel: &str) -> Vec<Mark> {
    let of_alarms = report.alarms.iter().filter(|alarm| alarm.channel == channel).flat_map(|alarm| {
        let raised = |change: &&AlarmChange| {
            let is_by_itself =
                change.action.as_ref().is_none_or(|action| action.automatic_reading().is_some());
            is_by_itself && change.maintenance.is_none() && change.severity.is_some()
        };
        alarm.history.iter().filter(raised).map(|change| {
            let class = change.severity.map_or("warning", Severity::name);
            Mark {
                x: seconds(change.time),
                class,
                name: format!("{class}: {}", quantity_words(&alarm.quantity)),
            }
        })
    });
    let of_maintenance = report.maintenance.iter().map(|event| Mark {
        x: seconds(event.time),
        class: "maintenance",
        name: event.inspection.as_ref().map_or_else(
            || kind_words(event.kind).to_owned(),
            |inspection| format!("{}: {}", kind_words(event.kind), measured(inspection)),
        ),
    });
    of_alarms.chain(of_maintenance).collect()
}

fn seconds(time: Timestamp) -> f64 {
    time.as_nanosecond() as f64 * 1e-9
}

fn alarm_table(alarm: &ReportedAlarm, body: &mut String) {
    let levels = alarm.rule.iter().flat_map(|rule| {
        [
            ("warning above", rule.warning),
            ("danger above", rule.danger),
            ("warning below", rule.warning_below),
            ("danger below", rule.danger_below),
        ]
        .into_iter()
        .filter_map(|(name, level)| level.map(|level| format!("{name} {level}")))
    });
    let levels: Vec<String> = levels.collect();
    let levels = if levels.is_empty() { "rule removed".to_owned() } else { levels.join(", ") };
    let now = match alarm.severity {
        Some(severity) => format!("{}, {}", severity.name(), state_words(alarm.state)),
        None => state_words(alarm.state).to_owned(),
    };
    let shown = &alarm.history[alarm.history.len().saturating_sub(MAX_ENTRIES)..];
    let rows: String = shown.iter().map(change_row).collect();
    let of_more = if shown.len() < alarm.history.len() {
        format!(" The latest {} of {} entries.", shown.len(), alarm.history.len())
    } else {
        String::new()
    };
    let _ = write!(
        body,
        "<h3>{}, channel {}: {}</h3><p>{}.{of_more}</p><table class=\"happened\"><thead><tr><th>Time (UTC)</th><th>Event</th><th>Reading</th>\
         <th>By</th><th>Comment</th></tr></thead><tbody>{rows}</tbody></table>",
        escape(&quantity_words(&alarm.quantity)),
        escape(&alarm.channel),
        escape(&now),
        escape(&levels)
    );
}

fn change_row(change: &AlarmChange) -> String {
    let what = match (&change.action, change.maintenance) {
        (Some(AlarmAction::Acknowledge), _) => "acknowledged".to_owned(),
        (Some(AlarmAction::Shelve { until }), _) => {
            format!("shelved until {}", until.strftime(MINUTES))
        }
        (Some(AlarmAction::Unshelve), _) => "unshelved".to_owned(),
        (Some(AlarmAction::Comment), _) => "comment".to_owned(),
        (Some(AlarmAction::ShelvingOver), _) => "shelving expired".to_owned(),
        (None, Some(kind)) => format!("{}: alarm reset", kind_words(kind)),
        (None | Some(AlarmAction::Stale { .. } | AlarmAction::Joint { .. }), _) => change
            .severity
            .map_or_else(|| "back to normal".to_owned(), |severity| format!("{} raised", severity.name())),
    };
    let reading = change.value.map_or_else(|| "–".to_owned(), reading_words);
    row(change.time, &[&what, &reading, &change.by, &change.comment])
}

/// A reading with four significant digits: more would suggest false precision.
pub fn reading_words(value: f64) -> String {
    if value != 0.0 && !(1e-6..1e9).contains(&value.abs()) {
        return format!("{value:.3e}");
    }
    let digits = if value == 0.0 { 0 } else { value.abs().log10().floor() as i32 };
    let decimals = usize::try_from(3 - digits).unwrap_or(0);
    format!("{value:.decimals$}")
}

fn maintenance_row(event: &MaintenanceEvent) -> String {
    let what = event.inspection.as_ref().map_or_else(
        || kind_words(event.kind).to_owned(),
        |inspection| format!("{}: {}", kind_words(event.kind), inspection_words(inspection)),
    );
    row(event.time, &[&what, &event.by, &event.comment])
}

/// Depth with its standard error, gear and position on the flank.
fn inspection_words(inspection: &Inspection) -> String {
    let gear = match inspection.gear {
        Some(1) => "driving gear",
        Some(_) => "driven gear",
        None => "the more worn gear",
    };
    let place = match inspection.place {
        FlankPlace::Greatest => "at the deepest point",
        FlankPlace::Root => "at the root",
        FlankPlace::Pitch => "at the pitch point",
        FlankPlace::Tip => "at the tip",
    };
    format!("{}, {gear}, {place}", measured(inspection))
}

fn measured(inspection: &Inspection) -> String {
    format!("{} ± {} µm", inspection.depth_um, inspection.error_um)
}

fn row(time: Timestamp, cells: &[&str]) -> String {
    let cells: String =
        cells.iter().map(|words| format!("<td class=\"words\">{}</td>", escape(words))).collect();
    format!("<tr><td>{}</td>{cells}</tr>", time.strftime("%Y-%m-%d %H:%M:%S"))
}

/// The quantity that an alarm watches, in words.
pub fn quantity_words(quantity: &AlarmQuantity) -> String {
    match quantity {
        AlarmQuantity::WearUm => "Wear depth (µm)".to_owned(),
        AlarmQuantity::WearAboveLimit => "Probability that the limit is exceeded".to_owned(),
        AlarmQuantity::Novelty => "Novelty (−log₁₀ p)".to_owned(),
        AlarmQuantity::JointNovelty => "Novelty of all channels together (−log₁₀ p)".to_owned(),
        AlarmQuantity::SensorFault => "Sensor fault (0 or 1)".to_owned(),
        AlarmQuantity::StaleS => "Time without a record (s)".to_owned(),
        AlarmQuantity::Indicator(name) => indicator_words(name),
        AlarmQuantity::RatePerDay(RatedQuantity::WearUm) => {
            "Change of the wear depth (µm per day)".to_owned()
        }
        AlarmQuantity::RatePerDay(RatedQuantity::Novelty) => "Change of the novelty per day".to_owned(),
        AlarmQuantity::RatePerDay(RatedQuantity::Indicator(name)) => {
            format!("Change per day: {}", indicator_words(name))
        }
    }
}

/// An indicator in words.
fn indicator_words(name: &str) -> String {
    let known = INDICATORS.iter().find(|(known, ..)| *known == name);
    if let Some((_, heading, _)) = known {
        return (*heading).to_owned();
    }
    let ratio = name.strip_prefix("bearing_").and_then(|rest| rest.strip_suffix("_to_background"));
    match ratio.and_then(|rest| rest.rsplit_once('_')) {
        Some((bearing, line)) => format!("{} of {bearing}, to background", line.to_uppercase()),
        None => format!("Indicator {name}"),
    }
}

fn kind_words(kind: MaintenanceKind) -> &'static str {
    match kind {
        MaintenanceKind::GearReplaced => "gears replaced",
        MaintenanceKind::SensorReplaced => "sensor replaced",
        MaintenanceKind::RegimeChanged => "operation changed",
        MaintenanceKind::Inspected => "wear measured",
        MaintenanceKind::BaselineChosen => "baseline chosen",
    }
}

fn state_words(state: AlarmState) -> &'static str {
    match state {
        AlarmState::Normal => "normal",
        AlarmState::Unacknowledged => "not acknowledged",
        AlarmState::Acknowledged => "acknowledged",
        AlarmState::ReturnedUnacknowledged => "returned to normal, not acknowledged",
        AlarmState::Shelved => "shelved",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn change(second: i64, severity: Option<Severity>, by: &str) -> AlarmChange {
        AlarmChange {
            time: Timestamp::from_second(second).unwrap(),
            state: AlarmState::Acknowledged,
            severity,
            value: severity.map(|_| 101.25),
            action: (!by.is_empty()).then_some(AlarmAction::Acknowledge),
            maintenance: None,
            by: by.to_owned(),
            comment: String::new(),
        }
    }

    #[test]
    fn a_reading_has_four_significant_digits() {
        let words = [3e-5, 0.0, 412.25, -51234.5, 3e-12, 2.5e9].map(reading_words);
        assert_eq!(words, ["0.00003000", "0.000", "412.2", "-51234", "3.000e-12", "2.500e9"]);
        let rate = AlarmQuantity::RatePerDay(RatedQuantity::Indicator("rms".to_owned()));
        assert_eq!(quantity_words(&rate), "Change per day: RMS");
    }

    #[test]
    fn alarms_and_maintenance_are_listed_and_marked() {
        let rule =
            AlarmRule { warning: Some(100.0), hysteresis: 5.0, ..AlarmRule::of(AlarmQuantity::WearUm) };
        let quiet = AlarmRule { quantity: AlarmQuantity::Novelty, ..rule.clone() };
        let changes =
            [(1, change(60, Some(Severity::Warning), "")), (1, change(90, Some(Severity::Warning), "A & B"))];
        let report = Report {
            alarms: ReportedAlarm::of_changes("in", &[quiet, rule], &changes),
            maintenance: vec![
                MaintenanceEvent {
                    time: Timestamp::from_second(30).unwrap(),
                    kind: MaintenanceKind::GearReplaced,
                    by: "Ada".to_owned(),
                    comment: "new <pair>".to_owned(),
                    inspection: None,
                    until: None,
                },
                MaintenanceEvent {
                    time: Timestamp::from_second(40).unwrap(),
                    kind: MaintenanceKind::Inspected,
                    by: "Ada".to_owned(),
                    comment: String::new(),
                    inspection: Some(Inspection {
                        depth_um: 62.5,
                        error_um: 5.0,
                        gear: Some(2),
                        place: FlankPlace::Root,
                    }),
                    until: None,
                },
            ],
            ..Report::default()
        };
        let mut body = String::new();
        sections(&report, &mut body);
        for words in [
            "Wear depth (µm), channel in: warning, acknowledged",
            "warning above 100",
            "A &amp; B",
            "warning raised",
            ">101.2<",
            "gears replaced",
            "wear measured: 62.5 ± 5 µm, driven gear, at the root",
            "new &lt;pair&gt;",
        ] {
            assert!(body.contains(words), "{words} in {body}");
        }
        assert!(!body.contains("Novelty"));
        let marks = marks(&report, "in");
        assert_eq!(
            marks.iter().map(|mark| ((mark.x * 1e6).round() * 1e-6, mark.class)).collect::<Vec<_>>(),
            [(60.0, "warning"), (30.0, "maintenance"), (40.0, "maintenance")]
        );
    }
}
