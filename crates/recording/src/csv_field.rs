//! Fields of a CSV file: numbers with a decimal point or comma, times, units.

use std::borrow::Cow;
use std::str::FromStr;

use jiff::Timestamp;
use jiff::civil::{Date, DateTime};
use jiff::tz::TimeZone;

/// Units in a header or in a line below it: the canonical spelling of each, then others.
const UNITS: [&[&str]; 34] = [
    &["m/s2", "m/s^2", "m/s**2", "m/s²", "m/s/s", "m/sec2", "m/sec^2", "m/sec²"],
    &["mm/s2", "mm/s^2", "mm/s**2", "mm/s²", "mm/s/s", "mm/sec2", "mm/sec^2", "mm/sec²"],
    &["g"],
    &["mg"],
    &["m/s", "m/sec"],
    &["mm/s", "mm/sec"],
    &["in/s", "in/sec", "inch/s", "inch/sec", "ips"],
    &["m"],
    &["mm"],
    &["um", "µm", "μm"],
    &["nm"],
    &["V"],
    &["mV"],
    &["A"],
    &["mA"],
    &["N"],
    &["kN"],
    &["Nm", "N·m"],
    &["Pa"],
    &["mPa"],
    &["kPa"],
    &["MPa"],
    &["bar"],
    &["rpm", "1/min", "U/min"],
    &["Hz"],
    &["kHz"],
    &["degC", "°C", "C"],
    &["K"],
    &["%"],
    &["1", "-"],
    &["s", "sec", "sek", "seconds"],
    &["ms"],
    &["us", "µs", "μs"],
    &["ns"],
];

/// Returns the canonical spelling of a unit; `None` if it is unknown. The case of letters counts only if it
/// distinguishes two units, such as mPa and MPa.
pub(super) fn unit(text: &str) -> Option<&'static str> {
    let spelled = |is_same: fn(&str, &str) -> bool| {
        UNITS.iter().filter(move |unit| unit.iter().any(|name| is_same(name, text))).map(|unit| unit[0])
    };
    let mut alike = spelled(str::eq_ignore_ascii_case);
    spelled(str::eq).next().or_else(|| alike.next().filter(|_| alike.next().is_none()))
}

/// Returns the text within a pair of brackets.
fn within(text: &str, open: char, close: char) -> Option<&str> {
    Some(text.strip_prefix(open)?.strip_suffix(close)?.trim())
}

/// Returns the unit in square brackets: as it is if it is unknown; `None` if the text is a number, as that of
/// a sensor.
fn in_square_brackets(text: &str) -> Option<String> {
    match unit(text) {
        Some(known) => Some(known.to_owned()),
        None if text.bytes().all(|byte| byte.is_ascii_digit()) => None,
        None => Some(text.to_owned()),
    }
}

/// Returns the unit in a field of a line of units; `None` if the field is none.
pub(super) fn unit_field(field: &str) -> Option<String> {
    if let Some(text) = within(field, '[', ']') {
        return in_square_brackets(text);
    }
    unit(within(field, '(', ')').unwrap_or(field)).map(str::to_owned)
}

/// Splits a column's name from the unit in brackets at its end. An unknown unit remains in the name too.
///
/// Text in parentheses is a unit only if it is a known one, and no single letter that may be a direction or a
/// number of the sensor, such as those of `(V)` and `(1)`.
pub(super) fn name_and_unit(name: &str) -> (&str, Option<String>) {
    let split = |open: char, close: char| {
        let (stem, text) = name.strip_suffix(close)?.rsplit_once(open)?;
        Some((stem.trim_end(), text.trim())).filter(|(stem, _)| !stem.is_empty())
    };
    if let Some((stem, text)) = split('[', ']') {
        return (if unit(text).is_some() { stem } else { name }, in_square_brackets(text));
    }
    let in_parentheses =
        split('(', ')').filter(|(_, text)| text.chars().count() > 1 || ["g", "G", "m", "s"].contains(text));
    match in_parentheses.and_then(|(stem, text)| Some((stem, unit(text)?))) {
        Some((stem, unit)) => (stem, Some(unit.to_owned())),
        None => (name, None),
    }
}

/// Returns a unit of time in seconds; `None` if it is not one.
pub(super) fn seconds_of(unit: &str) -> Option<f64> {
    match unit {
        "s" => Some(1.0),
        "ms" => Some(1e-3),
        "us" => Some(1e-6),
        "ns" => Some(1e-9),
        _ => None,
    }
}

/// Decodes a field as UTF-8, or else as Latin-1.
pub(super) fn text(bytes: &[u8]) -> Cow<'_, str> {
    match std::str::from_utf8(bytes) {
        Ok(text) => Cow::Borrowed(text),
        Err(_) => Cow::Owned(bytes.iter().map(|&byte| char::from(byte)).collect()),
    }
}

