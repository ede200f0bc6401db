//! The sampling rate and start time of a CSV file, derived from its time columns.

use std::io::Read;

use jiff::Timestamp;

use super::csv_field::Moment;
use super::csv_head::StatedRate;
use super::ramp::Ramp;
use super::rate::{agreed_rate_hz, rate_hz_of};
use super::{CsvFrames, RecordDefaults, RecordingError, TimeOfDay};

/// Nanoseconds in a second and in a day.
const SECOND_NS: i128 = 1_000_000_000;
const DAY_NS: i128 = 86_400 * SECOND_NS;

/// Timing of a CSV file, from all its lines.
#[derive(Debug, Clone, PartialEq)]
pub struct CsvTiming {
    /// Number of lines of samples.
    pub frames: u64,
    /// Sampling rate in hertz according to the time columns; `None` without them, or with a single line.
    pub clock_rate_hz: Option<f64>,
    /// Sampling rate in hertz stated in a line before the header.
    pub stated_rate_hz: Option<f64>,
    /// Whether that line has a number that may be meant with a decimal comma or without.
    is_stated_ambiguously: bool,
    /// Time of the first sample, if a column contains dates.
    pub dated_start: Option<Timestamp>,
    /// Time of day of the first sample in nanoseconds, if a column contains times of day without dates.
    time_of_day_ns: Option<i64>,
    /// Relative uncertainty of the rate from the time columns.
    uncertainty: f64,
    /// Largest relative error of that rate if the recorder rounded its step before it added the steps up.
    rounding: f64,
    /// Indices of the channels that are times or counters, beside the time column.
    pub(super) counters: Vec<usize>,
}

impl CsvTiming {
    /// Reads a file to its end to determine its timing.
    ///
    /// # Errors
    /// Those of [`CsvFrames`]; a time that is invalid, not ascending, or shows that samples are missing.
    pub fn scan<R: Read>(mut frames: CsvFrames<R>) -> Result<Self, RecordingError> {
        let mut frame = vec![0.0; frames.channels().len()];
        let mut steps = Steps::default();
        let mut first = None;
        let mut count = 0_u64;
        // The last midnight since the first time of day.
        let mut midnight_ns = 0;
        let mut ramps = vec![Ramp::default(); frame.len()];
        let shows_time_of_day = frames.shows_time_of_day();
        while frames.next_frame(&mut frame)? {
            count += 1;
            ramps.iter_mut().zip(&frame).for_each(|(ramp, value)| ramp.add(f64::from(*value)));
            if let Some(moment) = frames.moment()? {
                first.get_or_insert(moment);
                let mut ns = moment.nanoseconds();
                if shows_time_of_day && matches!(moment, Moment::SinceMidnight(_)) {
                    if steps.goes_back_half_a_day(ns + midnight_ns) {
                        midnight_ns += DAY_NS as i64;
                    }
                    ns += midnight_ns;
                }
                steps.add(ns, frames.line())?;
            }
        }
        if count == 0 {
            let (line, what) = (frames.line(), "no samples below the header".to_owned());
            return Err(RecordingError::CsvLine { line, what });
        }
        let are_even: Vec<bool> = ramps.iter().map(Ramp::is_even).collect();
        let counters = frames.counters(&are_even)?;
        let (dated_start, since_midnight_ns) = match first {
            Some(Moment::Since1970(ns)) => (Timestamp::from_nanosecond(i128::from(ns)).ok(), None),
            Some(Moment::SinceMidnight(ns)) => (None, Some(ns)),
            None => (None, None),
        };
        let (clock_rate_hz, uncertainty) =
            steps.rate_hz()?.map_or((None, 0.0), |(rate, uncertainty)| (Some(rate), uncertainty));
        let rounding = match (frames.time_resolution_ns(), steps.constant_ns()) {
            (Some(resolution_ns), Some(step_ns)) => 0.5 * resolution_ns as f64 / step_ns as f64,
            _ => 0.0,
        };
        Ok(Self {
            frames: count,
            clock_rate_hz,
            stated_rate_hz: match frames.stated_rate() {
                Some(StatedRate::Known(rate_hz)) => Some(rate_hz),
                Some(StatedRate::Ambiguous) | None => None,
            },
            is_stated_ambiguously: frames.stated_rate() == Some(StatedRate::Ambiguous),
            dated_start,
            // Others that begin at zero count from the start of the recording.
            time_of_day_ns: since_midnight_ns
                .filter(|ns| shows_time_of_day && (*ns != 0 || !frames.times_may_count_from_start())),
            uncertainty,
            rounding,
            counters,
        })
    }

    /// Returns the time of the first sample: that of a column with dates, else that of the defaults and the
    /// time of day (UTC).
    pub(super) fn start_time(&self, defaults: &RecordDefaults) -> Timestamp {
        let start_ns = defaults.start_time.as_nanosecond();
        let by_time_of_day = || {
            let time_of_day_ns = i128::from(self.time_of_day_ns?);
            let ns = match defaults.time_of_day {
                TimeOfDay::Ignored => return None,
                // The start may be the computed end of another recording, which is a little late.
                TimeOfDay::FromStart => {
                    let earliest_ns = start_ns - SECOND_NS;
                    earliest_ns + (time_of_day_ns - earliest_ns).rem_euclid(DAY_NS)
                }
                TimeOfDay::UpToStart => start_ns - (start_ns - time_of_day_ns).rem_euclid(DAY_NS),
            };
            Timestamp::from_nanosecond(ns).ok()
        };
        self.dated_start.or_else(by_time_of_day).unwrap_or(defaults.start_time)
    }

