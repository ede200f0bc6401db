//! Writer of records as an MCAP recording that MCAP tools can open and plot.

use std::collections::{BTreeMap, HashMap};
use std::io::{Seek, Write};

use jiff::Timestamp;
use mcap::records::{MessageHeader, Metadata};
use prost::Message;

use super::RecordingError;
use super::block::message_of;
use super::message::{DESCRIPTOR_SET, Quality, WAVEFORM_SCHEMA, WaveformBlock};
use flankwatch_signal::Record;

/// Compression of chunks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum McapCompression {
    /// Zstandard: small, for archives.
    #[default]
    Zstd,
    /// LZ4: fast, for live recording.
    Lz4,
    /// No compression.
    None,
}

/// Options for writing an MCAP recording.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct McapOptions {
    /// Compression of the chunks.
    pub compression: McapCompression,
}

/// Writes records as protobuf `WaveformBlock` messages, all in chunks, with a summary.
///
/// Metadata that applies to the records (the reference wear) must be written before them.
pub struct McapWriter<W: Write + Seek> {
    inner: mcap::Writer<W>,
    topics: HashMap<String, Topic>,
}

/// State of a topic.
struct Topic {
    channel_id: u16,
    sequence: u32,
    index: SampleIndex,
}

/// Expected start of the topic's next record, in sampling intervals since the first record.
#[derive(Debug, Clone, Copy)]
pub(super) struct SampleIndex {
    first_start: Timestamp,
    next: u64,
}

impl SampleIndex {
    pub(super) fn of_first(record: &Record) -> Self {
        Self { first_start: record.start_time(), next: 0 }
    }

    /// Creates the message of the next record and marks a gap if the record does not follow the previous one.
    pub(super) fn block_of(&mut self, record: &Record) -> WaveformBlock {
        let since_first = record.start_time().duration_since(self.first_start).as_secs_f64();
        let mut block = message_of(record);
        block.first_sample_index = (since_first * record.sample_rate_hz()).round().max(0.0) as u64;
        if block.first_sample_index != self.next {
            block.quality.get_or_insert_with(Quality::default).gap = true;
        }
        self.next = block.first_sample_index + record.samples().len() as u64;
        block
    }
}

impl<W: Write + Seek> McapWriter<W> {
    /// Starts a recording.
    pub fn new(writer: W, options: McapOptions) -> Result<Self, RecordingError> {
        let inner = mcap::WriteOptions::new()
            .library(concat!("flankwatch/", env!("CARGO_PKG_VERSION")))
            .compression(match options.compression {
                McapCompression::Zstd => Some(mcap::Compression::Zstd),
                McapCompression::Lz4 => Some(mcap::Compression::Lz4),
                McapCompression::None => None,
            })
            // Compressing in the calling thread gives the same bytes on every machine.
            .compression_threads(0)
            .create(writer)
            .map_err(RecordingError::McapWrite)?;
        Ok(Self { inner, topics: HashMap::new() })
    }

    /// Writes a record of a converted or simulated recording, with its start time as log time.
    ///
    /// `topic` is `/{asset}/{channel}/waveform`. MCAP has no time before 1970.
    pub fn write(&mut self, topic: &str, record: &Record) -> Result<(), RecordingError> {
        self.write_received(topic, record, record.start_time())
    }

    /// Writes a record received at `log_time`.
    ///
    /// The block's `first_sample_index` counts sampling intervals since the topic's first record, so a gap
    /// shows as a jump.
    pub fn write_received(
        &mut self,
        topic: &str,
        record: &Record,
        log_time: Timestamp,
    ) -> Result<(), RecordingError> {
        let publish_time = mcap_time("start_time", record.start_time())?;
        let log_time = mcap_time("log_time", log_time)?;
        let state = match self.topics.get_mut(topic) {
            Some(state) => state,
            None => {
                let schema = self
                    .inner
                    .add_schema(WAVEFORM_SCHEMA, "protobuf", DESCRIPTOR_SET)
                    .map_err(RecordingError::McapWrite)?;
                let channel_id = self
                    .inner
                    .add_channel(schema, topic, "protobuf", &BTreeMap::new())
                    .map_err(RecordingError::McapWrite)?;
                let index = SampleIndex::of_first(record);
                self.topics.entry(topic.to_owned()).or_insert(Topic { channel_id, sequence: 0, index })
            }
        };
        let block = state.index.block_of(record);
        state.sequence = state.sequence.wrapping_add(1);
        let header =
            MessageHeader { channel_id: state.channel_id, sequence: state.sequence, log_time, publish_time };
        self.inner.write_to_known_channel(&header, &block.encode_to_vec()).map_err(RecordingError::McapWrite)
    }

    /// Writes a metadata record. [`McapReader`](super::McapReader) reads up to 8 MiB of it and merges records
    /// of the same name.
    pub fn metadata(&mut self, name: &str, entries: BTreeMap<String, String>) -> Result<(), RecordingError> {
        self.inner
            .write_metadata(&Metadata { name: name.to_owned(), metadata: entries })
            .map_err(RecordingError::McapWrite)
    }

    /// Writes the summary and the end. Without this call the recording is incomplete.
    pub fn finish(mut self) -> Result<W, RecordingError> {
        self.inner.finish().map_err(RecordingError::McapWrite)?;
        Ok(self.inner.into_inner())
    }
}

/// Converts a time to that of MCAP.
pub(super) fn mcap_time(field: &'static str, time: Timestamp) -> Result<u64, RecordingError> {
    u64::try_from(time.as_nanosecond())
        .map_err(|_| RecordingError::field(field, time, "a time from 1970 to 2554, the range of MCAP"))
}