/// The decimal separator of a file: a comma only if it does not separate fields, and never both.
#[derive(Debug, Clone, Copy)]
pub(super) struct Decimals {
    comma_allowed: bool,
    seen: Option<char>,
}

impl Decimals {
    pub(super) fn separated_by(separator: u8) -> Self {
        Self { comma_allowed: separator != b',', seen: None }
    }

    /// Parses the number in a field.
    pub(super) fn parse<T: FromStr>(&mut self, field: &str) -> Option<T> {
        let Some(sign) = field.chars().find(|c| matches!(c, '.' | ',')) else {
            return field.parse().ok();
        };
        let fits = self.seen.is_none_or(|seen| seen == sign);
        if !fits
            || (sign == ',' && (!self.comma_allowed || field.contains('.') || field.matches(',').count() > 1))
        {
            return None;
        }
        let value = if sign == ',' { field.replace(',', ".").parse() } else { field.parse() }.ok()?;
        self.seen = Some(sign);
        Some(value)
    }

    /// Returns whether a number with a decimal comma was parsed.
    pub(super) fn has_comma(self) -> bool {
        self.seen == Some(',')
    }

    /// Returns the description of a valid number for errors.
    pub(super) fn expected(self) -> &'static str {
        match self.seen {
            Some(',') => "a finite number with a decimal comma",
            _ => "a finite number with a decimal point",
        }
    }
}

/// Parses a date such as `2026-03-01` or `01.03.2026`.
pub(super) fn parse_date(field: &str) -> Option<Date> {
    if !(8..=10).contains(&field.len()) {
        return None;
    }
    match field.split('.').collect::<Vec<_>>()[..] {
        [day, month, year] => Date::new(year.parse().ok()?, month.parse().ok()?, day.parse().ok()?).ok(),
        _ if field.contains('-') => field.parse().ok(),
        _ => None,
    }
}

/// A time in nanoseconds: since 1970, or since midnight if only the time of day is given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Moment {
    Since1970(i64),
    SinceMidnight(i64),
}

impl Moment {
    /// Parses RFC 3339, `2026-03-01 08:00:00.5`, `01.03.2026 08:00:00,5` or `08:00:00.5`; a time without a
    /// zone is UTC.
    pub(super) fn parse(field: &str) -> Option<Self> {
        if field.len() > 40 || !field.contains(':') || !field.starts_with(|c: char| c.is_ascii_digit()) {
            return None;
        }
        let field = field.replace(',', ".");
        if let Ok(time) = field.parse::<Timestamp>() {
            return i64::try_from(time.as_nanosecond()).ok().map(Self::Since1970);
        }
        let date_time = |text: &str| {
            let utc = || text.parse::<DateTime>().ok()?.to_zoned(TimeZone::UTC).ok();
            let time = text.parse().ok().or_else(|| Some(utc()?.timestamp()))?;
            i64::try_from(Timestamp::as_nanosecond(time)).ok().map(Self::Since1970)
        };
        let (date, time) = field.split_once([' ', 'T']).unwrap_or(("", &field));
        if date.is_empty() {
            let time: jiff::civil::Time = time.parse().ok()?;
            let seconds =
                i64::from(time.hour()) * 3600 + i64::from(time.minute()) * 60 + i64::from(time.second());
            return Some(Self::SinceMidnight(seconds * 1_000_000_000 + i64::from(time.subsec_nanosecond())));
        }
        let parts: Vec<&str> = date.split('.').collect();
        match parts[..] {
            [day, month, year] => date_time(&format!("{year}-{month:0>2}-{day:0>2}T{time}")),
            _ => date_time(&format!("{date}T{time}")),
        }
    }

    /// Returns a time of day on a date; `None` if the time has a date of its own.
    pub(super) fn on(self, date: Date) -> Option<Self> {
        let Self::SinceMidnight(ns) = self else { return None };
        let midnight_ns = date.to_zoned(TimeZone::UTC).ok()?.timestamp().as_nanosecond();
        i64::try_from(midnight_ns + i128::from(ns)).ok().map(Self::Since1970)
    }

