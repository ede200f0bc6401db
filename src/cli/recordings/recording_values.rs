//! Options for what a recording lacks: the scale of its values and its start time.

use std::path::Path;

use clap::Args;
use jiff::Timestamp;
use jiff::fmt::strtime::BrokenDownTime;
use jiff::tz::TimeZone;

use crate::cli::CliError;
use crate::cli::time::parse_time;
use crate::recording::{RecordDefaults, RecordingFile};

/// Options of the commands that read recordings.
#[derive(Debug, Clone, Default, Args)]
pub(in crate::cli) struct RecordingValues {
    /// Factor for the values of WAV, FLAC, CSV, MATLAB and NumPy, applied after full-scale integers of WAV
    /// and FLAC are scaled to 1
    #[arg(long, value_name = "FACTOR", allow_negative_numbers = true)]
    scale: Option<f64>,
    /// Sensor sensitivity in mV/g: converts values in volts (after --scale), or in mV if a CSV states so, to
    /// g
    #[arg(long, value_name = "MV_PER_G")]
    sensitivity_mv_per_g: Option<f64>,
    /// Read the time of the first sample from the file name, by a pattern such as %Y%m%d_%H%M%S
    ///
    /// The time may stand anywhere in the name. It is UTC unless the pattern has %z.
    #[arg(long, value_name = "PATTERN")]
    time_from_name: Option<String>,
    /// Time of the first sample (RFC 3339), for recordings without one; later recordings follow on
    ///
    /// A time of day in a recording counts from this time on.
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    start_time: Option<Timestamp>,
}

/// Parses a sampling rate in hertz.
pub(in crate::cli) fn parse_rate(text: &str) -> Result<f64, String> {
    let rate = text.parse().ok().filter(|rate| *rate > 0.0 && f64::is_finite(*rate));
    rate.ok_or_else(|| "expected a rate above 0 Hz".to_owned())
}

/// End of 1970, the year in which recordings without a time begin: a real one is later.
const END_OF_1970: Timestamp = Timestamp::constant(365 * 24 * 3600, 0);

impl RecordingValues {
    /// Returns the time at which recordings without one begin: that of the option, else 1970.
    pub(in crate::cli) fn start_time(&self) -> Timestamp {
        self.start_time.unwrap_or_default()
    }

    /// Returns the time at which the next recording without one begins, after one that ends at `end`. Without
    /// the option such recordings follow only each other.
    pub(in crate::cli) fn next_start(&self, next_start: Timestamp, end: Timestamp) -> Timestamp {
        if self.is_dated(end) && self.start_time.is_none() { next_start } else { next_start.max(end) }
    }

    /// Returns whether a record's time is known.
    pub(in crate::cli) fn is_dated(&self, start_time: Timestamp) -> bool {
        self.start_time.is_some() || start_time >= END_OF_1970
    }

    /// Returns a note on a rate that overrides the file's own, or on options without effect on MCAP.
    pub(in crate::cli) fn note(
        &self,
        path: &Path,
        rate_hz: Option<f64>,
        file: &RecordingFile,
    ) -> Option<String> {
        let path = path.display();
        if let Some((given, own)) = rate_hz.zip(file.header_rate_hz()) {
            return (given != own).then(|| format!("note: {path}: --rate {given} overrides {own} Hz"));
        }
        let options = [
            ("--rate", rate_hz.is_some()),
            ("--scale", self.scale.is_some()),
            ("--sensitivity-mv-per-g", self.sensitivity_mv_per_g.is_some()),
        ];
        let given: Vec<&str> = options.iter().filter(|(_, given)| *given).map(|(name, _)| *name).collect();
        let names = given.join(", ");
        (file.is_mcap() && !given.is_empty())
            .then(|| format!("note: {path}: no effect of {names}: MCAP states these values"))
    }

