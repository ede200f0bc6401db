//! The structure of a CSV file, derived from its beginning: the field separator, the first line of samples,
//! and the columns.

use csv::ReaderBuilder;
use flankwatch_signal::Motion;

use super::RecordingError;
use super::csv_clock::Clock;
use super::csv_field::{Decimals, Moment, name_and_unit, parse_date, seconds_of, text, unit, unit_field};
use super::csv_layout::{CsvLayout, MAX_COLUMNS};
use super::decoded_block::MAX_CHANNEL_BYTES;
use super::error::shortened;

/// Number of bytes examined before the samples are read.
pub(super) const BEGINNING_BYTES: usize = 1 << 16;

/// Number of lines searched for the first sample.
const MAX_HEAD_LINES: usize = 500;

/// Number of lines of samples that must be consistent before unnamed columns count as a clock.
const CLOCK_LINES: usize = 16;

/// Role of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColumnRole {
    /// Samples.
    Channel,
    /// The time of each line.
    Time,
    /// Neither channel nor time.
    Ignored,
}

/// The structure of a file.
#[derive(Debug, Clone)]
pub(super) struct Head {
    /// Field separator; a space means any number of spaces and tabs.
    pub(super) separator: u8,
    /// Number of lines before the first samples.
    pub(super) lines: u64,
    /// Name and unit of each column.
    pub(super) columns: Vec<Column>,
    /// The time columns.
    pub(super) clock: Option<Clock>,
    /// The sampling rate stated in a line before the header.
    pub(super) stated_rate: Option<StatedRate>,
}

/// A sampling rate stated in a line before the header.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum StatedRate {
    /// In hertz.
    Known(f64),
    /// A number like `12,800`, whose comma is a decimal sign or separates thousands.
    Ambiguous,
}

/// One column.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Column {
    /// Text in the header, including the unit in brackets.
    pub(super) label: String,
    pub(super) name: String,
    pub(super) unit: Option<String>,
}

impl Head {
    /// Analyses the first bytes of a file.
    pub(super) fn read(beginning: &[u8], layout: CsvLayout) -> Result<Self, RecordingError> {
        let text = text(beginning.strip_prefix(b"\xef\xbb\xbf").unwrap_or(beginning));
        let lines: Vec<&str> = text.lines().take(MAX_HEAD_LINES).collect();
        let separators = [b';', b'\t', b',', b' '];
        let found = separators
            .iter()
            .find_map(|&separator| first_samples(&lines, separator, 2).map(|line| (separator, line)));
        let found = found.or_else(|| first_samples(&lines, b',', 1).map(|line| (b',', line)));
        let found =
            found.map(|found| if has_decimal_commas(&lines, found) { (b';', found.1) } else { found });
        let (separator, line) = found.unwrap_or_else(|| fallback_structure(&lines));
        let first = lines.get(line).map(|line| fields(line, separator)).unwrap_or_default();
        let above = lines[..line.min(lines.len())].iter().rfind(|line| !line.trim().is_empty());
        // A separator may end every line. But if the last column has a name, an empty field in it is a
        // missing value.
        let is_named = above.is_some_and(|line| {
            let names = fields(line, separator);
            names.len() == first.len() && names.last().is_some_and(|name| !name.is_empty())
        });
        let ends_open = first.len() > 1 && first.last().is_some_and(String::is_empty) && !is_named;
        let width = first.len() - usize::from(ends_open);
        check_header(&lines, line, separator, width)?;
        let (names, units, preamble) = header(&lines[..line.min(lines.len())], separator, width);
        let width = if width == 0 { names.as_ref().map_or(0, Vec::len) } else { width };
        if width > MAX_COLUMNS {
            let what = format!("{width} columns, expected at most {MAX_COLUMNS}");
            return Err(RecordingError::CsvLine { line: line as u64 + 1, what });
        }
        let columns = columns(names.as_deref(), &units, width, line)?;
        let samples: Vec<Vec<String>> = lines[line.min(lines.len())..]
            .iter()
            .filter(|line| !line.trim().is_empty())
            .take(CLOCK_LINES)
            .map(|line| fields(line, separator))
            .collect();
        let clock = match layout.time_index() {
            None => clock(&columns, names.is_some(), &samples, separator),
            Some(None) => None,
            Some(Some(at)) if at < columns.len() => Some(clock_at(&columns, at, &samples)),
            Some(Some(at)) => {
                let expected = "the number of a column, or 0 if there is no time column";
                return Err(RecordingError::field("time_column", at + 1, expected));
            }
        };
        let mut decimals = Decimals::separated_by(separator);
        for field in samples.iter().flatten() {
            decimals.parse::<f64>(field);
        }
        let stated_rate = stated_rate(&lines[..preamble], decimals.has_comma());
        Ok(Self { separator, lines: line as u64, clock, columns, stated_rate })
    }
}

