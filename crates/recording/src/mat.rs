//! MATLAB files of version 5: the longest variables are the channels, a scalar gives the rate.
//!
//! Channels are vectors and the columns of matrices (rows, if these are longer). Shorter variables than the
//! longest ones are not channels, and neither are logical arrays, nor times and counters, which rise by the
//! same step from sample to sample. Fields of structs count like variables, with dotted names. `scale` of the
//! defaults converts the numbers to a unit; the start time is that of the defaults.

use super::error::shortened;
use super::mat_variables::{Variable, invalid, variables};
use super::ramp::Ramp;
use super::rate::{TOLERANCE, agreed_rate_hz, rate_hz_of};
use super::{Frames, FramesInfo, RecordBlocks, RecordDefaults, RecordingError};
use flankwatch_signal::Record;

/// Magic number.
pub(crate) const MAGIC: &[u8] = b"MATLAB 5.0 MAT-f";

/// Largest size of a file's variables in memory, in bytes.
pub(crate) const MAX_BYTES: u64 = 1 << 30;

/// Largest size of an upload's variables in memory, in bytes.
const MAX_UPLOAD_BYTES: u64 = 1 << 27;

/// Largest number of channels.
const MAX_CHANNELS: usize = 256;

/// Variable names of a sampling rate in hertz, of a sampling interval in seconds, and of times, in lower case
/// without punctuation. Those of rates may end in `hz`.
const RATES: [&str; 9] = [
    "fs",
    "sr",
    "rate",
    "samplerate",
    "samplingrate",
    "samplingfrequency",
    "samplefrequency",
    "sampfreq",
    "fsample",
];
const INTERVALS: [&str; 6] = ["dt", "ts", "increment", "sampleinterval", "samplinginterval", "deltat"];
const TIMES: [&str; 7] = ["t", "time", "zeit", "timestamp", "timevector", "tid", "temps"];

/// The frames of a MATLAB file in memory.
#[derive(Debug)]
pub struct MatFrames {
    variables: Vec<Variable>,
    channels: Vec<Channel>,
    frames: usize,
    stated_rate_hz: Option<f64>,
    interval_rate_hz: Option<f64>,
    clock_rate_hz: Option<f64>,
    next: usize,
}

/// Location of a channel's samples.
#[derive(Debug)]
struct Channel {
    name: String,
    variable: usize,
    first: usize,
    step: usize,
}

impl Channel {
    fn value(&self, variables: &[Variable], frame: usize) -> f64 {
        variables[self.variable].value(self.first + frame * self.step)
    }
}

impl MatFrames {
    /// Reads a file whose variables take at most 1 GiB.
    ///
    /// # Errors
    /// The file is damaged or too large, or no variable is an array of at least two real numbers.
    pub fn new(bytes: &[u8]) -> Result<Self, RecordingError> {
        Self::within(bytes, MAX_BYTES, false)
    }

    fn within(bytes: &[u8], max_bytes: u64, every_series: bool) -> Result<Self, RecordingError> {
        let (mut variables, skipped) = variables(bytes, max_bytes)?;
        variables.retain(|variable| every_series || !variable.is_logical);
        let frames =
            variables.iter().filter(|variable| variable.len() > 0).map(longer_side).max().unwrap_or(0);
        if frames < 2 {
            let names = variables.iter().map(|variable| variable.name.clone());
            let skipped = skipped.iter().map(|(name, kind)| format!("{name} ({kind})"));
            let found = names.chain(skipped).collect::<Vec<_>>().join(", ");
            let found = if found.is_empty() { "empty" } else { &found };
            let expected =
                "an array of real numbers; text, cells, sparse and complex arrays are not supported";
            return Err(RecordingError::Content {
                format: "mat",
                field: "the list of variables",
                value: shortened(found),
                expected: expected.into(),
            });
        }
        let stated_rate_hz = scalar(&variables, &RATES);
        let interval_rate_hz =
            scalar(&variables, &INTERVALS).map(|seconds| 1.0 / seconds).filter(|rate| rate.is_finite());
        let (mut channels, mut clock_rate_hz) = (Vec::new(), None);
        for (at, variable) in variables.iter().enumerate().filter(|(_, one)| longer_side(one) == frames) {
            let count = variable.len() / frames;
            if count == 1 && TIMES.contains(&normalized_name(&variable.name).as_str()) {
                clock_rate_hz = Some(rate_of_times(variable)?);
                continue;
            }
            // The channels of a square matrix are its columns.
            let is_column = variable.shape[0] == frames;
            channels.extend((0..count).map(|n| Channel {
                name: if count == 1 { variable.name.clone() } else { format!("{}_{}", variable.name, n + 1) },
                variable: at,
                first: if is_column { n * frames } else { n },
                step: if is_column { 1 } else { count },
            }));
        }
        let is_ramp = |channel: &Channel| {
            let mut ramp = Ramp::default();
            (0..frames).for_each(|at| ramp.add(channel.value(&variables, at)));
            ramp.is_even()
        };
        let are_ramps: Vec<bool> = channels.iter().map(is_ramp).collect();
        // Samples that all rise are the only ones there are.
        if !every_series && are_ramps.contains(&false) {
            let mut are_ramps = are_ramps.into_iter();
            channels.retain(|_| are_ramps.next() == Some(false));
        }
        if channels.is_empty() || channels.len() > MAX_CHANNELS {
            return Err(invalid("channels", channels.len(), "1 to 256 besides the times"));
        }
        Ok(Self { variables, channels, frames, stated_rate_hz, interval_rate_hz, clock_rate_hz, next: 0 })
    }

