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
    pub(super) inner: mcap::Writer<W>,
    /// Channel id and number of messages by topic.
    topics: HashMap<String, (u16, u32)>,
    /// Sample index by topic of records.
    indices: HashMap<String, SampleIndex>,
}

/// Largest deviation of the time between two records from their samples that is no gap, as a fraction.
/// Crystals stay within 1e-4, and the clock of a stream corrects an offset by up to 2e-4.
const MAX_DRIFT: f64 = 3e-4;

/// Counts a topic's samples from the first record on.
#[derive(Debug, Clone, Copy)]
struct SampleIndex {
    /// Start of the previous record: its time and its index.
    start: Timestamp,
    first: u64,
    /// Index after its last sample.
    next: u64,
}

impl SampleIndex {
    /// Creates the message of the next record and marks a gap if the record does not follow the previous one.
    fn block_of(&mut self, record: &Record) -> WaveformBlock {
        let elapsed_s = record.start_time().duration_since(self.start).as_secs_f64();
        let elapsed = elapsed_s * record.sample_rate_hz();
        let by_time = self.first as f64 + elapsed;
        let mut block = message_of(record);
        let has_gap =
            record.quality().gap || (by_time - self.next as f64).abs() > (MAX_DRIFT * elapsed.abs()).max(1.0);
        block.first_sample_index = if has_gap { by_time.round().max(0.0) as u64 } else { self.next };
        if has_gap {
            block.quality.get_or_insert_with(Quality::default).gap = true;
        }
        *self = Self {
            start: record.start_time(),
            first: block.first_sample_index,
            next: block.first_sample_index + record.samples().len() as u64,
        };
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
        Ok(Self { inner, topics: HashMap::new(), indices: HashMap::new() })
    }

    /// Writes a record of a converted or simulated recording, with its start time as log time.
    ///
    /// `topic` is `/{asset}/{channel}/waveform`. MCAP has no time before 1970.
    pub fn write(&mut self, topic: &str, record: &Record) -> Result<(), RecordingError> {
        self.write_received(topic, record, record.start_time())
    }

    /// Writes a record received at `log_time`.
    ///
    /// The block's `first_sample_index` counts samples since the topic's first record and continues from
    /// record to record; a gap of more than one sample and 0.03 % of the time between two records shows as a
    /// jump.
    pub fn write_received(
        &mut self,
        topic: &str,
        record: &Record,
        log_time: Timestamp,
    ) -> Result<(), RecordingError> {
        let first = SampleIndex { start: record.start_time(), first: 0, next: 0 };
        let block = self.indices.entry(topic.to_owned()).or_insert(first).block_of(record);
        self.write_message(topic, WAVEFORM_SCHEMA, record.start_time(), log_time, &block)
    }

    /// Writes a message about the record that starts at `start_time`.
    pub(super) fn write_message(
        &mut self,
        topic: &str,
        schema: &str,
        start_time: Timestamp,
        log_time: Timestamp,
        message: &impl Message,
    ) -> Result<(), RecordingError> {
        let publish_time = mcap_time("start_time", start_time)?;
        let log_time = mcap_time("log_time", log_time)?;
        let (channel_id, sequence) = match self.topics.get_mut(topic) {
            Some(state) => state,
            None => {
                let schema = self.inner.add_schema(schema, "protobuf", DESCRIPTOR_SET);
                let schema = schema.map_err(RecordingError::McapWrite)?;
                let channel = self.inner.add_channel(schema, topic, "protobuf", &BTreeMap::new());
                let channel = channel.map_err(RecordingError::McapWrite)?;
                self.topics.entry(topic.to_owned()).or_insert((channel, 0))
            }
        };
        *sequence = sequence.wrapping_add(1);
        let header = MessageHeader { channel_id: *channel_id, sequence: *sequence, log_time, publish_time };
        self.inner
            .write_to_known_channel(&header, &message.encode_to_vec())
            .map_err(RecordingError::McapWrite)
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
