//! MCAP recordings: vibration out of a stream of bytes.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::io::Read;

use jiff::Timestamp;
use prost::Message;

use super::block::{decode_message, filled, operating_point_of};
use super::json::JsonOperatingPoint;
use super::mcap_frames::McapFrames;
use super::mcap_record::{ChannelView, Damage, MessageView, MetadataView, SchemaView, opcode};
use super::message::{self, OPERATING_POINT_SCHEMA, WAVEFORM_SCHEMA};
use super::{BlockEncoding, RecordDefaults, RecordingError};
use crate::signal::{OperatingPoint, Record};

/// Name of the metadata record with the wear that is known from elsewhere: start time in nanoseconds → wear depth in µm.
pub const REFERENCE_WEAR: &str = "reference_wear";

/// Most schemas and channels taken, each.
const MAX_DECLARATIONS: usize = 4096;

/// Most entries of reference wear taken.
const MAX_REFERENCES: usize = 1 << 20;

/// Most topics named when a recording without vibration is refused.
const NAMED_TOPICS: usize = 20;

/// A record as it stood in a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Recorded {
    /// The record.
    pub record: Record,
    /// The block's bytes as they came; a cut of a WAV recording is encoded anew.
    pub raw: Vec<u8>,
    /// How `raw` is encoded.
    pub encoding: BlockEncoding,
    /// Wear depth in µm that the recording states for this record's start time, for comparison only.
    pub reference_wear_um: Option<f64>,
}

/// Reads the waveforms of an MCAP recording in the order of the file, in bounded memory.
///
/// A waveform is a message of schema `flankwatch.v1.WaveformBlock` in protobuf or JSON, or any JSON message on a topic that ends in `/waveform`. The
/// record's channel is the topic `/{asset}/{channel}/waveform` without its first and last part, so `/pump/gearbox/x/waveform` is
/// `gearbox/x`; another topic is taken whole. Messages on `/{asset}/operating_point` hold for the asset's following waveforms where these say nothing themselves.
/// A start time of 0 stands for the message's publish time.
///
/// A bad message is an `Err` and reading goes on. Damage is an `Err` that says at which byte, and the last item: the records before it are whole, those
/// of a chunk whose checksum is wrong are not used. A recording without any waveform is an `Err` that names what is in it.
pub struct McapReader {
    frames: McapFrames,
    contents: Contents,
    ended: bool,
}

/// What a channel of the file carries.
enum Kind {
    Waveform(BlockEncoding),
    OperatingPoint(BlockEncoding),
    Other,
}

struct Channel {
    topic: String,
    kind: Kind,
}

/// What the file has said so far.
#[derive(Default)]
struct Contents {
    defaults: RecordDefaults,
    schemas: HashMap<u16, String>,
    channels: HashMap<u16, Channel>,
    operating_points: HashMap<String, OperatingPoint>,
    reference_wear: BTreeMap<i64, f64>,
    other_topics: BTreeSet<String>,
    waveforms: u64,
}

/// What one record of the file brings.
enum Outcome {
    Nothing,
    Item(Result<Recorded, RecordingError>),
    Damage(Damage),
}

impl McapReader {
    /// Reads a recording from its first byte. Nothing is read before the first record is asked for.
    pub fn new(bytes: impl Read + Send + 'static) -> Self {
        Self::with_defaults(bytes, RecordDefaults::default())
    }

    /// The same with what holds where neither a block nor the recording says it.
    pub fn with_defaults(bytes: impl Read + Send + 'static, defaults: RecordDefaults) -> Self {
        Self {
            frames: McapFrames::new(bytes),
            contents: Contents {
                defaults,
                ..Default::default()
            },
            ended: false,
        }
    }
}

