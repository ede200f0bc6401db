//! The time columns of a CSV file.

use super::csv_field::{Decimals, Moment, parse_date};

/// Above this number of seconds, a time counts from 1970: no recording is that long.
const SINCE_1970_S: f64 = 1e8;

/// Location and representation of the time in a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Clock {
    /// Seconds, or fractions of them, as a number.
    Seconds {
        /// Index of the column.
        column: usize,
        /// Seconds per unit.
        factor: f64,
    },
    /// A time of day, or a date and a time.
    Moment(usize),
    /// A date and a time of day.
    DateAndTime {
        /// Index of the column with the date.
        date: usize,
        /// Index of the column with the time.
        time: usize,
    },
    /// Hour, minute, second and microsecond in the first four columns.
    Parts,
}

impl Clock {
    /// Returns whether a column is part of the time.
    pub(super) fn has(self, at: usize) -> bool {
        match self {
            Self::Seconds { column, .. } | Self::Moment(column) => column == at,
            Self::DateAndTime { date, time } => date == at || time == at,
            Self::Parts => at < 4,
        }
    }

    /// Returns the resolution of times in nanoseconds, if the format fixes it.
    pub(super) fn resolution_ns(self) -> Option<i64> {
        matches!(self, Self::Parts).then_some(1000)
    }

    /// Returns whether times without a date are times of day, not seconds since the start.
    pub(super) fn shows_time_of_day(self) -> bool {
        !matches!(self, Self::Seconds { .. })
    }

    /// Returns whether times of day from zero on may count from the start of the recording. Parts of a time
    /// are those of a clock.
    pub(super) fn may_count_from_start(self) -> bool {
        matches!(self, Self::Moment(_))
    }

    /// Reads the time in nanoseconds.
    pub(super) fn read<'a>(
        self,
        field: impl Fn(usize) -> &'a str,
        decimals: &mut Decimals,
    ) -> Option<Moment> {
        match self {
            Self::Seconds { column, factor } => {
                let seconds = decimals.parse::<f64>(field(column))? * factor;
                let ns = (seconds * 1e9).round();
                let moment = if seconds > SINCE_1970_S { Moment::Since1970 } else { Moment::SinceMidnight };
                (ns.abs() < 9e18).then_some(moment(ns as i64))
            }
            Self::Moment(column) => Moment::parse(field(column)),
            Self::DateAndTime { date, time } => Moment::parse(field(time))?.on(parse_date(field(date))?),
            Self::Parts => {
                let mut part = |at: usize, below: f64| {
                    decimals.parse::<f64>(field(at)).filter(|value| (0.0..below).contains(value))
                };
                let [hour, minute, second] = [part(0, 24.0)?, part(1, 60.0)?, part(2, 61.0)?];
                let microsecond = part(3, 1e6)?;
                if hour.fract() != 0.0 || minute.fract() != 0.0 || second.fract() != 0.0 {
                    return None;
                }
                let ns = (hour * 3600.0 + minute * 60.0 + second) * 1e9 + (microsecond * 1e3).round();
                Some(Moment::SinceMidnight(ns as i64))
            }
        }
    }

    /// Returns whether at least three lines all have a time, in ascending order.
    pub(super) fn rises(self, lines: &[Vec<String>], separator: u8) -> bool {
        let mut decimals = Decimals::separated_by(separator);
        let read =
            |line: &Vec<String>| self.read(|at| line.get(at).map_or("", String::as_str), &mut decimals);
        let times: Option<Vec<Moment>> = lines.iter().map(read).collect();
        times.is_some_and(|times| {
            times.len() > 2 && times.windows(2).all(|pair| pair[0].nanoseconds() < pair[1].nanoseconds())
        })
    }
}