    /// Returns the sampling rate in hertz: the given one, else that of a scalar such as `fs`, else that of
    /// the times.
    ///
    /// # Errors
    /// There is none, the times contradict it by more than 0.1 %, or without a given one two variables do.
    fn sample_rate_hz(&self, given_hz: Option<f64>) -> Result<f64, RecordingError> {
        let expected = "a rate given with the MATLAB file, or a variable such as fs or t in it";
        let stated_hz = match (given_hz, self.stated_rate_hz, self.interval_rate_hz) {
            (None, Some(rate), Some(by_interval)) if (rate / by_interval - 1.0).abs() > TOLERANCE => {
                return Err(RecordingError::field(
                    "the sampling rate",
                    format!("{rate} Hz by one variable and {by_interval} Hz by another, an interval"),
                    "variables that agree, or a rate given with the MATLAB file",
                ));
            }
            (given, rate, by_interval) => given.or(rate).or(by_interval),
        };
        agreed_rate_hz(stated_hz, self.clock_rate_hz, 0.0)?
            .ok_or_else(|| RecordingError::field("the sampling rate", "missing", expected))
    }
}

impl Frames for MatFrames {
    fn info(&self, defaults: &RecordDefaults) -> Result<FramesInfo, RecordingError> {
        let rate_hz = self.sample_rate_hz(defaults.sample_rate_hz)?;
        let names = self.channels.iter().map(|channel| channel.name.clone()).collect();
        let names = defaults.names_or(names);
        Ok(FramesInfo::without_time(names, rate_hz, self.frames as u64, defaults))
    }

    fn next_frame(&mut self, frame: &mut [f32]) -> Result<bool, RecordingError> {
        if self.next == self.frames {
            return Ok(false);
        }
        for (sample, channel) in frame.iter_mut().zip(&self.channels) {
            *sample = channel.value(&self.variables, self.next) as f32;
        }
        self.next += 1;
        Ok(true)
    }
}

/// Reads a MATLAB file of at most 128 MiB once inflated as one record per channel.
///
/// # Errors
/// Those of [`MatFrames`]; channels longer than a record may be; a sample that is not finite.
pub fn decode_mat(bytes: &[u8], defaults: &RecordDefaults) -> Result<Vec<Record>, RecordingError> {
    if bytes.is_empty() {
        return Err(RecordingError::NoBytes);
    }
    RecordBlocks::whole(MatFrames::within(bytes, MAX_UPLOAD_BYTES, defaults.every_series)?, defaults)?
        .collect()
}

/// Returns the longer dimension of a variable.
fn longer_side(variable: &Variable) -> usize {
    variable.shape[0].max(variable.shape[1])
}

/// Returns a variable's own name in lower case, letters and digits only.
fn normalized_name(name: &str) -> String {
    let own = name.rsplit('.').next().unwrap_or(name);
    own.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase()).collect()
}

/// Returns the first positive scalar with one of these names.
fn scalar(variables: &[Variable], names: &[&str]) -> Option<f64> {
    let has_name = |variable: &&Variable| {
        let name = normalized_name(&variable.name);
        names.contains(&name.strip_suffix("hz").unwrap_or(&name))
    };
    let mut values = variables.iter().filter(|one| one.len() == 1).filter(has_name).map(|one| one.value(0));
    values.find(|value| value.is_finite() && *value > 0.0)
}

/// Returns the sampling rate of times in seconds.
fn rate_of_times(times: &Variable) -> Result<f64, RecordingError> {
    let last = times.len() - 1;
    let step = (times.value(last) - times.value(0)) / last as f64;
    if step.is_nan() || step <= 0.0 {
        return Err(invalid("time", format!("{step} s from sample to sample"), "ascending times in seconds"));
    }
    let uneven = (1..=last).find(|&k| {
        let off = (times.value(k) - times.value(k - 1) - step).abs();
        off > 0.5 * step || off.is_nan()
    });
    if let Some(at) = uneven {
        let value = format!("{:?} s at {} after {:?} s", times.value(at), at + 1, times.value(at - 1));
        return Err(invalid("time", value, "times with a constant step"));
    }
    Ok(rate_hz_of(step))
}
