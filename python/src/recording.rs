//! Recordings that the program reads too, by the same code.

use std::path::PathBuf;

use flankwatch_recording::{FileFrames, Frames, FramesInfo, RecordDefaults, RecordingError, TimeOfDay};
use jiff::{SignedDuration, Timestamp};
use numpy::IntoPyArray;
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arguments::time;
use crate::error::{argument_error, value_error};

/// Largest number of samples read at once: 1 GiB.
const MAX_SAMPLES: u64 = 1 << 28;

fn recording_error(error: RecordingError) -> PyErr {
    match error {
        RecordingError::Open { .. } => PyOSError::new_err(error.to_string()),
        error => value_error(error),
    }
}

/// Header and samples of a recording.
struct Contents {
    info: FramesInfo,
    /// The rate; `None` if neither the recording nor the caller states it.
    rate_hz: Option<f64>,
    /// What the recording states of its start.
    states: &'static str,
    columns: Vec<Vec<f32>>,
}

/// Returns what a recording states of its start, from the answers to several default start times.
fn stated_time(frames: &FileFrames, defaults: &RecordDefaults) -> Result<&'static str, RecordingError> {
    let start_after = |duration| {
        let start_time = defaults.start_time.saturating_add(duration).unwrap_or(defaults.start_time);
        Ok::<_, RecordingError>(frames.info(&RecordDefaults { start_time, ..defaults.clone() })?.start_time)
    };
    let start = frames.info(defaults)?.start_time;
    Ok(if start == start_after(SignedDuration::from_hours(48))? {
        "date"
    } else if start == defaults.start_time && start != start_after(SignedDuration::from_nanos(1))? {
        "nothing"
    } else {
        "time of day"
    })
}

fn contents(
    path: PathBuf,
    channels: &[String],
    mut defaults: RecordDefaults,
    samples: bool,
) -> Result<Contents, RecordingError> {
    let mut frames = FileFrames::open(path, channels)?;
    let mut has_rate = true;
    let info = match frames.info(&defaults) {
        Err(error) if defaults.sample_rate_hz.is_none() => {
            // It fails again unless only the rate is missing.
            has_rate = false;
            defaults.sample_rate_hz = Some(1.0);
            frames.info(&defaults).map_err(|_| error)?
        }
        info => info?,
    };
    let states = stated_time(&frames, &defaults)?;
    let mut columns = vec![Vec::new(); info.channels.len()];
    if samples {
        let mut frame = vec![0.0; columns.len()];
        let mut count = 0;
        while frames.next_frame(&mut frame)? {
            count += frame.len() as u64;
            if count > MAX_SAMPLES {
                return Err(RecordingError::Field {
                    field: "the number of samples",
                    value: format!("above {MAX_SAMPLES}"),
                    expected: "a shorter recording".into(),
                });
            }
            for (column, &sample) in columns.iter_mut().zip(&frame) {
                column.push(sample);
            }
        }
    }
    Ok(Contents { rate_hz: has_rate.then_some(info.sample_rate_hz), info, states, columns })
}

/// Reads a WAV or CSV file (also compressed with gzip) as the program does.
///
/// Returns a dict of ``channels`` (names), ``units`` (by channel), ``rate_hz`` (or ``None``), ``start_time``,
/// ``states`` (what the file states of its start: ``"date"``, ``"time of day"`` or ``"nothing"``), ``frames``
/// (the number of samples per channel) and ``samples`` (one array of shape ``(frames,)`` per channel, in
/// single precision; none if ``samples`` is false).
///
/// Raises:
///     OSError: if the file cannot be opened.
///     ValueError: if it is damaged, or its times contradict the rate.
#[pyfunction]
#[pyo3(signature = (path, *, channels=Vec::new(), rate_hz=None, start_time=None, samples=true))]
pub(crate) fn read_frames<'py>(
    py: Python<'py>,
    path: PathBuf,
    channels: Vec<String>,
    rate_hz: Option<f64>,
    start_time: Option<&Bound<'py, PyAny>>,
    samples: bool,
) -> PyResult<Bound<'py, PyDict>> {
    if let Some(rate_hz) = rate_hz.filter(|rate_hz| !(*rate_hz > 0.0 && rate_hz.is_finite())) {
        return Err(argument_error("rate_hz", rate_hz, "a finite number above 0"));
    }
    let start_time = start_time.map_or(Ok(Timestamp::UNIX_EPOCH), time)?;
    let defaults = RecordDefaults {
        start_time,
        time_of_day: TimeOfDay::FromStart,
        sample_rate_hz: rate_hz,
        ..RecordDefaults::default()
    };
    let read = py.detach(|| contents(path, &channels, defaults, samples)).map_err(recording_error)?;
    let frames = if samples {
        read.columns.first().map_or(0, |column| column.len() as u64)
    } else {
        read.info.frames_at_most
    };
    let result = PyDict::new(py);
    result.set_item("channels", &read.info.channels)?;
    result.set_item("units", &read.info.channel_units)?;
    result.set_item("rate_hz", read.rate_hz)?;
    result.set_item("start_time", read.info.start_time.to_string())?;
    result.set_item("states", read.states)?;
    result.set_item("frames", frames)?;
    let arrays: Vec<_> = read.columns.into_iter().map(|column| column.into_pyarray(py)).collect();
    result.set_item("samples", if samples { arrays } else { Vec::new() })?;
    Ok(result)
}