    pub(super) fn nanoseconds(self) -> i64 {
        match self {
            Self::Since1970(ns) | Self::SinceMidnight(ns) => ns,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_one_decimal_sign_in_a_file() {
        let mut decimals = Decimals::separated_by(b';');
        assert_eq!(decimals.parse::<f32>("-1,5e2"), Some(-150.0));
        assert_eq!(decimals.parse::<f32>("7"), Some(7.0));
        assert_eq!(decimals.parse::<f32>("1.5"), None);
        assert_eq!(decimals.parse::<f32>("1,234,5"), None);
        assert_eq!(decimals.expected(), "a finite number with a decimal comma");
        let mut decimals = Decimals::separated_by(b';');
        assert_eq!(decimals.parse::<f32>("1.5"), Some(1.5));
        assert_eq!(decimals.parse::<f32>("1,234"), None);
        assert_eq!(Decimals::separated_by(b',').parse::<f32>("1,5"), None);
        assert_eq!(Decimals::separated_by(b';').parse::<f32>("1.234,5"), None);
    }

    #[test]
    fn common_time_formats_are_parsed() {
        let second = 1_000_000_000;
        let day = Moment::Since1970(86_400 * second + second / 2);
        for text in [
            "1970-01-02T00:00:00.5Z",
            "1970-01-02 00:00:00.5",
            "1970-01-02T01:00:00.5+01:00",
            "02.01.1970 00:00:00,5",
        ] {
            assert_eq!(Moment::parse(text), Some(day), "{text}");
        }
        assert_eq!(Moment::parse("01:00:00.25"), Some(Moment::SinceMidnight(3600 * second + second / 4)));
        for text in ["1.5", "25:00:00", "x:y", "2026-13-01 00:00:00", ""] {
            assert_eq!(Moment::parse(text), None, "{text}");
        }
    }

    #[test]
    fn dates_have_a_time_in_another_column() {
        for text in ["1970-01-02", "02.01.1970", "2.1.1970"] {
            let date = parse_date(text).unwrap_or_else(|| panic!("{text}"));
            let time = Moment::parse("01:00:00.25").and_then(|time| time.on(date));
            assert_eq!(time, Some(Moment::Since1970(90_000_250_000_000)), "{text}");
            assert_eq!(Moment::parse("1970-01-02T00:00:00Z").and_then(|time| time.on(date)), None);
        }
        for text in ["19700102", "3/1/2026", "32.01.2026", "1.5", "1.2.3.2026", ""] {
            assert_eq!(parse_date(text), None, "{text}");
        }
    }

    #[test]
    fn units_are_distinguished_from_words() {
        for (name, stem, unit) in [
            ("acc [m/s²]", "acc", Some("m/s2")),
            ("a1 (g)", "a1", Some("g")),
            ("ACC (M/S2)", "ACC", Some("m/s2")),
            ("vel [in/s]", "vel", Some("in/s")),
            ("vel (IPS)", "vel", Some("in/s")),
            ("vel (mm/sec)", "vel", Some("mm/s")),
            ("ch1 (mV)", "ch1", Some("mV")),
            ("Zeit (s)", "Zeit", Some("s")),
            ("speed (rpm)", "speed", Some("rpm")),
            ("ch1 [V]", "ch1", Some("V")),
            ("ratio [-]", "ratio", Some("1")),
            ("a1 (left)", "a1 (left)", None),
            ("[g]", "[g]", None),
            // Directions and numbers of sensors.
            ("Motor DE (V)", "Motor DE (V)", None),
            ("Motor DE (A)", "Motor DE (A)", None),
            ("Motor DE (H)", "Motor DE (H)", None),
            ("Mast (N)", "Mast (N)", None),
            ("Motor (M)", "Motor (M)", None),
            ("Motor (S)", "Motor (S)", None),
            ("Acc (1)", "Acc (1)", None),
            ("Acc (-)", "Acc (-)", None),
            ("Acc [2]", "Acc [2]", None),
            ("Acc []", "Acc []", None),
            // A unit that is stated is never replaced by another.
            ("vel [furlong/s]", "vel [furlong/s]", Some("furlong/s")),
            ("p [mpa]", "p [mpa]", Some("mpa")),
        ] {
            let (found, found_unit) = name_and_unit(name);
            assert_eq!((found, found_unit.as_deref()), (stem, unit), "{name}");
        }
        for (field, unit) in [
            ("(mm/s)", Some("mm/s")),
            ("[ V ]", Some("V")),
            ("V", Some("V")),
            ("[furlong/s]", Some("furlong/s")),
            ("left", None),
            ("[7]", None),
        ] {
            assert_eq!(unit_field(field).as_deref(), unit, "{field}");
        }
    }

    #[test]
    fn the_case_of_letters_counts_where_it_distinguishes_units() {
        for (text, expected) in [
            ("mPa", Some("mPa")),
            ("MPa", Some("MPa")),
            ("kpa", Some("kPa")),
            ("MPA", None),
            ("nm", Some("nm")),
            ("Nm", Some("Nm")),
            ("NM", None),
            ("v", Some("V")),
            ("MM/S", Some("mm/s")),
            ("m/sec^2", Some("m/s2")),
        ] {
            assert_eq!(unit(text), expected, "{text}");
        }
    }
}
