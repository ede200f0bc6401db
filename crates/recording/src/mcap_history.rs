//! Results computed from records, as an MCAP recording that MCAP tools can plot.

use std::collections::{BTreeMap, HashMap};
use std::io::{Seek, Write};

use jiff::Timestamp;
use mcap::Attachment;
use mcap::records::{MessageHeader, Metadata};
use prost::Message;

use super::RecordingError;
use super::mcap_writer::{SampleIndex, mcap_time};
use super::message::{DESCRIPTOR_SET, WAVEFORM_SCHEMA};
use flankwatch_signal::Record;

/// Kinds of history messages; each is a schema of `proto/`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum HistoryKind {
    /// `flankwatch.v1.Indicators`.
    Indicators,
    /// `flankwatch.v1.Spectrum`.
    Spectrum,
    /// `flankwatch.v1.WearEstimate`.
    Wear,
    /// `flankwatch.v1.AlarmState`.
    Alarm,
    /// `flankwatch.v1.WaveformBlock`.
    Waveform,
}

impl HistoryKind {
    fn schema(self) -> &'static str {
        match self {
            Self::Indicators => "flankwatch.v1.Indicators",
            Self::Spectrum => "flankwatch.v1.Spectrum",
            Self::Wear => "flankwatch.v1.WearEstimate",
            Self::Alarm => "flankwatch.v1.AlarmState",
            Self::Waveform => WAVEFORM_SCHEMA,
        }
    }

    fn topic(self, base: &str) -> String {
        let name = match self {
            Self::Indicators => "indicators",
            Self::Spectrum => "spectrum",
            Self::Wear => "wear",
            Self::Alarm => "alarm",
            Self::Waveform => "waveform",
        };
        format!("{base}/{name}")
    }
}

/// Writes messages in chunks compressed with zstd, with a summary.
pub struct HistoryWriter<W: Write + Seek> {
    inner: mcap::Writer<W>,
    /// Channel id and number of messages by topic.
    topics: HashMap<String, (u16, u32)>,
    /// Sample index by topic base.
    waveforms: HashMap<String, SampleIndex>,
}

impl<W: Write + Seek> HistoryWriter<W> {
    /// Starts a recording.
    pub fn new(writer: W) -> Result<Self, RecordingError> {
        let inner = mcap::WriteOptions::new()
            .library(concat!("flankwatch/", env!("CARGO_PKG_VERSION")))
            .compression(Some(mcap::Compression::Zstd))
            // Compressing in the calling thread gives the same bytes on every machine.
            .compression_threads(0)
            .create(writer)
            .map_err(RecordingError::McapWrite)?;
        Ok(Self { inner, topics: HashMap::new(), waveforms: HashMap::new() })
    }

    /// Writes a result computed from the record that starts at `start_time` and was received at
    /// `received_at`. `base` is `/{asset}/{channel}`.
    pub fn write(
        &mut self,
        base: &str,
        kind: HistoryKind,
        start_time: Timestamp,
        received_at: Timestamp,
        message: &impl Message,
    ) -> Result<(), RecordingError> {
        let (publish_time, log_time) =
            (mcap_time("start_time", start_time)?, mcap_time("received_at", received_at)?);
        let topic = kind.topic(base);
        let (channel_id, sequence) = match self.topics.get_mut(&topic) {
            Some(topic_state) => topic_state,
            None => {
                let schema = self.inner.add_schema(kind.schema(), "protobuf", DESCRIPTOR_SET);
                let schema = schema.map_err(RecordingError::McapWrite)?;
                let channel = self.inner.add_channel(schema, &topic, "protobuf", &BTreeMap::new());
                let channel = channel.map_err(RecordingError::McapWrite)?;
                self.topics.entry(topic).or_insert((channel, 0))
            }
        };
        *sequence = sequence.wrapping_add(1);
        let header = MessageHeader { channel_id: *channel_id, sequence: *sequence, log_time, publish_time };
        self.inner
            .write_to_known_channel(&header, &message.encode_to_vec())
            .map_err(RecordingError::McapWrite)
    }

    /// Writes a record itself, in the format of [`McapWriter`](super::McapWriter), so that it can be read
    /// back.
    pub fn write_record(
        &mut self,
        base: &str,
        record: &Record,
        received_at: Timestamp,
    ) -> Result<(), RecordingError> {
        let index = self.waveforms.entry(base.to_owned()).or_insert_with(|| SampleIndex::of_first(record));
        let block = index.block_of(record);
        self.write(base, HistoryKind::Waveform, record.start_time(), received_at, &block)
    }

    /// Writes a metadata record.
    pub fn metadata(&mut self, name: &str, entries: BTreeMap<String, String>) -> Result<(), RecordingError> {
        let record = Metadata { name: name.to_owned(), metadata: entries };
        self.inner.write_metadata(&record).map_err(RecordingError::McapWrite)
    }

    /// Writes an attachment: a file within the recording.
    pub fn attach(
        &mut self,
        name: &str,
        media_type: &str,
        created_at: Timestamp,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let time = mcap_time("the attachment's time", created_at)?;
        let attachment = Attachment {
            log_time: time,
            create_time: time,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: data.into(),
        };
        self.inner.attach(&attachment).map_err(RecordingError::McapWrite)
    }

    /// Writes the summary and the end. Without this call the recording is incomplete.
    pub fn finish(mut self) -> Result<W, RecordingError> {
        self.inner.finish().map_err(RecordingError::McapWrite)?;
        Ok(self.inner.into_inner())
    }
}
