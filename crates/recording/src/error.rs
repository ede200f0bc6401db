//! Why bytes are not a recording, or only part of one.

use mcap::McapError;
use thiserror::Error;

use flankwatch_signal::RecordError;

impl RecordingError {
    /// Whether the disk that it is written to is full.
    pub fn is_full(&self) -> bool {
        match self {
            Self::Io(error) | Self::McapWrite(McapError::Io(error)) => {
                error.kind() == std::io::ErrorKind::StorageFull
            }
            _ => false,
        }
    }
}

/// Why a recording cannot be read or written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// A file cannot be opened.
    #[cfg(feature = "files")]
    #[error("cannot open {path:?}: {source}")]
    Open {
        /// The file.
        path: std::path::PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// Reading or writing failed underway.
    #[error("cannot read or write the recording: {0}")]
    Io(#[from] std::io::Error),
    /// Not a single byte.
    #[error("the recording is empty (0 bytes), expected a WAV, FLAC, MCAP, CSV, MATLAB or NumPy recording")]
    NoBytes,
    /// A format that is known, and not read here.
    #[error("the recording is {name}, expected WAV, FLAC, MCAP, CSV, .mat (v5) or .npy: {hint}")]
    Foreign {
        /// The format's name.
        name: &'static str,
        /// What reads it.
        hint: &'static str,
    },
    /// No format that is known.
    #[error(
        "the recording begins with the bytes {beginning}, expected a WAV (RIFF, RIFX or RF64), MCAP, CSV, MATLAB or NumPy recording"
    )]
    UnknownFormat {
        /// Its first bytes in hexadecimal.
        beginning: String,
    },
    /// A field of a WAV header that cannot be used.
    #[error("wav: {field} is {value}, expected {expected}")]
    Wav {
        /// Which field.
        field: &'static str,
        /// Its value.
        value: String,
        /// What would have been right.
        expected: &'static str,
    },
    /// A part of a NumPy array or a MATLAB file that cannot be used.
    #[error("{format}: {field} is {value}, expected {expected}")]
    Content {
        /// The file's format.
        format: &'static str,
        /// Which part.
        field: &'static str,
        /// Its value.
        value: String,
        /// What would have been right.
        expected: &'static str,
    },
    /// A WAV recording ends too early.
    #[error("wav: the file ends in {part} at byte {byte}: {declared} bytes declared, {found} found")]
    WavEnds {
        /// Inside of what.
        part: &'static str,
        /// Length of the file.
        byte: u64,
        /// Length of that part as declared.
        declared: u64,
        /// What there is of it.
        found: u64,
    },
    /// Not a protobuf message of the expected type.
    #[error("not a WaveformBlock in protobuf: {0}")]
    Protobuf(#[from] prost::DecodeError),
    /// Not JSON, or a field is missing, unknown or of the wrong type.
    #[error("not a WaveformBlock in json: {0}")]
    Json(#[from] serde_json::Error),
    /// A field of a message, or an argument, that cannot be used.
    #[error("{field} is {value}, expected {expected}")]
    Field {
        /// Which field.
        field: &'static str,
        /// Its value.
        value: String,
        /// What would have been right.
        expected: &'static str,
    },
    /// The samples are not a record.
    #[error("{0}")]
    Record(#[from] RecordError),
    /// The samples of one cut of a longer recording are not a record.
    #[error("record from sample {first_sample} of the recording: {source}")]
    Cut {
        /// Index of the cut's first sample in the recording.
        first_sample: u64,
        /// Why not.
        source: RecordError,
    },
    /// A message of an MCAP recording that cannot be used; reading goes on after it.
    #[error("message {sequence} on {topic:?}: {source}")]
    Message {
        /// The message's topic.
        topic: String,
        /// Its sequence number.
        sequence: u32,
        /// Why not.
        source: Box<RecordingError>,
    },
    /// A damaged MCAP recording; nothing after that byte is read.
    #[error("mcap: damaged at byte {byte}: {source}")]
    Mcap {
        /// Where the damaged record begins.
        byte: u64,
        /// What is wrong with it.
        source: McapError,
    },
    /// A damaged MCAP recording: a length or reference in it cannot be right.
    #[error("mcap: damaged at byte {byte}: {what}")]
    McapDamaged {
        /// Where the damaged record begins.
        byte: u64,
        /// What is wrong with it.
        what: String,
    },
    /// An MCAP recording that ends too early.
    #[error("mcap: the file ends at byte {byte} in the middle of {part}; records before that are complete")]
    McapEnds {
        /// Length of the file.
        byte: u64,
        /// Inside of what.
        part: &'static str,
    },
    /// An MCAP recording without a single waveform.
    #[error(
        "mcap: no vibration in it: expected messages of schema flankwatch.v1.WaveformBlock (protobuf or json), found {found}"
    )]
    NoVibration {
        /// Topics with their encoding and schema.
        found: String,
    },
    /// Writing an MCAP recording failed.
    #[error("mcap: cannot write: {0}")]
    McapWrite(#[source] McapError),
    /// A value in a CSV file that cannot be used.
    #[error("csv line {line}, column {column:?}: {value:?}, expected {expected}")]
    CsvValue {
        /// The line, counted from 1.
        line: u64,
        /// The column's name.
        column: String,
        /// What stands there.
        value: String,
        /// What would have been right.
        expected: &'static str,
    },
    /// A sampling rate that contradicts the times in the file.
    #[error(
        "the sampling rate is {said} Hz, expected {clock} Hz as the times in the file say (at most 0.1 % apart)"
    )]
    Rate {
        /// The rate that was given, or that the file says beside its times.
        said: f64,
        /// The rate by the times.
        clock: f64,
    },
    /// A line of a CSV file that cannot be used.
    #[error("csv line {line}: {what}")]
    CsvLine {
        /// The line, counted from 1.
        line: u64,
        /// What is wrong with it.
        what: String,
    },
}

impl RecordingError {
    /// A field that cannot be used; its value is shortened for the message.
    pub fn field(field: &'static str, value: impl ToString, expected: &'static str) -> Self {
        Self::Field { field, value: shortened(&value.to_string()), expected }
    }

    /// A WAV header's field.
    pub(crate) fn wav(field: &'static str, value: impl ToString, expected: &'static str) -> Self {
        Self::Wav { field, value: value.to_string(), expected }
    }
}

/// At most 60 characters of what a hostile input says, so that an error stays readable.
pub(crate) fn shortened(text: &str) -> String {
    match text.char_indices().nth(60) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}