    /// Returns the sampling rate in hertz: the given one, else that of a line before the header, else that of
    /// the time columns.
    ///
    /// # Errors
    /// There is none, the time columns contradict it by more than 0.1 %, or they alone do not give it within
    /// 0.1 %.
    pub fn sample_rate_hz(&self, given_hz: Option<f64>) -> Result<f64, RecordingError> {
        let stated = given_hz.or(self.stated_rate_hz);
        let uncertainty = self.uncertainty + stated.map_or(0.0, |_| self.rounding);
        agreed_rate_hz(stated, self.clock_rate_hz, uncertainty)?.ok_or_else(|| match self.is_stated_ambiguously {
            true => RecordingError::field(
                "the sampling rate before the header",
                "a number with a comma before three digits",
                "one without a thousands separator, such as \"Sample rate: 12800\", or a rate given with the CSV file",
            ),
            false => RecordingError::field(
                "the sampling rate",
                "missing",
                "a rate given with the CSV file, a time column, or a line such as \"Sample rate: 12800\" before the header",
            ),
        })
    }
}

/// Rounds to three significant digits.
fn three_digits(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

/// The steps of a time column read so far.
#[derive(Debug, Default)]
struct Steps {
    first: Option<i64>,
    last: i64,
    count: u64,
    /// Number of steps above zero.
    rises: u64,
    /// The longest step and its line, and the shortest step above zero.
    longest: (i64, u64),
    shortest: Option<i64>,
    /// Sums over the times in nanoseconds since the first one: of them, their squares, and their products
    /// with the number of the line.
    sum: f64,
    squares: f64,
    products: f64,
}

impl Steps {
    /// Returns whether a time is at least half a day before the last one: a time of day passed midnight.
    fn goes_back_half_a_day(&self, ns: i64) -> bool {
        self.first.is_some() && i128::from(self.last) - i128::from(ns) >= DAY_NS / 2
    }

    fn add(&mut self, ns: i64, line: u64) -> Result<(), RecordingError> {
        if self.first.is_none() {
            self.first = Some(ns);
        } else {
            let step = ns.checked_sub(self.last).filter(|step| *step >= 0);
            let step = step.ok_or_else(|| RecordingError::CsvLine {
                line,
                what: "its time is before that of the line above, expected ascending times".to_owned(),
            })?;
            self.count += 1;
            if step > self.longest.0 {
                self.longest = (step, line);
            }
            if step > 0 {
                self.rises += 1;
                self.shortest = Some(self.shortest.map_or(step, |shortest| shortest.min(step)));
            }
        }
        self.last = ns;
        let since_first = (i128::from(ns) - i128::from(self.first.unwrap_or(ns))) as f64;
        self.sum += since_first;
        self.squares += since_first * since_first;
        self.products += since_first * self.count as f64;
        Ok(())
    }

    /// Returns the step if all steps are equal.
    fn constant_ns(&self) -> Option<i64> {
        self.shortest.filter(|shortest| *shortest == self.longest.0)
    }

    /// Returns the rate in hertz and its relative uncertainty: the slope of the times by least squares, which
    /// unlike the mean step does not depend on the rounding of the first and the last time.
    fn rate_hz(&self) -> Result<Option<(f64, f64)>, RecordingError> {
        let (Some(first), Some(shortest)) = (self.first, self.shortest) else {
            return Ok(None);
        };
        let span = self.last.saturating_sub(first) as f64;
        let mean = span / self.count as f64;
        // The resolution of the times may be coarser than the sampling interval: then many steps are zero,
        // and some are one unit.
        let resolution = if shortest as f64 > 1.5 * mean { shortest as f64 } else { 0.0 };
        let (longest, line) = self.longest;
        if longest as f64 > 1.5 * mean + resolution {
            let others_s = (span - longest as f64) / (self.count - 1).max(1) as f64 / 1e9;
            return Err(RecordingError::CsvLine {
                line,
                what: format!(
                    "{} s after the line above, where the other lines are {} s apart: samples are missing",
                    longest as f64 / 1e9,
                    three_digits(others_s)
                ),
            });
        }
        let lines = self.count as f64 + 1.0;
        let variance_of_lines = (lines * lines - 1.0) / 12.0;
        let mean_time = self.sum / lines;
        let covariance = self.products / lines - mean_time * 0.5 * self.count as f64;
        let step = covariance / variance_of_lines;
        let residual = (self.squares / lines - mean_time * mean_time - step * covariance).max(0.0);
        // Rounding errors of lines with the same time are not independent.
        let times = self.rises as f64 + 1.0;
        let uncertainty = 2.0 * (residual / (variance_of_lines * times)).sqrt() / step;
        Ok(Some((rate_hz_of(step / 1e9), uncertainty)))
    }
}
