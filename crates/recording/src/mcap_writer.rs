//! Records as an MCAP recording that MCAP tools open and plot.

use std::collections::{BTreeMap, HashMap};
use std::io::{Seek, Write};

use jiff::Timestamp;
use mcap::records::{MessageHeader, Metadata};
use prost::Message;

use super::RecordingError;
use super::block::message_of;
use super::message::{DESCRIPTOR_SET, Quality, WAVEFORM_SCHEMA, WaveformBlock};
use flankwatch_signal::Record;

/// How chunks are compressed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum McapCompression {
    /// Small, for archives.
    #[default]
    Zstd,
    /// Fast, for live recording.
    Lz4,
    /// Not at all.
    None,
}

/// How an MCAP recording is written.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct McapOptions {
    /// Compression of the chunks.
    pub compression: McapCompression,
}

/// Writes records as protobuf `WaveformBlock` messages, all in chunks, with a summary.
///
/// Metadata that a reader needs for the records (the reference wear) must be written before them.
pub struct McapWriter<W: Write + Seek> {
    inner: mcap::Writer<W>,
    topics: HashMap<String, Topic>,
}

/// What was written on a topic so far.
struct Topic {
    channel_id: u16,
    sequence: u32,
    place: SampleIndex,
}

/// Where the next record of a topic is expected to begin, in sample intervals since the first one.
#[derive(Debug, Clone, Copy)]
pub(super) struct SampleIndex {
    first_start: Timestamp,
    next: u64,
}

impl SampleIndex {
    pub(super) fn of_first(record: &Record) -> Self {
        Self { first_start: record.start_time(), next: 0 }
    }

    /// The message of the next record; one that does not follow on the last one is said to come after a gap.
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
    /// Begins a recording.
    pub fn new(writer: W, options: McapOptions) -> Result<Self, RecordingError> {
        let inner = mcap::WriteOptions::new()
            .library(concat!("flankwatch/", env!("CARGO_PKG_VERSION")))
            .compression(match options.compression {
                McapCompression::Zstd => Some(mcap::Compression::Zstd),
                McapCompression::Lz4 => Some(mcap::Compression::Lz4),
                McapCompression::None => None,
            })
            // Compression in the calling thread: the same bytes on every machine.
            .compression_threads(0)
            .create(writer)
            .map_err(RecordingError::McapWrite)?;
        Ok(Self { inner, topics: HashMap::new() })
    }

    /// Writes a record of a converted or simulated recording: its log time is its start time.
    ///
    /// `topic` is `/{asset}/{channel}/waveform`. MCAP has no time before 1970.
    pub fn write(&mut self, topic: &str, record: &Record) -> Result<(), RecordingError> {
        self.write_received(topic, record, record.start_time())
    }

    /// Writes a record received at `log_time`.
    ///
    /// The block's `first_sample_index` counts sample intervals since the topic's first record, so a gap
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
                let place = SampleIndex::of_first(record);
                self.topics.entry(topic.to_owned()).or_insert(Topic { channel_id, sequence: 0, place })
            }
        };
        let block = state.place.block_of(record);
        state.sequence = state.sequence.wrapping_add(1);
        let header =
            MessageHeader { channel_id: state.channel_id, sequence: state.sequence, log_time, publish_time };
        self.inner.write_to_known_channel(&header, &block.encode_to_vec()).map_err(RecordingError::McapWrite)
    }

    /// Writes a metadata record. [`McapReader`](super::McapReader) takes up to 8 MiB of it and adds up
    /// several of one name.
    pub fn metadata(&mut self, name: &str, entries: BTreeMap<String, String>) -> Result<(), RecordingError> {
        self.inner
            .write_metadata(&Metadata { name: name.to_owned(), metadata: entries })
            .map_err(RecordingError::McapWrite)
    }

    /// Writes the summary and the end. Without this the recording is not whole.
    pub fn finish(mut self) -> Result<W, RecordingError> {
        self.inner.finish().map_err(RecordingError::McapWrite)?;
        Ok(self.inner.into_inner())
    }
}

/// A time as MCAP writes it.
pub(super) fn mcap_time(field: &'static str, time: Timestamp) -> Result<u64, RecordingError> {
    u64::try_from(time.as_nanosecond())
        .map_err(|_| RecordingError::field(field, time, "a time from 1970 to 2554, the range of MCAP"))
}