impl Iterator for McapReader {
    type Item = Result<Recorded, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        while !self.ended {
            let contents = &mut self.contents;
            match self.frames.next_record(|opcode, data| contents.take(opcode, data)) {
                Ok(Some(Outcome::Nothing)) => {}
                Ok(Some(Outcome::Item(item))) => return Some(item),
                Ok(Some(Outcome::Damage(what))) => {
                    self.ended = true;
                    let byte = self.frames.record_start();
                    return Some(Err(RecordingError::McapDamaged { byte, what }));
                }
                Ok(None) => {
                    self.ended = true;
                    if self.contents.waveforms == 0 {
                        return Some(Err(self.contents.no_vibration()));
                    }
                }
                Err(error) => {
                    self.ended = true;
                    return Some(Err(error));
                }
            }
        }
        None
    }
}

impl Contents {
    fn take(&mut self, opcode: u8, data: &[u8]) -> Outcome {
        let done = match opcode {
            opcode::SCHEMA => self.schema(data),
            opcode::CHANNEL => self.channel(data),
            opcode::METADATA => match self.metadata(data) {
                Ok(Some(error)) => return Outcome::Item(Err(error)),
                Ok(None) => Ok(()),
                Err(damage) => Err(damage),
            },
            opcode::MESSAGE => match MessageView::parse(data) {
                Ok(message) => return self.message(&message),
                Err(damage) => Err(damage),
            },
            _ => Ok(()),
        };
        match done {
            Ok(()) => Outcome::Nothing,
            Err(damage) => Outcome::Damage(damage),
        }
    }

    fn schema(&mut self, data: &[u8]) -> Result<(), Damage> {
        let schema = SchemaView::parse(data)?;
        self.schemas.insert(schema.id, schema.name.to_owned());
        limited("schemas", self.schemas.len())
    }

    fn channel(&mut self, data: &[u8]) -> Result<(), Damage> {
        let channel = ChannelView::parse(data)?;
        let schema = self.schemas.get(&channel.schema_id).map_or("", String::as_str);
        let kind = match (channel.encoding, schema) {
            ("protobuf", WAVEFORM_SCHEMA) => Kind::Waveform(BlockEncoding::Protobuf),
            ("protobuf", OPERATING_POINT_SCHEMA) => Kind::OperatingPoint(BlockEncoding::Protobuf),
            ("json", WAVEFORM_SCHEMA) => Kind::Waveform(BlockEncoding::Json),
            ("json", OPERATING_POINT_SCHEMA) => Kind::OperatingPoint(BlockEncoding::Json),
            ("json", _) if channel.topic.ends_with("/waveform") => Kind::Waveform(BlockEncoding::Json),
            ("json", _) if channel.topic.ends_with("/operating_point") => Kind::OperatingPoint(BlockEncoding::Json),
            (encoding, schema) => {
                let schema = if schema.is_empty() { "no schema" } else { schema };
                self.other_topics.insert(format!("{} ({encoding}, {schema})", channel.topic));
                Kind::Other
            }
        };
        let topic = channel.topic.to_owned();
        self.channels.insert(channel.id, Channel { topic, kind });
        limited("channels", self.channels.len().max(self.other_topics.len()))
    }

    /// Keeps reference wear; an entry that is none is an error of its own.
    fn metadata(&mut self, data: &[u8]) -> Result<Option<RecordingError>, Damage> {
        let metadata = MetadataView::parse(data)?;
        if metadata.name != REFERENCE_WEAR {
            return Ok(None);
        }
        let mut error = None;
        for (time, depth) in metadata.entries()? {
            match (time.parse(), depth.parse::<f64>()) {
                (Ok(time), Ok(depth)) if depth >= 0.0 && depth.is_finite() => {
                    self.reference_wear.insert(time, depth);
                }
                _ => {
                    error.get_or_insert(RecordingError::field(
                        "reference_wear",
                        format!("{time:?}: {depth:?}"),
                        "a start time in nanoseconds and a depth in µm of at least 0",
                    ));
                }
            }
        }
        if self.reference_wear.len() > MAX_REFERENCES {
            return Err(format!("more than {MAX_REFERENCES} entries of reference wear"));
        }
        Ok(error)
    }

