//! The report's page.

use std::collections::BTreeMap;
use std::fmt::Write;

use super::chart::{Chart, Level, Series, XAxis};
use super::wording::{INDICATORS, MINUTES, escape};
use super::{Report, ReportedRecord, angle_words, cover, events, reading_words, verdict};
use crate::estimate::{Interval, Prognosis, WearEstimate, WearStatus};

/// Those of the indicators that are dimensionless.
const DIMENSIONLESS: [&str; 4] = ["kurtosis", "fm0", "fm4", "na4"];

/// CSS classes of the curves of several channels.
const CLASSES: [&str; 4] = ["one", "two", "three", "four"];

/// Maximum number of records in the table, which shows the latest ones.
const TABLE_ROWS: usize = 100;

const STYLE: &str = include_str!("report.css");

pub(super) fn html(report: &Report) -> String {
    let title = report
        .asset
        .as_ref()
        .map_or_else(|| "Vibration report".to_owned(), |name| format!("Vibration report: {name}"));
    let title = escape(&title);
    let (first, last) = (report.records.first(), report.records.last());
    let span = first.zip(last).map_or_else(String::new, |(first, last)| {
        let [first, last] = [first, last].map(|record| record.start_time.strftime(MINUTES).to_string());
        if first == last { format!(", {first}") } else { format!(", {first} to {last}") }
    });
    let count = report.all_records.unwrap_or(report.records.len());
    let records = if count == 1 { "record" } else { "records" };
    let mut body = format!("<h1>{title}</h1>");
    report.cover.addressee(&mut body);
    let undated = if report.has_undated {
        " Recordings without a time of their own begin at 1970-01-01 00:00."
    } else {
        ""
    };
    let _ = write!(body, "<p>{count} {records}{span}. All times are in UTC.{undated}</p>");
    verdict::write(report, &mut body);
    if let Some(form) = &report.form {
        cover::form(form, &report.cover, &report.contents, &mut body);
    }
    summary(report, &mut body);
    report.cover.recommendation(&mut body);
    let contents = &report.contents;
    let channels: BTreeMap<&str, Vec<&ReportedRecord>> =
        report.records.iter().fold(BTreeMap::new(), |mut channels, record| {
            channels.entry(record.channel.as_str()).or_insert_with(Vec::new).push(record);
            channels
        });
    for (channel, records) in channels.iter().filter(|_| contents.wear) {
        wear_section(report, channel, records, &mut body);
    }
    for indicator in INDICATORS.iter().filter(|(name, ..)| contents.indicators.contains(name)) {
        indicator_section(*indicator, &channels, &mut body);
    }
    if contents.spectrum {
        spectrum_section(report, &mut body);
    }
    if contents.events {
        events::sections(report, &mut body);
    }
    if contents.records {
        table(report, &mut body);
    }
    report.cover.signature(&mut body);
    format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <title>{title}</title><link rel=\"icon\" href=\"data:,\"><style>{STYLE}</style></head><body>{body}</body></html>"
    )
}

/// An interval below which a forecast has times, not only dates.
const SHORT_FORECAST: jiff::SignedDuration = jiff::SignedDuration::from_hours(72);

/// Writes the latest estimate and the facts about the asset.
fn summary(report: &Report, body: &mut String) {
    let latest =
        report.records.iter().rev().find(|record| record.wear.is_some() || !record.wear_words.is_empty());
    let error = latest
        .and_then(|record| record.wear.as_ref()?.transmission_error_um.as_ref().map(transmission_words));
    let mut facts: Vec<(&str, &str)> =
        latest.iter().map(|record| (term_of(record), record.wear_words.as_str())).collect();
    facts.extend(error.iter().map(|words| ("Transmission error due to wear", words.as_str())));
    let forecast = latest.and_then(|record| record.wear.as_ref()?.prognosis.as_ref().map(forecast_words));
    facts.extend(forecast.iter().map(|words| ("Forecast", words.as_str())));
    facts.extend(report.facts.iter().map(|(term, words)| (term.as_str(), words.as_str())));
    if facts.is_empty() {
        return;
    }
    let facts: String = facts
        .iter()
        .map(|(term, words)| format!("<div><dt>{}</dt><dd>{}</dd></div>", escape(term), escape(words)))
        .collect();
    let _ = write!(body, "<dl>{facts}</dl>");
}