/// Splits one line into fields.
fn fields(line: &str, separator: u8) -> Vec<String> {
    let squeezed;
    let line = if separator == b' ' {
        squeezed = line.split_whitespace().collect::<Vec<_>>().join(" ");
        &squeezed
    } else {
        line
    };
    let mut reader = ReaderBuilder::new()
        .has_headers(false)
        .delimiter(separator)
        .trim(csv::Trim::All)
        .from_reader(line.as_bytes());
    let record = reader.records().next().and_then(Result::ok).unwrap_or_default();
    record.iter().map(str::to_owned).collect()
}

/// Returns the number of columns of a line of samples: numbers and times, possibly followed by an empty
/// field. `None` if it is not a line of samples.
fn sample_columns(line: &str, separator: u8) -> Option<usize> {
    let fields = fields(line, separator);
    let values = match fields.split_last() {
        Some((last, others)) if last.is_empty() && !others.is_empty() => others,
        _ => &fields[..],
    };
    let mut decimals = Decimals::separated_by(separator);
    let mut numbers = 0;
    for field in values {
        if decimals.parse::<f64>(field).is_some() {
            numbers += 1;
        } else if parse_date(field).is_none() {
            Moment::parse(field)?;
        }
    }
    (numbers > 0).then_some(values.len())
}

/// Returns the first line of samples with at least `min_columns` columns whose next line has as many.
fn first_samples(lines: &[&str], separator: u8, min_columns: usize) -> Option<usize> {
    let at = |line: usize| sample_columns(lines[line], separator).filter(|&columns| columns >= min_columns);
    (0..lines.len()).find(|&line| {
        let Some(columns) = at(line) else { return false };
        let next = (line + 1..lines.len()).find(|&next| !lines[next].trim().is_empty());
        next.is_none_or(|next| {
            // Below as many names, a second line of another number of columns is at fault, not the first.
            at(next) == Some(columns)
                || sample_columns(lines[next], separator).is_some()
                    && has_names(lines, line, separator, columns)
        })
    })
}

/// Whether the line above samples has a name for each of their columns.
fn has_names(lines: &[&str], line: usize, separator: u8, columns: usize) -> bool {
    let above = line.checked_sub(1).map(|above| fields(lines[above], separator));
    let is_name = |name: &String| !name.is_empty() && name.parse::<f64>().is_err();
    above.is_some_and(|names| names.len() == columns && names.iter().all(is_name))
}

/// Returns whether the commas that seem to separate two columns are decimal signs in a single one: `-0,5` and
/// `1,05` are no pairs of whole numbers, and a single unit of vibration above belongs to one column. The line
/// above must not name two columns.
fn has_decimal_commas(lines: &[&str], (separator, line): (u8, usize)) -> bool {
    let above = lines[..line].iter().map(|line| line.trim()).rfind(|line| !line.is_empty());
    if separator != b',' || above.is_some_and(|line| line.contains(',')) {
        return false;
    }
    let unit_above = above.and_then(|line| unit_field(line).or(name_and_unit(line).1));
    let is_vibration = unit_above.is_some_and(|unit| Motion::of_unit(&unit).is_some());
    let samples = lines[line..].iter().map(|line| line.trim()).filter(|line| !line.is_empty());
    let parts: Option<Vec<(&str, &str)>> = samples.map(|line| line.split_once(',')).collect();
    let is_whole = |digits: &str| !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit());
    let is_number = |(whole, digits): &(&str, &str)| {
        is_whole(whole.strip_prefix(['-', '+']).unwrap_or(whole)) && is_whole(digits)
    };
    let is_fraction = |(whole, digits): &(&str, &str)| {
        *whole == "-0"
            || (digits.len() > 1 && digits.starts_with('0') && !digits.bytes().all(|byte| byte == b'0'))
    };
    parts.is_some_and(|parts| parts.iter().all(is_number) && (is_vibration || parts.iter().any(is_fraction)))
}

/// Rejects samples whose number of columns differs from that of the names directly above.
fn check_header(lines: &[&str], line: usize, separator: u8, width: usize) -> Result<(), RecordingError> {
    let Some(above) = line.checked_sub(1).and_then(|above| lines.get(above)) else {
        return Ok(());
    };
    let names = fields(above, separator);
    let named = names.len() - usize::from(names.last().is_some_and(String::is_empty));
    let are_words = names[..named].iter().all(|name| !name.is_empty() && name.parse::<f64>().is_err());
    if width > 0 && named > 1 && named != width && are_words {
        return Err(RecordingError::CsvLine {
            line: line as u64 + 1,
            what: format!("{width} fields, expected {named} as in the line above"),
        });
    }
    Ok(())
}