    fn message(&mut self, message: &MessageView<'_>) -> Outcome {
        let Some(channel) = self.channels.get(&message.channel_id) else {
            return Outcome::Item(Err(RecordingError::Message {
                topic: format!("(channel {})", message.channel_id),
                sequence: message.sequence,
                source: Box::new(RecordingError::field(
                    "channel id",
                    message.channel_id,
                    "that of a channel declared before",
                )),
            }));
        };
        let failed = |source| RecordingError::Message {
            topic: channel.topic.clone(),
            sequence: message.sequence,
            source: Box::new(source),
        };
        match channel.kind {
            Kind::Other => Outcome::Nothing,
            Kind::Waveform(encoding) => {
                self.waveforms += 1;
                Outcome::Item(self.waveform(&channel.topic, encoding, message).map_err(failed))
            }
            Kind::OperatingPoint(encoding) => match decode_operating_point(message.data, encoding) {
                Ok(point) => {
                    self.operating_points.insert(asset_of(&channel.topic).to_owned(), point);
                    Outcome::Nothing
                }
                Err(error) => Outcome::Item(Err(failed(error))),
            },
        }
    }

    fn waveform(&self, topic: &str, encoding: BlockEncoding, message: &MessageView<'_>) -> Result<Recorded, RecordingError> {
        let mut block = decode_message(message.data, encoding)?;
        if block.start_time.is_none() && message.publish_time > 0 {
            block.start_time = Some(
                Timestamp::from_nanosecond(message.publish_time.into())
                    .map_err(|_| RecordingError::field("publish_time", message.publish_time, "nanoseconds since 1970-01-01 UTC"))?,
            );
        }
        if let Some(&point) = self.operating_points.get(asset_of(topic)) {
            block.operating_point = filled(block.operating_point, point);
        }
        let record = block.into_record(Some(channel_of(topic)), &self.defaults)?;
        let reference = i64::try_from(record.start_time().as_nanosecond()).ok();
        Ok(Recorded {
            reference_wear_um: reference.and_then(|time| self.reference_wear.get(&time).copied()),
            record,
            raw: message.data.to_vec(),
            encoding,
        })
    }

    fn no_vibration(&self) -> RecordingError {
        let mut named: Vec<&str> = self.other_topics.iter().take(NAMED_TOPICS).map(String::as_str).collect();
        let more = self.other_topics.len().saturating_sub(NAMED_TOPICS);
        let more = format!("{more} more");
        if self.other_topics.len() > NAMED_TOPICS {
            named.push(&more);
        }
        let found = if named.is_empty() {
            "no topics".to_owned()
        } else {
            named.join(", ")
        };
        RecordingError::NoVibration { found }
    }
}

fn limited(what: &str, count: usize) -> Result<(), Damage> {
    if count > MAX_DECLARATIONS {
        return Err(format!("more than {MAX_DECLARATIONS} {what}"));
    }
    Ok(())
}

fn decode_operating_point(bytes: &[u8], encoding: BlockEncoding) -> Result<OperatingPoint, RecordingError> {
    Ok(match encoding {
        BlockEncoding::Protobuf => operating_point_of(&message::OperatingPoint::decode(bytes)?),
        BlockEncoding::Json => JsonOperatingPoint::decode(bytes)?.operating_point(),
    })
}

/// The first part of a topic.
fn asset_of(topic: &str) -> &str {
    let topic = topic.strip_prefix('/').unwrap_or(topic);
    topic.split_once('/').map_or(topic, |(asset, _)| asset)
}

/// The record's channel: `/{asset}/{channel}/waveform` without its first and last part, another topic whole.
fn channel_of(topic: &str) -> &str {
    let topic = topic.strip_prefix('/').unwrap_or(topic);
    match topic.strip_suffix("/waveform") {
        Some(path) => path.split_once('/').map_or(path, |(_, channel)| channel),
        None => topic,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_gives_asset_and_channel() {
        for (topic, asset, channel) in [
            ("/pump-1/gearbox/x/waveform", "pump-1", "gearbox/x"),
            ("/pump-1/a1/waveform", "pump-1", "a1"),
            ("/a1/waveform", "a1", "a1"),
            ("vibration", "vibration", "vibration"),
            ("/robot/imu", "robot", "robot/imu"),
        ] {
            assert_eq!((asset_of(topic), channel_of(topic)), (asset, channel), "{topic}");
        }
    }
}
