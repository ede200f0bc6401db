//! An MQTT message: a record to upload, or a block of a stream.

use bytes::Bytes;
use jiff::Timestamp;
use rumqttc::v5::mqttbytes::v5::Publish;

use super::rejection::Rejection;
use super::settings::MqttSettings;
use super::topic::{self, Address, Content};
use crate::recording::{BlockEncoding, RecordDefaults, decode_indexed_block};
use crate::service::{RecordFormat, UploadMetadata};
use crate::signal::Record;

/// Default start time, which is invalid for a record, so that a message without a time is rejected. The time
/// of receipt cannot be used, as the same message sent again would become another record.
pub(super) const NO_TIME: Timestamp = Timestamp::MIN;

/// A message with a valid topic, size and format.
#[derive(Debug, Clone)]
pub(super) struct Message {
    pub(super) address: Address,
    pub(super) content: Content,
    pub(super) format: RecordFormat,
    pub(super) payload: Bytes,
}

impl Message {
    /// Checks topic, size and content type of a message, but not its record.
    pub(super) fn read(settings: &MqttSettings, publish: &Publish) -> Result<Self, Rejection> {
        let Ok(topic) = std::str::from_utf8(&publish.topic) else {
            return Err(Rejection::field(400, "topic", &publish.topic.escape_ascii().to_string(), "UTF-8"));
        };
        let (address, content) = topic::read(&settings.root, topic)?;
        let max_bytes = settings.message_bytes;
        if publish.payload.len() > max_bytes {
            let detail = format!(
                "the message has {} bytes, expected at most {max_bytes}: send shorter records",
                publish.payload.len()
            );
            return Err(Rejection::new(413, detail));
        }
        if publish.payload.is_empty() {
            return Err(Rejection::new(422, "the message is empty, expected a record or a block"));
        }
        let content_type =
            publish.properties.as_ref().and_then(|properties| properties.content_type.as_deref());
        Ok(Self {
            address,
            content,
            format: format(content_type, &publish.payload)?,
            payload: publish.payload.clone(),
        })
    }

    /// Decodes the block of a stream: the index of its first sample and its samples, with the point as
    /// channel.
    pub(super) fn block(&self) -> Result<(u64, Record), Rejection> {
        let encoding = match self.format {
            RecordFormat::Json => BlockEncoding::Json,
            _ => BlockEncoding::Protobuf,
        };
        let defaults = RecordDefaults {
            channel_names: vec![self.address.point.clone()],
            start_time: NO_TIME,
            ..RecordDefaults::default()
        };
        let (first, record) = decode_indexed_block(&self.payload, encoding, &defaults)
            .map_err(|error| Rejection::of_record(&error))?;
        if record.start_time() == NO_TIME {
            return Err(Rejection::field(422, "start_time", "missing", "the time of the first sample"));
        }
        Ok((first, record))
    }

    /// Returns the metadata of the upload.
    pub(super) fn metadata(&self) -> UploadMetadata {
        UploadMetadata {
            start_time: Some(NO_TIME),
            channel: Some(self.address.point.clone()),
            channel_names: vec![self.address.point.clone()],
            ..UploadMetadata::default()
        }
    }
}

/// Returns the format of the payload. Without a content type it is detected by the first byte: no field of a
/// `WaveformBlock` in protobuf begins with white space or a brace.
fn format(content_type: Option<&str>, payload: &[u8]) -> Result<RecordFormat, Rejection> {
    let Some(content_type) = content_type.filter(|content_type| !content_type.is_empty()) else {
        let is_json = matches!(payload.first(), Some(b'{' | b' ' | b'\t' | b'\r' | b'\n'));
        return Ok(if is_json { RecordFormat::Json } else { RecordFormat::Protobuf });
    };
    let media_type = content_type.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    match RecordFormat::from_media_type(&media_type) {
        Some(format @ (RecordFormat::Protobuf | RecordFormat::Json)) => Ok(format),
        _ => Err(Rejection::field(
            415,
            "content type",
            content_type,
            "application/x-protobuf or application/json",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::{BlockEncoding, encode_block};
    use crate::signal::Record;

    #[test]
    fn encodings_are_detected() {
        let record = Record::new("1", Timestamp::UNIX_EPOCH, 100.0, "g", vec![1.0, 2.0]).unwrap();
        let protobuf = encode_block(&record, BlockEncoding::Protobuf);
        let json = encode_block(&record, BlockEncoding::Json);
        let spaced = [b"\r\n \t", &json[..]].concat();
        for (payload, expected) in [
            (&protobuf, RecordFormat::Protobuf),
            (&json, RecordFormat::Json),
            (&spaced, RecordFormat::Json),
            (&Vec::new(), RecordFormat::Protobuf),
        ] {
            assert_eq!(format(None, payload).unwrap(), expected);
            assert_eq!(format(Some(""), payload).unwrap(), expected);
        }
        // The content type overrides the detection.
        assert_eq!(format(Some("Application/JSON; charset=utf-8"), &protobuf).unwrap(), RecordFormat::Json);
        for other in ["audio/wav", "text/plain", "application/octet-stream"] {
            assert!(format(Some(other), &json).unwrap_err().detail().contains(other));
        }
    }
}
