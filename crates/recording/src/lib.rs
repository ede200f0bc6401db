//! Bytes to records and back: WAV, MCAP, CSV, protobuf and JSON. The codecs do no I/O of their own; only [`RecordingFile`] opens a file.
//!
//! Nothing read here is trusted: a length is checked against the bytes that are there before memory is taken for it, and what cannot be used is refused
//! with its place, its value and what was expected ([`RecordingError`]).

mod block;
mod csv;
mod cut;
mod error;
#[cfg(feature = "files")]
mod file;
mod format;
mod json;
mod mcap_frames;
mod mcap_history;
mod mcap_reader;
mod mcap_record;
mod mcap_topic;
mod mcap_writer;
pub mod message;
mod packed_samples;
mod pulse_count;
mod pulses;
mod raw;
mod wav;
mod wav_format;
mod wav_frames;

pub use block::{BlockEncoding, RecordDefaults, decode_block, encode_block};
pub use csv::CsvFrames;
pub use cut::{Cut, CutPlan, Cutter};
pub use error::RecordingError;
#[cfg(feature = "files")]
pub use file::RecordingFile;
pub use format::Format;
#[cfg(feature = "openapi")]
pub use json::JsonBlock;
pub use mcap_history::{HistoryKind, HistoryWriter};
pub use mcap_reader::{McapReader, REFERENCE_WEAR, Recorded};
pub use mcap_writer::{McapCompression, McapOptions, McapWriter};
pub use raw::{RawLayout, RawSample, decode_raw};
pub use wav::{WavBlocks, WavWriter, decode_wav};
pub use wav_format::WavFormat;
pub use wav_frames::WavFrames;

#[cfg(test)]
mod tests;