/// Returns the separator and start if no line of samples is found: the first line is taken as the header, so
/// that errors name line and column of what follows.
fn fallback_structure(lines: &[&str]) -> (u8, usize) {
    let first = lines.first().copied().unwrap_or_default();
    let separator =
        [b';', b'\t'].into_iter().find(|&separator| first.contains(char::from(separator))).unwrap_or(b',');
    let is_header = fields(first, separator).iter().any(|field| field.parse::<f64>().is_err());
    (separator, usize::from(is_header))
}

type Units = Vec<Option<String>>;
type Header = (Option<Vec<String>>, Units, usize);

/// Names of the columns, their units if given in their own line, and the number of lines before both.
fn header(before: &[&str], separator: u8, width: usize) -> Header {
    let mut rows =
        before.iter().enumerate().rev().filter(|(_, line)| !line.trim().is_empty()).map(|(at, line)| {
            let mut row = fields(line, separator);
            if width > 0 && row.len() == width + 1 && row.last().is_some_and(String::is_empty) {
                row.pop();
            }
            (at, row)
        });
    let fits = |row: &Vec<String>| width == 0 || row.len() == width;
    // A line with the rate names no column.
    let names =
        |(at, row): &(usize, Vec<String>)| fits(row) && stated_rate(&before[*at..=*at], false).is_none();
    let Some((at, last)) = rows.next().filter(names) else {
        return (None, Vec::new(), before.len());
    };
    let are_units = last.iter().all(|field| field.is_empty() || unit_field(field).is_some())
        && last.iter().any(|field| !field.is_empty());
    match rows.next().filter(|(_, row)| are_units && fits(row)) {
        Some((at, names)) => (Some(names), last.iter().map(|field| unit_field(field)).collect(), at),
        None => (Some(last), Vec::new(), at),
    }
}

fn columns(
    names: Option<&[String]>,
    units: &[Option<String>],
    width: usize,
    line: usize,
) -> Result<Vec<Column>, RecordingError> {
    let mut columns: Vec<Column> = Vec::with_capacity(width);
    for at in 0..width {
        let label = names.and_then(|names| names.get(at)).filter(|name| !name.is_empty());
        let label = label.cloned().unwrap_or_else(|| (at + 1).to_string());
        if label.len() > MAX_CHANNEL_BYTES || label.chars().any(char::is_control) {
            return Err(RecordingError::CsvLine {
                line: line as u64,
                what: format!(
                    "column name {:?}, expected at most 256 bytes without control characters",
                    shortened(&label)
                ),
            });
        }
        let (stem, of_name) = name_and_unit(&label);
        // Two columns of the same name would be one channel.
        let is_free = |name: &String| columns.iter().all(|column| column.name != *name);
        let numbered = (2..).map(|number| format!("{stem}_{number}"));
        let name = std::iter::once(stem.to_owned()).chain(numbered).find(is_free).unwrap_or_default();
        columns.push(Column { unit: units.get(at).cloned().flatten().or(of_name), name, label });
    }
    Ok(columns)
}

/// Names of time columns.
const TIME_NAMES: [&str; 22] = [
    "time",
    "t",
    "timestamp",
    "datetime",
    "date",
    "elapsed",
    "sec",
    "second",
    "seconds",
    "zeit",
    "zeitstempel",
    "zeitpunkt",
    "uhrzeit",
    "datum",
    "sekunde",
    "sekunden",
    "temps",
    "tiempo",
    "tempo",
    "tijd",
    "tid",
    "czas",
];

/// Returns `Some` if a column's name marks it as a time rather than a signal, with the unit in the name: `t`,
/// `time (s)`, `Zeit [ms]`, `timestamp_ns`, `Time - a1`, but not `t_oil`.
fn time_name(column: &Column) -> Option<Option<&'static str>> {
    let name = column.label.to_lowercase();
    if column.unit.as_deref().is_some_and(|unit| seconds_of(unit).is_some()) {
        return Some(None);
    }
    let mut words = name.split([' ', '(', '[', '_', ')', ']', '/', ',']).filter(|word| !word.is_empty());
    let is_time = TIME_NAMES.contains(&words.next().unwrap_or_default());
    let of_time = |word| unit(word).filter(|unit| seconds_of(unit).is_some());
    let units: Vec<Option<&'static str>> = words.filter(|word| *word != "utc").map(of_time).collect();
    // `Time - a1` is the time of channel `a1`.
    let of_channel = ["time", "zeit"].iter().any(|stem| {
        name.strip_prefix(stem).is_some_and(|rest| rest.trim_start().starts_with(['-', ':', '/', '_']))
    });
    ((is_time && units.iter().all(Option::is_some)) || (of_channel && column.unit.is_none()))
        .then(|| units.into_iter().flatten().next())
}

