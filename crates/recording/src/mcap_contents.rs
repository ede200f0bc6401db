//! What the records of an MCAP file declare, and the vibration records that its messages become.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use jiff::Timestamp;
use prost::Message;

use super::block::{decode_message, operating_point_of};
use super::decoded_block::completed_by;
use super::json::{JsonOperatingPoint, JsonTachometer, has_tachometer};
use super::mcap_record::{ChannelView, Damage, MessageView, MetadataView, SchemaView, opcode};
use super::mcap_topic::{asset_of, channel_of, shaft_of};
use super::message::{self, OPERATING_POINT_SCHEMA, TACHOMETER_SCHEMA, WAVEFORM_SCHEMA};
use super::pulses::{PulseTrains, Pulses};
use super::{BlockEncoding, RecordDefaults, Recorded, RecordingError, pulse_count};
use flankwatch_signal::OperatingPoint;

/// Name of the metadata record with the reference wear: start time in nanoseconds → wear depth in µm.
pub const REFERENCE_WEAR: &str = "reference_wear";

/// Largest number of schemas and of channels.
const MAX_DECLARATIONS: usize = 4096;

/// Largest number of reference wear entries.
const MAX_REFERENCES: usize = 1 << 20;

/// Largest number of topics named in the error for a recording without vibration.
const MAX_NAMED_TOPICS: usize = 20;

/// Content of a channel of the file.
enum Kind {
    Waveform(BlockEncoding),
    OperatingPoint(BlockEncoding),
    Tachometer(BlockEncoding),
    Other,
}

struct Channel {
    topic: String,
    kind: Kind,
}

/// State collected from the file so far.
#[derive(Default)]
pub(super) struct Contents {
    defaults: RecordDefaults,
    schemas: HashMap<u16, String>,
    channels: HashMap<u16, Channel>,
    operating_points: HashMap<String, OperatingPoint>,
    /// Assets with a declared tachometer.
    tachometers: HashSet<String>,
    pub(super) pulses: PulseTrains,
    reference_wear: BTreeMap<i64, f64>,
    other_topics: BTreeSet<String>,
    pub(super) waveforms: u64,
}

/// Result of one record of the file.
pub(super) enum Outcome {
    Nothing,
    Item(Result<Recorded, RecordingError>),
    /// A record that the tachometer of this asset may have pulses for.
    Waiting(Recorded, String),
    Damage(Damage),
}

impl Contents {
    /// Creates the contents of a file of which nothing was read yet.
    pub(super) fn new(defaults: RecordDefaults) -> Self {
        Self { defaults, ..Self::default() }
    }

