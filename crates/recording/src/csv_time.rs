//! The time columns of a CSV file: the sampling rate and the start that they say.

use std::io::Read;

use jiff::Timestamp;

use super::csv_field::{Decimals, Moment};
use super::{CsvFrames, RecordingError};

/// Most that a given rate may differ from that of the time column.
const RATE_TOLERANCE: f64 = 1e-3;

/// Seconds above which a number counts from 1970: no recording is so long.
const SINCE_1970_S: f64 = 1e8;

/// Where the time of a line stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Clock {
    /// Seconds, or parts of them, as a number.
    Seconds {
        /// Which column.
        column: usize,
        /// Seconds in one unit of it.
        factor: f64,
    },
    /// A time of day, or a date and a time.
    Moment(usize),
    /// Hour, minute, second and microsecond in the first four columns.
    Parts,
}

impl Clock {
    /// Whether a column is part of it.
    pub(super) fn has(self, at: usize) -> bool {
        match self {
            Self::Seconds { column, .. } | Self::Moment(column) => column == at,
            Self::Parts => at < 4,
        }
    }

    /// The time in nanoseconds.
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

    /// Whether lines, at least three, all have a time, each a later one.
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

/// What all lines of a CSV file say of its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CsvTiming {
    /// Lines of samples.
    pub frames: u64,
    /// Sampling rate in hertz by the time columns; none without them, or with a single line.
    pub clock_rate_hz: Option<f64>,
    /// Sampling rate in hertz by a line before the header.
    pub stated_rate_hz: Option<f64>,
    /// Time of the first sample, where a column has dates.
    pub start_time: Option<Timestamp>,
    /// How far the time columns may be off, as a part of the recording's length.
    uncertainty: f64,
}

/// Whether the values of a column rise by the same step from line to line, as no vibration does.
#[derive(Debug, Default)]
struct Ramp {
    last: Option<f32>,
    step: Option<f32>,
    lines: u64,
    broken: bool,
}

impl Ramp {
    /// Lines from which on it is told.
    const MIN_LINES: u64 = 4;

    fn add(&mut self, value: f32) {
        if let Some(last) = self.last.replace(value) {
            let step = *self.step.get_or_insert(value - last);
            // Times are often rounded.
            self.broken |= !(step > 0.0 && ((value - last) / step - 1.0).abs() <= 0.5);
        }
        self.lines += 1;
    }

    fn is_even(&self) -> bool {
        self.lines >= Self::MIN_LINES && !self.broken
    }
}

impl CsvTiming {
    /// Reads a file to its end.
    ///
    /// # Errors
    /// Those of [`CsvFrames`]; a time that is none, goes back, or leaves samples out.
    pub fn scan<R: Read>(mut frames: CsvFrames<R>) -> Result<Self, RecordingError> {
        let mut frame = vec![0.0; frames.channels().len()];
        let mut steps = Steps::default();
        let mut first = None;
        let mut count = 0_u64;
        let mut ramp = Ramp::default();
        while frames.next_frame(&mut frame)? {
            count += 1;
            ramp.add(frame.first().copied().unwrap_or_default());
            if let Some(moment) = frames.moment()? {
                first.get_or_insert(moment);
                steps.add(moment.nanoseconds(), frames.line())?;
            }
        }
        if frames.may_be_unnamed_time() && ramp.is_even() {
            return Err(frames.unnamed_time());
        }
        let start_time = match first {
            Some(Moment::Since1970(ns)) => Timestamp::from_nanosecond(i128::from(ns)).ok(),
            _ => None,
        };
        let (clock_rate_hz, uncertainty) =
            steps.rate_hz()?.map_or((None, 0.0), |(rate, uncertainty)| (Some(rate), uncertainty));
        Ok(Self {
            frames: count,
            clock_rate_hz,
            stated_rate_hz: frames.stated_rate_hz(),
            start_time,
            uncertainty,
        })
    }

    /// The sampling rate in hertz: the given one, else that of a line before the header, else that of the
    /// time columns.
    ///
    /// # Errors
    /// None of them is there, or the time columns say another one, by more than 0.1 %.
    pub fn sample_rate_hz(&self, given_hz: Option<f64>) -> Result<f64, RecordingError> {
        let said = given_hz.or(self.stated_rate_hz);
        match (said, self.clock_rate_hz) {
            (Some(said), Some(clock)) if (said / clock - 1.0).abs() > RATE_TOLERANCE + self.uncertainty => {
                Err(RecordingError::Rate { said, clock })
            }
            (Some(rate), _) | (None, Some(rate)) => Ok(rate),
            (None, None) => Err(RecordingError::field(
                "the sampling rate",
                "missing",
                "a rate given beside the CSV file, a column of times, or a line such as \"Sample rate: 12800\" before the header",
            )),
        }
    }
}

/// The steps of a time column, as far as they have been read.
#[derive(Debug, Default)]
struct Steps {
    first: Option<i64>,
    last: i64,
    count: u64,
    /// The longest one and its line, and the shortest one that is not nothing.
    longest: (i64, u64),
    shortest: Option<i64>,
}

impl Steps {
    fn add(&mut self, ns: i64, line: u64) -> Result<(), RecordingError> {
        if self.first.is_none() {
            self.first = Some(ns);
        } else {
            let step = ns.checked_sub(self.last).filter(|step| *step >= 0);
            let step = step.ok_or_else(|| RecordingError::CsvLine {
                line,
                what: "its time lies before that of the line above, expected rising times".to_owned(),
            })?;
            self.count += 1;
            if step > self.longest.0 {
                self.longest = (step, line);
            }
            if step > 0 {
                self.shortest = Some(self.shortest.map_or(step, |shortest| shortest.min(step)));
            }
        }
        self.last = ns;
        Ok(())
    }

    /// The rate in hertz, and how far it may be off.
    fn rate_hz(&self) -> Result<Option<(f64, f64)>, RecordingError> {
        let (Some(first), Some(shortest)) = (self.first, self.shortest) else {
            return Ok(None);
        };
        let span = self.last.saturating_sub(first) as f64;
        let mean = span / self.count as f64;
        // Times may be written coarser than the samples follow each other: then many steps are nothing, and
        // some are one unit.
        let resolution = if shortest as f64 > 1.5 * mean { shortest as f64 } else { 0.0 };
        let (longest, line) = self.longest;
        if longest as f64 > 1.5 * mean + resolution {
            return Err(RecordingError::CsvLine {
                line,
                what: format!(
                    "{} s after the line above, expected {} s: samples are missing",
                    longest as f64 / 1e9,
                    mean / 1e9
                ),
            });
        }
        let rate = 1e9 / mean;
        let whole = rate.round();
        let rate = if whole >= 1.0 && (rate / whole - 1.0).abs() < 1e-6 { whole } else { rate };
        Ok(Some((rate, resolution / span)))
    }
}