/// The time at which the next limit is reached, in words.
fn forecast_words(forecast: &Prognosis) -> String {
    let Prognosis { limit_um, rate_um_per_day, median, p05, p95 } = forecast;
    let is_soon = p95.as_ref().unwrap_or(median).duration_since(*p05) < SHORT_FORECAST;
    let format = if is_soon { MINUTES } else { "%Y-%m-%d" };
    let day = |time: &jiff::Timestamp| time.strftime(format).to_string();
    let interval = p95.as_ref().map_or_else(
        || format!("not before {} with 95 % probability", day(p05)),
        |p95| format!("between {} and {} with 90 % probability", day(p05), day(p95)),
    );
    // Three digits: more would suggest an accuracy that the rate does not have.
    let (rate, decimals) = match *rate_um_per_day {
        rate if rate >= 1000.0 => ((rate / 10.0).round() * 10.0, 0),
        rate if rate >= 100.0 => (rate, 0),
        rate if rate >= 10.0 => (rate, 1),
        rate => (rate, 2),
    };
    format!(
        "{limit_um} µm around {}, {interval}, at {rate:.decimals$} µm per day of running time",
        day(median)
    )
}

/// The peak-to-peak value along the line of action with its interval, in words.
fn transmission_words(error: &Interval) -> String {
    let Interval { median, p05, p95 } = error;
    format!("{median:.1} µm peak to peak, between {p05:.1} and {p95:.1} µm with 90 % probability")
}

/// The wear of a record in a cell of the table; `None` without a depth.
fn depth_words(wear: &WearEstimate) -> Option<String> {
    let (median, low, high) = (wear.median_um?, wear.low_um?, wear.high_um?);
    let known_least = wear.at_least_um.filter(|_| wear.status == WearStatus::Estimated);
    Some(known_least.map_or_else(
        || format!("{median:.0} ({low:.0} to {high:.0})"),
        |least| format!("at least {least:.0}"),
    ))
}

fn wear_section(report: &Report, channel: &str, records: &[&ReportedRecord], body: &mut String) {
    let of = |pick: fn(&ReportedRecord) -> Option<f64>| {
        records.iter().map(|record| (seconds(record), pick(record))).collect::<Vec<_>>()
    };
    let median = of(|record| record.wear.as_ref()?.median_um);
    if median.iter().all(|(_, um)| um.is_none()) {
        return;
    }
    let edges = records.iter().map(|record| {
        let edges = record.wear.as_ref().and_then(|wear| Some([wear.low_um?, wear.high_um?]));
        (seconds(record), edges)
    });
    let mut series = vec![Series { name: "median".to_owned(), points: median, class: "one" }];
    let reference = of(|record| record.reference_wear_um);
    if reference.iter().any(|(_, um)| um.is_some()) {
        series.push(Series {
            name: "reference (simulated or inspected)".to_owned(),
            points: reference,
            class: "reference",
        });
    }
    let limits = [("warning", report.limits.warning_um), ("danger", report.limits.danger_um)];
    let chart = Chart {
        horizontal: XAxis::Time,
        x_title: "start of the record (UTC)".to_owned(),
        y_title: "wear depth (µm)".to_owned(),
        series,
        band: edges.collect(),
        levels: limits
            .into_iter()
            .filter_map(|(class, um)| {
                Some(Level { name: format!("{class} limit {} µm", um?), y: um?, class })
            })
            .collect(),
        marks: events::marks(report, channel),
        from_zero: true,
    };
    let caption = format!(
        "Channel {channel}: median, and the interval that contains the wear depth with 90 % probability."
    );
    section("Wear depth", &caption, &chart, Some("90 % interval"), body);
}

fn indicator_section(
    (name, heading, caption): (&str, &str, &str),
    channels: &BTreeMap<&str, Vec<&ReportedRecord>>,
    body: &mut String,
) {
    let series = channels.iter().enumerate().map(|(n, (channel, records))| Series {
        name: format!("channel {channel}"),
        points: records.iter().map(|record| (seconds(record), record.indicators.get(name))).collect(),
        class: CLASSES[n % CLASSES.len()],
    });
    let unit = channels.values().flatten().next().map_or("", |record| record.unit.as_str());
    let unit = match name {
        "velocity_rms" => "mm/s",
        name if DIMENSIONLESS.contains(&name) => "–",
        _ => unit_words(unit),
    };
    let chart = Chart {
        horizontal: XAxis::Time,
        x_title: "start of the record (UTC)".to_owned(),
        y_title: format!("{heading} ({unit})"),
        series: series.collect(),
        band: Vec::new(),
        levels: Vec::new(),
        marks: Vec::new(),
        from_zero: false,
    };
    section(heading, caption, &chart, None, body);
}

