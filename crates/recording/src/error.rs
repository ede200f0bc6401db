//! Errors of reading and writing recordings.

use std::borrow::Cow;

use mcap::McapError;
use thiserror::Error;

use flankwatch_signal::RecordError;

impl RecordingError {
    /// Returns whether writing failed because the disk is full.
    pub fn is_full(&self) -> bool {
        match self {
            Self::Io(error) | Self::McapWrite(McapError::Io(error)) => {
                error.kind() == std::io::ErrorKind::StorageFull
            }
            _ => false,
        }
    }

    /// Returns the field with an invalid value, the value, and what was expected, where the error is about
    /// one.
    pub fn invalid_field(&self) -> Option<(&'static str, String, String)> {
        match self {
            Self::Field { field, value, expected } | Self::Content { field, value, expected, .. } => {
                Some((field, value.clone(), expected.to_string()))
            }
            Self::Wav { field, value, expected } => Some((field, value.clone(), (*expected).to_owned())),
            Self::Record(error) => error.invalid_field(),
            _ => None,
        }
    }
}

/// Why a recording cannot be read or written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// A file cannot be opened.
    #[cfg(feature = "files")]
    #[error("failed to open {path:?}: {source}")]
    Open {
        /// Path of the file.
        path: std::path::PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// Reading or writing failed.
    #[error("cannot read or write the recording: {0}")]
    Io(#[from] std::io::Error),
    /// The recording has no bytes.
    #[error("the recording is empty (0 bytes), expected a WAV, FLAC, MCAP, CSV, MATLAB or NumPy recording")]
    NoBytes,
    /// A known format that is not supported here.
    #[error("the recording is {name}, expected WAV, FLAC, MCAP, CSV, .mat (v5) or .npy: {hint}")]
    Foreign {
        /// Name of the format.
        name: &'static str,
        /// How to read it instead.
        hint: &'static str,
    },
    /// An unknown format.
    #[error(
        "the format is unknown, expected WAV (RIFF, RIFX, RF64 or BW64), FLAC, MCAP, CSV, MATLAB or NumPy"
    )]
    UnknownFormat,
    /// A file of text with the ending of another format.
    #[error("the file contains text, expected the content of a .{ending} file; rename it if it is CSV")]
    Text {
        /// The ending of its name.
        ending: String,
    },
    /// An invalid field of a WAV header.
    #[error("wav: {field} is {value}, expected {expected}")]
    Wav {
        /// Name of the field.
        field: &'static str,
        /// The value.
        value: String,
        /// The expected value.
        expected: &'static str,
    },
    /// An invalid part of a FLAC recording, a NumPy array or a MATLAB file.
    #[error("{format}: {field} is {value}, expected {expected}")]
    Content {
        /// Format of the file.
        format: &'static str,
        /// Name of the part.
        field: &'static str,
        /// The value.
        value: String,
        /// The expected value.
        expected: Cow<'static, str>,
    },
    /// A damaged FLAC recording.
    #[error("flac: damaged ({0})")]
    FlacDamaged(&'static str),
    /// A truncated WAV recording.
    #[error("wav: the file ends in {part} at byte {byte}: {declared} bytes declared, {found} found")]
    WavEnds {
        /// The part in which it ends.
        part: &'static str,
        /// Length of the file.
        byte: u64,
        /// Declared length of that part in bytes.
        declared: u64,
        /// Available bytes of that part.
        found: u64,
    },
    /// Not a protobuf message of the expected type.
    #[error("not {message} in protobuf: {source}")]
    Protobuf {
        /// Name of the expected message, with its article.
        message: &'static str,
        /// The problem.
        source: prost::DecodeError,
    },
    /// Not JSON, or a field is missing, unknown or of the wrong type.
    #[error("not {message} in JSON: {problem}")]
    Json {
        /// Name of the expected message, with its article.
        message: &'static str,
        /// Path of the field at fault, if known.
        path: Option<String>,
        /// The problem in words of JSON.
        problem: String,
        /// The cause.
        source: serde_json::Error,
    },
    /// An invalid field of a message, or an invalid argument.
    #[error("{field} is {value}, expected {expected}")]
    Field {
        /// Name of the field.
        field: &'static str,
        /// The value.
        value: String,
        /// The expected value.
        expected: Cow<'static, str>,
    },
    /// The samples do not form a valid record.
    #[error("{0}")]
    Record(#[from] RecordError),
    /// The samples of one part of a longer recording do not form a valid record.
    #[error("record from sample {first_sample} of the recording: {source}")]
    Cut {
        /// Index of the part's first sample in the recording.
        first_sample: u64,
        /// The cause.
        source: RecordError,
    },
    /// An invalid message of an MCAP recording. Reading continues after it.
    #[error("message {sequence} on {topic:?}: {source}")]
    Message {
        /// The message's topic.
        topic: String,
        /// Its sequence number.
        sequence: u32,
        /// The cause.
        source: Box<RecordingError>,
    },
    /// A damaged MCAP recording. Reading stops at that byte.
    #[error("mcap: damaged at byte {byte}: {source}")]
    Mcap {
        /// Position of the damaged record.
        byte: u64,
        /// The problem.
        source: McapError,
    },
    /// A damaged MCAP recording with an impossible length or reference.
    #[error("mcap: damaged at byte {byte}: {what}")]
    McapDamaged {
        /// Position of the damaged record.
        byte: u64,
        /// The problem.
        what: String,
    },
    /// A truncated MCAP recording.
    #[error("mcap: the file ends at byte {byte} in the middle of {part}; records before that are complete")]
    McapEnds {
        /// Length of the file.
        byte: u64,
        /// The part in which it ends.
        part: &'static str,
    },
    /// An MCAP recording without a waveform.
    #[error(
        "mcap: no vibration found: expected messages of schema flankwatch.v1.WaveformBlock (protobuf or JSON), found {found}"
    )]
    NoVibration {
        /// Topics with their encoding and schema.
        found: String,
    },
    /// Writing an MCAP recording failed.
    #[error("mcap: cannot write: {}", cause(.0))]
    McapWrite(#[source] McapError),
    /// An invalid value in a CSV file.
    #[error("csv line {line}, column {column:?}: {value:?}, expected {expected}")]
    CsvValue {
        /// The line, counted from 1.
        line: u64,
        /// Name of the column.
        column: String,
        /// Text of the field.
        value: String,
        /// The expected value.
        expected: &'static str,
    },
    /// A sampling rate that contradicts the times in the file.
    #[error(
        "the sampling rate is {stated} Hz, expected {clock} Hz according to the times in the file (within 0.1 %)"
    )]
    Rate {
        /// The rate that was given or is stated in the file.
        stated: f64,
        /// The rate according to the times.
        clock: f64,
    },
    /// A sensitivity for samples that are not voltages.
    #[error("channel {channel:?} is in {unit:?}, expected V, mV or no unit: a sensitivity in mV/g is given")]
    NotVolts {
        /// Name of the channel.
        channel: String,
        /// The unit that the recording states.
        unit: String,
    },
    /// An invalid line of a CSV file.
    #[error("csv line {line}: {what}")]
    CsvLine {
        /// The line, counted from 1.
        line: u64,
        /// The problem.
        what: String,
    },
}

impl RecordingError {
    /// Creates the error for an invalid field, with its value shortened for the message.
    pub fn field(field: &'static str, value: impl ToString, expected: impl Into<Cow<'static, str>>) -> Self {
        Self::Field { field, value: shortened(&value.to_string()), expected: expected.into() }
    }

    /// Returns the conversion of decoding errors of this protobuf message.
    pub(crate) fn protobuf(message: &'static str) -> impl Fn(prost::DecodeError) -> Self {
        move |source| Self::Protobuf { message, source }
    }

    /// Creates the error for an invalid field of a WAV header.
    pub(crate) fn wav(field: &'static str, value: impl ToString, expected: &'static str) -> Self {
        Self::Wav { field, value: value.to_string(), expected }
    }
}

/// Returns why an MCAP operation failed, such as a full disk, instead of which one.
fn cause(error: &McapError) -> String {
    std::error::Error::source(error).map_or_else(|| error.to_string(), ToString::to_string)
}

/// Returns at most 60 characters of an untrusted input, to keep errors readable.
pub(crate) fn shortened(text: &str) -> String {
    match text.char_indices().nth(60) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}