    pub(super) fn take(&mut self, opcode: u8, data: &[u8]) -> Outcome {
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
            ("protobuf", TACHOMETER_SCHEMA) => Kind::Tachometer(BlockEncoding::Protobuf),
            ("json", WAVEFORM_SCHEMA) => Kind::Waveform(BlockEncoding::Json),
            ("json", OPERATING_POINT_SCHEMA) => Kind::OperatingPoint(BlockEncoding::Json),
            ("json", TACHOMETER_SCHEMA) => Kind::Tachometer(BlockEncoding::Json),
            ("json", _) if channel.topic.ends_with("/waveform") => Kind::Waveform(BlockEncoding::Json),
            ("json", _) if channel.topic.ends_with("/operating_point") => {
                Kind::OperatingPoint(BlockEncoding::Json)
            }
            ("json", _) if channel.topic.ends_with("/tachometer") => Kind::Tachometer(BlockEncoding::Json),
            (encoding, schema) => {
                let schema = if schema.is_empty() { "no schema" } else { schema };
                self.other_topics.insert(format!("{} ({encoding}, {schema})", channel.topic));
                Kind::Other
            }
        };
        let topic = channel.topic.to_owned();
        if matches!(kind, Kind::Tachometer(_)) {
            self.tachometers.insert(asset_of(&topic).to_owned());
        }
        self.channels.insert(channel.id, Channel { topic, kind });
        // A channel redeclared under another topic leaves entries in these.
        let others = [self.other_topics.len(), self.tachometers.len(), self.operating_points.len()];
        limited("channels", others.into_iter().fold(self.channels.len(), usize::max))
    }

    /// Stores reference wear; an invalid entry is returned as an error.
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
                    "the id of a channel declared before",
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
                match self.waveform(&channel.topic, encoding, message).map_err(failed) {
                    Ok(recorded)
                        if recorded.record.tachometer().is_none()
                            && self.tachometers.contains(asset_of(&channel.topic)) =>
                    {
                        Outcome::Waiting(recorded, asset_of(&channel.topic).to_owned())
                    }
                    item => Outcome::Item(item),
                }
            }
            Kind::Tachometer(encoding) => match decode_tachometer(message.data, encoding) {
                Ok(mut pulses) => {
                    if pulses.shaft.is_empty() {
                        pulses.shaft = shaft_of(&channel.topic).to_owned();
                    }
                    self.pulses.take(asset_of(&channel.topic), &pulses);
                    Outcome::Nothing
                }
                Err(error) => Outcome::Item(Err(failed(error))),
            },
            Kind::OperatingPoint(encoding) => match decode_operating_point(message.data, encoding) {
                Ok(point) => {
                    self.operating_points.insert(asset_of(&channel.topic).to_owned(), point);
                    Outcome::Nothing
                }
                Err(error) => Outcome::Item(Err(failed(error))),
            },
        }
    }

    fn waveform(
        &self,
        topic: &str,
        encoding: BlockEncoding,
        message: &MessageView<'_>,
    ) -> Result<Recorded, RecordingError> {
        let mut block = decode_message(message.data, encoding)?;
        if block.start_time.is_none() && message.publish_time > 0 {
            block.start_time =
                Some(Timestamp::from_nanosecond(message.publish_time.into()).map_err(|_| {
                    RecordingError::field(
                        "publish_time",
                        message.publish_time,
                        "nanoseconds since 1970-01-01 UTC",
                    )
                })?);
        }
        if let Some(&point) = self.operating_points.get(asset_of(topic)) {
            block.operating_point = completed_by(block.operating_point, point);
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

    /// Adds the pulses of its asset's tachometer to a record.
    pub(super) fn with_pulses(&self, mut recorded: Recorded, asset: &str) -> Recorded {
        let train = self.pulses.of(asset);
        let pulses = train.and_then(|train| train.during(&recorded.record));
        let appended = pulses.and_then(|pulses| append_pulses(&mut recorded.raw, recorded.encoding, pulses));
        if let Some(pulses) = appended {
            let start = recorded.record.start_time();
            recorded.record = recorded.record.with_tachometer(pulses.of(start));
        }
        recorded
    }

    pub(super) fn no_vibration(&self) -> RecordingError {
        let mut named: Vec<&str> =
            self.other_topics.iter().take(MAX_NAMED_TOPICS).map(String::as_str).collect();
        let more = self.other_topics.len().saturating_sub(MAX_NAMED_TOPICS);
        let more = format!("{more} more");
        if self.other_topics.len() > MAX_NAMED_TOPICS {
            named.push(&more);
        }
        let found = if named.is_empty() { "no topics".to_owned() } else { named.join(", ") };
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
        BlockEncoding::Protobuf => operating_point_of(
            &message::OperatingPoint::decode(bytes).map_err(RecordingError::protobuf("an OperatingPoint"))?,
        ),
        BlockEncoding::Json => JsonOperatingPoint::decode(bytes)?.operating_point(),
    })
}

fn decode_tachometer(bytes: &[u8], encoding: BlockEncoding) -> Result<Pulses, RecordingError> {
    Ok(match encoding {
        BlockEncoding::Protobuf => {
            pulse_count::check_tachometer(bytes)?;
            message::Tachometer::decode(bytes).map_err(RecordingError::protobuf("a Tachometer"))?
        }
        BlockEncoding::Json => JsonTachometer::decode(bytes)?,
    })
}

/// Appends pulses to the raw bytes of their block, which has none, so that they are stored together. Returns
/// the pulses; `None` if the block states that it has none, and stays without.
fn append_pulses(raw: &mut Vec<u8>, encoding: BlockEncoding, pulses: Pulses) -> Option<Pulses> {
    match encoding {
        // Concatenated protobuf messages are merged.
        BlockEncoding::Protobuf => {
            let block = message::WaveformBlock { tachometer: Some(pulses), ..Default::default() };
            raw.reserve_exact(block.encoded_len());
            block.encode(raw).expect("a vector grows as it must");
            block.tachometer
        }
        BlockEncoding::Json => {
            let end = raw.iter().rposition(|byte| *byte == b'}')?;
            if has_tachometer(raw) {
                return None;
            }
            raw.truncate(end);
            raw.extend_from_slice(b",\"tachometer\":");
            let pulses = JsonTachometer::append(pulses, raw);
            raw.push(b'}');
            Some(pulses)
        }
    }
}