fn spectrum_section(report: &Report, body: &mut String) {
    let Some(spectrum) = &report.last_spectrum else {
        return;
    };
    let points = spectrum.amplitude.iter().enumerate();
    let chart = Chart {
        horizontal: XAxis::Number,
        x_title: "frequency (Hz)".to_owned(),
        y_title: format!("peak amplitude ({})", unit_words(&spectrum.unit)),
        series: vec![Series {
            name: "last record".to_owned(),
            points: points.map(|(bin, a)| (bin as f64 * spectrum.resolution_hz, Some(*a))).collect(),
            class: "one",
        }],
        band: Vec::new(),
        levels: Vec::new(),
        marks: Vec::new(),
        from_zero: true,
    };
    let caption = format!(
        "Last record: amplitude of each line (peak), {} window, noise bandwidth {:.3} Hz.",
        if spectrum.window == "hann" { "Hann" } else { spectrum.window },
        spectrum.bandwidth_hz
    );
    section("Spectrum", &caption, &chart, None, body);
}

fn section(heading: &str, caption: &str, chart: &Chart, band: Option<&str>, body: &mut String) {
    if chart.is_empty() {
        return;
    }
    let _ = write!(
        body,
        "<section><h2>{}</h2><figure>{}{}<figcaption>{}</figcaption></figure></section>",
        escape(heading),
        chart.svg(&format!("{heading}. {caption}")),
        chart.legend(band),
        escape(caption)
    );
}

fn table(report: &Report, body: &mut String) {
    let shown = &report.records[report.records.len().saturating_sub(TABLE_ROWS)..];
    let rows: String = shown.iter().map(row).collect();
    let unit = unit_words(shown.last().map_or("", |record| &record.unit));
    let which =
        if shown.len() < report.records.len() || report.all_records.is_some_and(|all| all > shown.len()) {
            format!("<p>The latest {} records.</p>", shown.len())
        } else {
            String::new()
        };
    let _ = write!(
        body,
        "<h2>Records</h2>{which}<table><thead><tr><th>Start (UTC)</th><th>Channel</th><th>Shaft (Hz)</th><th>RMS ({unit})</th>\
         <th>Kurtosis (–)</th><th>OMX ({unit})</th><th>FM4 (–)</th><th>NA4 (–)</th><th>Wear, 90 % interval (µm)</th><th>Shaft angle</th><th>Record</th>\
         </tr></thead><tbody>{rows}</tbody></table>"
    );
}

/// What the words about a record are of: of its wear, or without a depth of the machine's condition.
fn term_of(record: &ReportedRecord) -> &'static str {
    if record.wear.as_ref().and_then(depth_words).is_some() { "Wear" } else { "Condition" }
}

/// The first part of a reason: the table of records is no place for all of it.
fn first_part(reason: &str) -> &str {
    reason.split_once("; ").map_or(reason, |(first, _)| first)
}

fn row(record: &ReportedRecord) -> String {
    let number = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), reading_words);
    let wear = record.wear.as_ref().and_then(depth_words).map_or_else(
        || format!("<td class=\"words\">{}</td>", escape(first_part(&record.wear_words))),
        |depths| format!("<td>{depths}</td>"),
    );
    format!(
        "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>{wear}<td>{}</td><td class=\"name\">{}</td></tr>",
        record.start_time.strftime("%Y-%m-%d %H:%M:%S"),
        escape(&record.channel),
        number(record.shaft_speed_hz),
        number(record.indicators.get("rms")),
        number(record.indicators.get("kurtosis")),
        number(record.indicators.get("omx")),
        number(record.indicators.get("fm4")),
        number(record.indicators.get("na4")),
        record.shaft_angle.as_ref().map_or_else(|| "–".to_owned(), angle_words),
        escape(&record.name),
    )
}

/// A unit as written on an axis.
fn unit_words(unit: &str) -> &str {
    match unit {
        "m/s2" | "m/s^2" => "m/s²",
        "" | "1" => "–",
        other => other,
    }
}

