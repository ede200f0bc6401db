//! Fields of a CSV file: numbers with a decimal point or comma, times, units.

use std::borrow::Cow;
use std::str::FromStr;

use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;

/// Units in a header or in a line below it, and their canonical spelling.
const UNITS: [(&str, &str); 50] = [
    ("m/s2", "m/s2"),
    ("m/s^2", "m/s2"),
    ("m/s**2", "m/s2"),
    ("m/s²", "m/s2"),
    ("mm/s2", "mm/s2"),
    ("mm/s^2", "mm/s2"),
    ("mm/s²", "mm/s2"),
    ("g", "g"),
    ("mg", "mg"),
    ("m/s", "m/s"),
    ("mm/s", "mm/s"),
    ("m", "m"),
    ("mm", "mm"),
    ("µm", "um"),
    ("um", "um"),
    ("v", "V"),
    ("mv", "mV"),
    ("a", "A"),
    ("ma", "mA"),
    ("n", "N"),
    ("kn", "kN"),
    ("nm", "Nm"),
    ("n·m", "Nm"),
    ("pa", "Pa"),
    ("kpa", "kPa"),
    ("mpa", "MPa"),
    ("bar", "bar"),
    ("rpm", "rpm"),
    ("1/min", "rpm"),
    ("u/min", "rpm"),
    ("hz", "Hz"),
    ("khz", "kHz"),
    ("°c", "degC"),
    ("degc", "degC"),
    ("c", "degC"),
    ("k", "K"),
    ("%", "%"),
    ("1", "1"),
    ("-", "1"),
    ("s", "s"),
    ("sec", "s"),
    ("sek", "s"),
    ("seconds", "s"),
    ("ms", "ms"),
    ("us", "us"),
    ("µs", "us"),
    ("μs", "us"),
    ("μm", "um"),
    ("ns", "ns"),
    ("utc", "utc"),
];

/// Returns the canonical spelling of a unit, without brackets; `None` if it is unknown.
pub(super) fn unit(text: &str) -> Option<&'static str> {
    let bare = text.trim().trim_start_matches(['[', '(']).trim_end_matches([']', ')']).trim();
    let bare = bare.to_lowercase();
    UNITS.iter().find(|(name, _)| *name == bare).map(|(_, unit)| *unit)
}

/// Splits a column's name from the unit in brackets at its end.
pub(super) fn name_and_unit(name: &str) -> (&str, Option<&'static str>) {
    let ending = [('[', ']'), ('(', ')')].into_iter().find_map(|(open, close)| {
        let (stem, inner) = name.strip_suffix(close)?.rsplit_once(open)?;
        Some((stem.trim_end(), unit(inner)?))
    });
    match ending {
        Some((stem, unit)) if !stem.is_empty() => (stem, Some(unit)),
        _ => (name, None),
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
    fn units_are_distinguished_from_words() {
        assert_eq!(name_and_unit("acc [m/s²]"), ("acc", Some("m/s2")));
        assert_eq!(name_and_unit("a1 (g)"), ("a1", Some("g")));
        assert_eq!(name_and_unit("a1 (left)"), ("a1 (left)", None));
        assert_eq!(name_and_unit("[g]"), ("[g]", None));
        assert_eq!((unit("(mm/s)"), unit("left")), (Some("mm/s"), None));
    }
}
