//! Table output: aligned columns, at most 80 characters wide without additional ones.

use super::record::{AnalyzedRecord, by_channel};
use super::verdict::verdict;
use crate::asset::AssetSpec;
use crate::cli::CliError;
use crate::cli::output::{counted, printable};
use crate::estimate::WearStatus;
use crate::report::angle_words;
use crate::signal::{IndicatorScope, Indicators};

/// An additional column of `--columns`.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Column {
    Channel,
    File,
    /// Source of the shaft angle.
    Angle,
    Indicator(String),
}

/// Names of the additional columns that are not indicators.
const OTHERS: [&str; 3] = ["channel", "file", "angle"];

/// Indicators that every table has, with their headings.
const INDICATORS: [(&str, &str); 3] = [("rms", "RMS"), ("kurtosis", "kurtosis"), ("omx", "OMX")];

impl Column {
    /// Parses the column names of `--columns`.
    pub(super) fn parse(names: &[String], asset: Option<&AssetSpec>) -> Result<Vec<Self>, CliError> {
        let any = || Indicators::names(&IndicatorScope::default());
        let indicators = asset.map_or_else(any, AssetSpec::indicator_names);
        let column = |name: &String| match name.as_str() {
            "channel" => Ok(Self::Channel),
            "file" => Ok(Self::File),
            "angle" => Ok(Self::Angle),
            _ if indicators.contains(name) => Ok(Self::Indicator(name.clone())),
            _ => {
                let known = OTHERS.into_iter().chain(indicators.iter().map(String::as_str));
                let nearest = Indicators::nearest(name, known).join(", ");
                Err(CliError::Argument(format!(
                    "--columns is {name:?}, expected names of indicators, channel, file or angle; the nearest are {nearest}"
                )))
            }
        };
        names.iter().map(column).collect()
    }

    fn heading(&self) -> &str {
        match self {
            Self::Channel => "channel",
            Self::File => "file",
            Self::Angle => "angle",
            Self::Indicator(name) => name,
        }
    }

    fn value(&self, record: &AnalyzedRecord) -> String {
        match self {
            Self::Channel => record.channel.clone(),
            Self::File => printable(&record.file),
            Self::Angle => record.basis.shaft_angle.as_ref().map_or_else(none, angle_words),
            Self::Indicator(name) => number(record.indicators.get(name)),
        }
    }
}

/// Formats a block for each channel: its records in time order and a summary line.
pub(super) fn table(records: &[AnalyzedRecord], columns: &[Column]) -> String {
    let channels = by_channel(records);
    let blocks = channels.into_iter().map(|(channel, records)| block(channel, &records, columns));
    blocks.collect::<Vec<_>>().join("\n")
}

fn block(channel: &str, records: &[&AnalyzedRecord], columns: &[Column]) -> String {
    let [Some(first), Some(last)] = [records.first(), records.last()] else {
        return String::new();
    };
    let has_wear = records.iter().any(|record| record.wear.is_some());
    let further: Vec<(String, Vec<String>)> = columns
        .iter()
        .map(|column| {
            let values = records.iter().map(|record| column.value(record));
            (column.heading().to_owned(), values.collect())
        })
        .collect();
    let mut text = format!(
        "channel {channel} ({}): {}, {}\n",
        unit_words(&first.unit),
        counted(records.len() as u64, "record"),
        times(first, last),
    );
    let digits = records.len().to_string().len();
    let start = if first.start_time.is_some() { "start (UTC)" } else { "start" };
    text += &format!("{:>digits$} {start:<14} {:>6}", "#", "Hz");
    for (_, heading) in INDICATORS {
        text += &format!(" {heading:>7}");
    }
    for (heading, values) in &further {
        text += &format!(" {heading:>width$}", width = width(heading, values));
    }
    text += if has_wear { "  wear in µm, or status\n" } else { "\n" };
    for (n, record) in records.iter().enumerate() {
        let is_doubted = record.shaft_speed.is_some_and(|speed| speed.doubt.is_some());
        let doubt = if is_doubted { "?" } else { "" };
        let speed = record.shaft_speed_hz.map_or_else(none, |hz| format!("{hz:.2}{doubt}"));
        text += &format!("{:>digits$} {:<14} {speed:>6}", n + 1, record.time_text());
        for (name, heading) in INDICATORS {
            text +=
                &format!(" {:>width$}", number(record.indicators.get(name)), width = heading.len().max(7));
        }
        for (heading, values) in &further {
            text += &format!(" {:>width$}", values[n], width = width(heading, values));
        }
        if has_wear {
            text += &format!("  {}", wear(record));
        }
        text.truncate(text.trim_end().len());
        text.push('\n');
    }
    text += &format!("{}\n", verdict(records));
    text + &question(records).map_or_else(String::new, |question| format!("{question}\n"))
}