fn seconds(record: &ReportedRecord) -> f64 {
    record.start_time.as_nanosecond() as f64 * 1e-9
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::estimate::BaselineProgress;

    /// An estimate with its lower end, median and upper end.
    pub(in crate::report) fn estimated([low, median, high]: [f64; 3]) -> WearEstimate {
        let baseline = BaselineProgress { have: 20, need: 20 };
        let mut wear = WearEstimate::without_number(WearStatus::Estimated, "wear".to_owned(), baseline);
        (wear.low_um, wear.median_um, wear.high_um) = (Some(low), Some(median), Some(high));
        wear
    }

    pub(in crate::report) fn record(wear: WearEstimate) -> ReportedRecord {
        ReportedRecord {
            name: "a".to_owned(),
            channel: "in".to_owned(),
            start_time: jiff::Timestamp::UNIX_EPOCH,
            unit: "m/s2".to_owned(),
            shaft_speed_hz: None,
            indicators: crate::signal::Indicators::default(),
            shaft_angle: None,
            wear_words: wear.reason.clone(),
            wear: Some(wear),
            reference_wear_um: None,
        }
    }

    #[test]
    fn the_forecast_is_in_words() {
        let mut wear = estimated([80.0, 90.0, 100.0]);
        let day = |text: &str| text.parse().unwrap();
        let mut forecast = Prognosis {
            rate_um_per_day: 1.25,
            limit_um: 120.0,
            median: day("2026-05-20T12:00:00Z"),
            p05: day("2026-05-02T12:00:00Z"),
            p95: Some(day("2026-07-01T12:00:00Z")),
        };
        let mut page = |forecast: &Prognosis| {
            wear.prognosis = Some(forecast.clone());
            html(&Report { records: vec![record(wear.clone())], ..Report::default() })
        };
        let between = "Forecast</dt><dd>120 µm around 2026-05-20, between 2026-05-02 and 2026-07-01 with 90 % probability, \
                       at 1.25 µm per day of running time</dd>";
        assert!(page(&forecast).contains(between), "{}", page(&forecast));
        forecast.p95 = None;
        let open =
            "120 µm around 2026-05-20, not before 2026-05-02 with 95 % probability, at 1.25 µm per day";
        assert!(page(&forecast).contains(open), "{}", page(&forecast));
        forecast.p05 = day("2026-05-20T10:30:00Z");
        let soon =
            "120 µm around 2026-05-20 12:00 UTC, not before 2026-05-20 10:30 UTC with 95 % probability";
        assert!(page(&forecast).contains(soon), "{}", page(&forecast));
    }

    #[test]
    fn the_velocity_is_in_its_own_unit() {
        let mut moving = record(estimated([1.0, 2.0, 3.0]));
        moving.indicators.values.insert("velocity_rms".to_owned(), 2.5);
        let page = html(&Report { records: vec![moving], ..Report::default() });
        assert!(page.contains("Velocity RMS (mm/s)"), "{page}");
    }

    #[test]
    fn recordings_without_a_time_are_named() {
        let records = vec![record(estimated([1.0, 2.0, 3.0]))];
        for has_undated in [false, true] {
            let page = html(&Report { records: records.clone(), has_undated, ..Report::default() });
            assert_eq!(page.contains("without a time of their own"), has_undated, "{page}");
        }
    }

    #[test]
    fn small_and_large_levels_have_four_digits() {
        let mut small = record(estimated([1.0, 2.0, 3.0]));
        small.indicators.values.extend([("rms".to_owned(), 2.345e-5), ("omx".to_owned(), 123_456.7)]);
        let page = html(&Report { records: vec![small], ..Report::default() });
        assert!(page.contains("<td>0.00002345</td>") && page.contains("<td>123457</td>"), "{page}");
    }

    #[test]
    fn the_minimum_depth_and_the_transmission_error_are_shown() {
        let mut wear = estimated([180.0, 220.0, 250.0]);
        wear.transmission_error_um = Some(Interval { median: 3.21, p05: 2.5, p95: 4.0 });
        let page = |wear: &WearEstimate| {
            let records = vec![record(wear.clone())];
            html(&Report { records, ..Report::default() })
        };
        let html_page = page(&wear);
        let words = "Transmission error due to wear</dt><dd>3.2 µm peak to peak, between 2.5 and 4.0 µm with 90 % probability";
        assert!(html_page.contains(words), "{html_page}");
        assert!(html_page.contains("<td>220 (180 to 250)</td>"), "{html_page}");
        wear.at_least_um = Some(180.0);
        let html_page = page(&wear);
        assert!(html_page.contains("<td>at least 180</td>"), "{html_page}");
    }
}