    /// Overrides the defaults with the options; `path` is the file whose name may have the time.
    pub(in crate::cli) fn apply(&self, path: &Path, defaults: &mut RecordDefaults) -> Result<(), CliError> {
        let scale = self.scale.unwrap_or(1.0);
        check("--scale", scale, scale != 0.0, "a finite number other than 0")?;
        if self.scale.is_some() {
            defaults.scale = Some(scale);
        }
        if let Some(sensitivity) = self.sensitivity_mv_per_g {
            check("--sensitivity-mv-per-g", sensitivity, sensitivity > 0.0, "a finite number above 0")?;
            defaults.sensitivity_mv_per_g = Some(sensitivity);
        }
        if let Some(pattern) = &self.time_from_name {
            defaults.start_time = time_in_name(path, pattern)?;
        }
        Ok(())
    }
}

fn check(option: &str, value: f64, is_usable: bool, expected: &str) -> Result<(), CliError> {
    if value.is_finite() && is_usable {
        return Ok(());
    }
    Err(CliError::argument(option, value, expected))
}

/// Finds the first time in a file name that matches the pattern.
fn time_in_name(path: &Path, pattern: &str) -> Result<Timestamp, CliError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    // A sign before a year is a separator, not part of the year.
    let is_sign = |at: usize| pattern.starts_with('%') && name[at..].starts_with(['-', '+']);
    let found = name.char_indices().filter(|(at, _)| !is_sign(*at)).find_map(|(at, _)| {
        let (time, _) = BrokenDownTime::parse_prefix(pattern, &name[at..]).ok()?;
        match time.offset() {
            Some(_) => time.to_timestamp().ok(),
            None => time.to_datetime().ok()?.to_zoned(TimeZone::UTC).ok().map(|zoned| zoned.timestamp()),
        }
    });
    found.ok_or_else(|| {
        CliError::Argument(format!(
            "{}: no time in the name, expected one as in --time-from-name {pattern:?}",
            path.display()
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time(name: &str, pattern: &str) -> Result<String, String> {
        let time = time_in_name(&Path::new("folder").join(name), pattern);
        time.map(|time| time.to_string()).map_err(|error| error.to_string())
    }

    #[test]
    fn a_time_is_found_anywhere_in_a_name() {
        for (name, pattern, expected) in [
            ("2003.10.22.12.06.24", "%Y.%m.%d.%H.%M.%S", "2003-10-22T12:06:24Z"),
            ("pump 3_20260131_235959_x.wav", "%Y%m%d_%H%M%S", "2026-01-31T23:59:59Z"),
            ("é-2026-01-31T10.00+0200.csv.gz", "%Y-%m-%dT%H.%M%z", "2026-01-31T08:00:00Z"),
            ("day 2026-01-31.npy", "%Y-%m-%d", "2026-01-31T00:00:00Z"),
        ] {
            assert_eq!(time(name, pattern).unwrap(), expected, "{name}");
        }
        for (name, pattern) in [("a.wav", "%Y%m%d"), ("20261331.wav", "%Y%m%d"), ("x", "%Q")] {
            let error = time(name, pattern).unwrap_err();
            assert!(error.contains(name) && error.contains(pattern), "{error}");
        }
    }

    #[test]
    fn invalid_values_are_rejected() {
        let values = RecordingValues {
            scale: Some(5.0),
            sensitivity_mv_per_g: Some(100.0),
            ..RecordingValues::default()
        };
        let mut defaults = RecordDefaults::default();
        values.apply(Path::new("a.wav"), &mut defaults).unwrap();
        assert_eq!((defaults.scale, defaults.sensitivity_mv_per_g), (Some(5.0), Some(100.0)));
        for (invalid, option) in [
            (RecordingValues { scale: Some(0.0), ..RecordingValues::default() }, "--scale"),
            (RecordingValues { scale: Some(f64::NAN), ..RecordingValues::default() }, "--scale"),
            (
                RecordingValues { sensitivity_mv_per_g: Some(-1.0), ..RecordingValues::default() },
                "--sensitivity",
            ),
        ] {
            let error = invalid.apply(Path::new("a.wav"), &mut defaults).unwrap_err().to_string();
            assert!(error.contains(option), "{error}");
        }
    }
}