/// Describes the time range of records.
fn times(first: &AnalyzedRecord, last: &AnalyzedRecord) -> String {
    match first.start_time.zip(last.start_time) {
        Some((first, last)) if first == last => first.strftime("%Y-%m-%d %H:%M UTC").to_string(),
        Some((first, last)) => {
            format!("{} to {}", first.strftime("%Y-%m-%d %H:%M"), last.strftime("%Y-%m-%d %H:%M UTC"))
        }
        None => "without a time".to_owned(),
    }
}

/// Asks about teeth and speed where the lines of records contradict them and the verdict does not say so.
fn question(records: &[&AnalyzedRecord]) -> Option<String> {
    let is_told = records.last()?.wear.as_ref().is_some_and(|wear| wear.status == WearStatus::SpeedInDoubt);
    let mut doubted = records.iter().filter_map(|record| record.shaft_speed?.doubt_message());
    let count = doubted.clone().count();
    let question = doubted.next_back().filter(|_| !is_told)?;
    Some(format!("in {count} of {} records {question}", records.len()))
}

fn width(heading: &str, values: &[String]) -> usize {
    let widths = values.iter().map(|value| value.chars().count());
    widths.fold(heading.chars().count().max(8), usize::max)
}

/// Formats the depth with its interval or, without one, the status and its cause.
fn wear(record: &AnalyzedRecord) -> String {
    let Some(wear) = &record.wear else { return none() };
    let status = record.status().unwrap_or_default();
    match (wear.median_um, wear.low_um, wear.high_um) {
        (Some(_), Some(low), Some(high)) if wear.status != WearStatus::Estimated => {
            format!("{status} {low:.0} to {high:.0}")
        }
        (Some(_), _, _) if wear.at_least_um.is_some() => {
            format!("at least {:.0}", wear.at_least_um.unwrap_or_default())
        }
        (Some(median), Some(low), Some(high)) => format!("{median:.0} ({low:.0} to {high:.0})"),
        _ => {
            let why = record.cause().or_else(|| wear.short_reason.clone());
            why.map_or_else(|| status.clone(), |why| format!("{status}: {why}"))
        }
    }
}

/// Formats a number with four significant digits in at most 8 characters.
fn number(value: Option<f64>) -> String {
    let Some(value) = value else { return none() };
    let size = value.abs();
    if value != 0.0 && !(1e-3..1e5).contains(&size) {
        return format!("{value:.1e}");
    }
    let before_point = if size < 1.0 { 0 } else { size.log10() as usize + 1 };
    format!("{value:.*}", 4usize.saturating_sub(before_point))
}

fn none() -> String {
    "-".to_owned()
}

fn unit_words(unit: &str) -> &str {
    match unit {
        "" | "1" => "no unit",
        unit => unit,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_four_digits_in_at_most_8_characters() {
        let of = |value| number(Some(value));
        assert_eq!(
            [of(0.0), of(0.01234), of(1.0), of(12.345), of(99_999.4)],
            ["0.0000", "0.0123", "1.000", "12.35", "99999"]
        );
        assert_eq!([of(1e-9), of(-1.5e300)], ["1.0e-9", "-1.5e300"]);
        assert!([1e-300, -0.5, 99_999.9, -99_999.0].into_iter().all(|value| of(value).len() <= 8));
        assert_eq!(number(None), "-");
    }

    #[test]
    fn unknown_columns_are_rejected_with_the_nearest_names() {
        let parse =
            |names: &[&str]| Column::parse(&names.iter().map(ToString::to_string).collect::<Vec<_>>(), None);
        assert_eq!(parse(&["fm4", "file"]).unwrap(), [Column::Indicator("fm4".into()), Column::File]);
        let error = parse(&["kurtossis"]).unwrap_err().to_string();
        assert!(
            error.contains("--columns is \"kurtossis\"") && error.contains("the nearest are kurtosis"),
            "{error}"
        );
    }
}
