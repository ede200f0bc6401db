//! Results computed from records, as an MCAP recording that MCAP tools can plot.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use jiff::Timestamp;
use mcap::Attachment;
use prost::Message;

use super::RecordingError;
use super::mcap_writer::{McapOptions, McapWriter, mcap_time};
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
}

impl HistoryKind {
    fn schema(self) -> &'static str {
        match self {
            Self::Indicators => "flankwatch.v1.Indicators",
            Self::Spectrum => "flankwatch.v1.Spectrum",
            Self::Wear => "flankwatch.v1.WearEstimate",
            Self::Alarm => "flankwatch.v1.AlarmState",
        }
    }

    fn topic(self, base: &str) -> String {
        let name = match self {
            Self::Indicators => "indicators",
            Self::Spectrum => "spectrum",
            Self::Wear => "wear",
            Self::Alarm => "alarm",
        };
        format!("{base}/{name}")
    }
}

/// Writes messages in chunks compressed with zstd, with a summary.
pub struct HistoryWriter<W: Write + Seek> {
    inner: McapWriter<W>,
}

impl<W: Write + Seek> HistoryWriter<W> {
    /// Starts a recording.
    pub fn new(writer: W) -> Result<Self, RecordingError> {
        Ok(Self { inner: McapWriter::new(writer, McapOptions::default())? })
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
        self.inner.write_message(&kind.topic(base), kind.schema(), start_time, received_at, message)
    }

    /// Writes a record itself, in the format of [`McapWriter`](super::McapWriter), so that it can be read
    /// back.
    pub fn write_record(
        &mut self,
        base: &str,
        record: &Record,
        received_at: Timestamp,
    ) -> Result<(), RecordingError> {
        self.inner.write_received(&format!("{base}/waveform"), record, received_at)
    }

    /// Writes a metadata record.
    pub fn metadata(&mut self, name: &str, entries: BTreeMap<String, String>) -> Result<(), RecordingError> {
        self.inner.metadata(name, entries)
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
        self.inner.inner.attach(&attachment).map_err(RecordingError::McapWrite)
    }

    /// Writes the summary and the end. Without this call the recording is incomplete.
    pub fn finish(self) -> Result<W, RecordingError> {
        self.inner.finish()
    }
}