fn clock(columns: &[Column], has_header: bool, samples: &[Vec<String>], separator: u8) -> Option<Clock> {
    let is_moment = |at: &usize| matches!(clock_at(columns, *at, samples), Clock::Moment(_));
    let is_named = |at: &usize| has_header && time_name(&columns[*at]).is_some();
    let all = 0..columns.len();
    let first = |at: usize| samples.first().and_then(|row| row.get(at));
    let is_date = |at: &usize| first(*at).is_some_and(|field| parse_date(field).is_some());
    let is_time_of_day = |at: &usize| {
        matches!(first(*at).and_then(|field| Moment::parse(field)), Some(Moment::SinceMidnight(_)))
    };
    if let (Some(date), Some(time)) = (all.clone().find(is_date), all.clone().find(is_time_of_day)) {
        return Some(Clock::DateAndTime { date, time });
    }
    if let Some(at) = all.clone().find(is_moment).or_else(|| all.clone().find(is_named)) {
        return Some(clock_at(columns, at, samples));
    }
    let hours = |column: &Column| {
        matches!(column.name.to_lowercase().as_str(), "h" | "hour" | "hours" | "stunde" | "std")
    };
    let may_be = columns.len() > 4 && (!has_header || hours(&columns[0]));
    (may_be && Clock::Parts.rises(samples, separator)).then_some(Clock::Parts)
}

/// Determines the representation of the time in a column.
fn clock_at(columns: &[Column], at: usize, samples: &[Vec<String>]) -> Clock {
    let first = samples.first().and_then(|row| row.get(at));
    if first.is_some_and(|field| Moment::parse(field).is_some()) {
        return Clock::Moment(at);
    }
    let column = &columns[at];
    let stated = column.unit.as_deref().or_else(|| time_name(column).flatten()).and_then(seconds_of);
    let number: f64 = first.and_then(|field| field.replace(',', ".").parse().ok()).unwrap_or(0.0);
    // Numbers this large count from 1970, in the unit that matches their size.
    let guessed = match number {
        1e17.. => 1e-9,
        1e14.. => 1e-6,
        1e11.. => 1e-3,
        _ => 1.0,
    };
    Clock::Seconds { column: at, factor: stated.unwrap_or(guessed) }
}

/// Returns a unit of rates in hertz; `None` if it is not one.
fn hertz_of(unit: &str) -> Option<f64> {
    let bare = unit.trim_matches(['[', ']', '(', ')', ',', '.']).to_lowercase();
    match bare.as_str() {
        "hz" | "s/s" | "sa/s" | "sps" => Some(1.0),
        "khz" | "ks/s" | "ksa/s" | "ksps" | "k" => Some(1e3),
        "mhz" | "ms/s" | "msa/s" | "msps" => Some(1e6),
        _ => None,
    }
}

/// Returns the rate from a line such as `Sample rate: 12.8 kS/s`, `fs=25600` or `Abtastrate;12,8;kHz`. A
/// comma before three digits is a decimal sign only if it is one in the samples.
fn stated_rate(lines: &[&str], has_decimal_comma: bool) -> Option<StatedRate> {
    lines.iter().find_map(|line| {
        let at = line.find([':', '=', ';', '\t', ','])?;
        let (key, value) = (&line[..at], &line[at + 1..]);
        let (key, of_key) = name_and_unit(key.trim_matches(['#', '%', '"', ' ', '/']));
        let key: String = key.to_lowercase().chars().filter(|c| c.is_alphanumeric()).collect();
        let known = [
            "fs",
            "samplerate",
            "samplingrate",
            "samplingfrequency",
            "samplefrequency",
            "abtastrate",
            "abtastfrequenz",
        ];
        if !known.contains(&key.trim_end_matches("hz")) {
            return None;
        }
        let mut words = value.split([';', '\t', ' ', '"']).filter(|word| !word.is_empty());
        let word = words.next()?;
        // The unit is a word of its own, or follows the number directly or after a comma.
        let number = word.trim_end_matches(|c: char| c.is_alphabetic() || c == '/');
        let of_value = Some(&word[number.len()..]).filter(|unit| !unit.is_empty()).or(words.next());
        let number = number.trim_end_matches(',');
        let after_comma = number.rsplit_once(',').map(|(_, digits)| digits);
        if !has_decimal_comma
            && after_comma
                .is_some_and(|after| after.len() == 3 && after.bytes().all(|byte| byte.is_ascii_digit()))
        {
            return Some(StatedRate::Ambiguous);
        }
        let number: f64 = Decimals::separated_by(b';').parse(number)?;
        let factor = [of_value, of_key.as_deref()].into_iter().flatten().find_map(hertz_of).unwrap_or(1.0);
        Some(number * factor).filter(|rate| *rate > 0.0 && rate.is_finite()).map(StatedRate::Known)
    })
}
