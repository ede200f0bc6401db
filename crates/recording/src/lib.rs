//! Conversion between recordings and records: WAV, FLAC, MCAP, CSV, MATLAB, NumPy arrays, protobuf and JSON.
//!
//! - [`Frames`]: a recording that is read frame by frame, such as [`WavFrames`], [`TimedCsvFrames`],
//!   [`FlacFrames`], [`NpyFrames`] and [`MatFrames`] (MATLAB, version 5); [`RecordBlocks`] cuts it into
//!   records;
//! - [`decode_wav`], [`decode_csv`], [`decode_flac`], [`decode_mat`], [`decode_npy`], [`decode_raw`]: read an
//!   upload whole;
//! - [`WavWriter`]: writes WAV;
//! - [`McapReader`], [`McapWriter`]: read and write MCAP with the messages of [`message`];
//! - [`decode_block`], [`encode_block`]: decode and encode one message in protobuf or JSON
//!   ([`BlockEncoding`]);
//! - [`CsvTiming`]: rate and time of a CSV file; [`CsvPreview`]: what an import of it would be;
//! - [`stream`]: processes endless streams of samples that arrive in indexed chunks.
//!
//! [`RecordDefaults`] provides the values that a recording lacks.
//!
//! ```
//! use std::io::Cursor;
//!
//! use flankwatch_recording::{McapOptions, McapReader, McapWriter, RecordDefaults, WavWriter, decode_wav};
//!
//! let mut wav = Cursor::new(Vec::new());
//! let mut writer = WavWriter::new(&mut wav, 1, 8000.0)?;
//! for sample in [0.5_f32, -0.5, 0.25] {
//!     writer.write_frame(&[sample])?;
//! }
//! writer.finish()?;
//!
//! let defaults = RecordDefaults { unit: Some("g".to_owned()), ..RecordDefaults::default() };
//! let record = decode_wav(wav.get_ref(), &defaults)?.remove(0);
//! assert_eq!(record.samples(), [0.5, -0.5, 0.25]);
//!
//! let mut mcap = McapWriter::new(Cursor::new(Vec::new()), McapOptions::default())?;
//! mcap.write("/pump/1/waveform", &record)?;
//! let bytes = mcap.finish()?;
//! let read = McapReader::new(Cursor::new(bytes.into_inner())).next().expect("one record")?;
//! assert_eq!(read.record.samples(), record.samples());
//! assert_eq!(read.record.unit(), "g");
//! # Ok::<(), flankwatch_recording::RecordingError>(())
//! ```
//!
//! Input is not trusted. Lengths are checked against the available bytes before memory is allocated. Invalid
//! input is rejected with its position, its value and the expected value ([`RecordingError`]).
//!
//! # Features
//! - `files`: `RecordingFile` and `FileFrames`, which open a recording of any format by path. Without it nothing here opens a
//!   file.
//! - `openapi`: implements `utoipa::ToSchema` for the JSON messages.

mod block;
mod csv;
mod csv_clock;
mod csv_field;
mod csv_head;
mod csv_layout;
mod csv_preview;
mod csv_records;
mod csv_text;
mod csv_time;
mod cut;
mod decoded_block;
mod error;
#[cfg(feature = "files")]
mod file;
mod flac;
mod format;
mod frames;
mod json;
mod mat;
mod mat_variables;
mod mcap_contents;
mod mcap_frames;
mod mcap_history;
mod mcap_reader;
mod mcap_record;
mod mcap_topic;
mod mcap_writer;
pub mod message;
mod npy;
mod npy_header;
mod number;
mod packed_samples;
mod pulse_count;
mod pulses;
mod ramp;
mod rate;
mod raw;
mod record_defaults;
mod recorded;
pub mod stream;
mod wav;
mod wav_format;
mod wav_frames;

pub use block::{BlockEncoding, decode_block, decode_indexed_block, encode_block};
pub use csv::CsvFrames;
pub use csv_head::ColumnRole;
pub use csv_layout::CsvLayout;
pub use csv_preview::{CsvColumn, CsvContents, CsvPreview};
pub use csv_records::{TimedCsvFrames, decode_csv};
pub use csv_time::CsvTiming;
pub use cut::{Cut, RecordBlocks};
pub use error::RecordingError;
#[cfg(feature = "files")]
pub use file::{EXTENSIONS, FileFrames, RecordingFile};
pub use flac::{FlacFrames, decode_flac};
pub use format::Format;
pub use frames::{Frames, FramesInfo};
#[cfg(feature = "openapi")]
pub use json::JsonBlock;
pub use json::json_error_words;
pub use mat::{MatFrames, decode_mat};
pub use mcap_contents::REFERENCE_WEAR;
pub use mcap_history::{HistoryKind, HistoryWriter};
pub use mcap_reader::McapReader;
pub use mcap_writer::{McapCompression, McapOptions, McapWriter};
pub use npy::{NpyFrames, decode_npy};
pub use raw::{RawLayout, RawSample, decode_raw};
pub use record_defaults::{RecordDefaults, TimeOfDay};
pub use recorded::Recorded;
pub use wav::{WavWriter, decode_wav};
pub use wav_format::WavFormat;
pub use wav_frames::{WavFrames, WavSamples};

#[cfg(test)]
mod tests;
