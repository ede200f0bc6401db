//! The identity of a record: the hash of its asset, channel, time and raw bytes, by which repeated records
//! are found.

use std::collections::HashSet;
use std::sync::Arc;

use jiff::Timestamp;

use super::channel_units::{ChannelUnits, check_unit};
use super::decode::RecordFormat;
use crate::asset::{AssetId, AssetSpec, RawReference, Segment, SegmentId};
use crate::recording::{Recorded, RecordingError};
use crate::service::error::ServiceError;
use crate::signal::Record;
use crate::store::{Objects, RecordMetadata, Store};

/// Maximum reference wear depth in µm, the same as for an inspection.
const MAX_DEPTH_UM: f64 = 1e5;

/// A record with its identifier and the name of its raw bytes, before anything is stored.
#[derive(Clone)]
pub(crate) struct IdentifiedRecord {
    pub(crate) id: SegmentId,
    pub(crate) record: Arc<Record>,
    pub(crate) raw: RawReference,
    pub(crate) reference_wear_um: Option<f64>,
    /// Whether it is excluded from its history.
    pub(crate) excluded: bool,
}

/// A record with an identity.
pub(crate) trait Identified {
    fn id(&self) -> &SegmentId;
    /// The identifier of the record for another asset of its sensor.
    fn id_for(&self, asset: &AssetId) -> SegmentId;
}

impl IdentifiedRecord {
    /// Identifies a record; returns an error if it cannot be stored or addressed.
    pub(crate) fn new(
        asset: &AssetId,
        record: Record,
        raw: RawReference,
        reference_wear_um: Option<f64>,
    ) -> Result<Self, ServiceError> {
        check(&record, reference_wear_um)?;
        Ok(Self { reference_wear_um, ..Self::of_stored(asset, record, raw, false) })
    }

    /// Identifies a record that is stored already, for this asset or another asset of its sensor.
    pub(crate) fn of_stored(asset: &AssetId, record: Record, raw: RawReference, excluded: bool) -> Self {
        Self {
            id: SegmentId::derive(asset, record.channel(), record.start_time(), &raw),
            record: Arc::new(record),
            raw,
            reference_wear_um: None,
            excluded,
        }
    }

    /// The record for another asset of its sensor, without the reference depth, which is not that of the
    /// other mesh.
    pub(crate) fn for_member(&self, member: &AssetSpec) -> Self {
        Self {
            id: self.id_for(&member.id),
            record: Arc::clone(&self.record),
            raw: self.raw.clone(),
            reference_wear_um: None,
            excluded: self.excluded,
        }
    }

    /// The metadata file beside its raw bytes.
    pub(crate) fn metadata(&self, asset: &AssetId, received_at: Timestamp) -> RecordMetadata {
        let record = &self.record;
        RecordMetadata {
            id: self.id.clone(),
            asset_id: asset.clone(),
            channel: record.channel().to_owned(),
            start_time: record.start_time(),
            received_at,
            unit: record.unit().to_owned(),
            operating_point: record.operating_point(),
            reference_wear_um: self.reference_wear_um,
            raw: self.raw.clone(),
        }
    }

    pub(crate) fn samples(&self) -> usize {
        self.record.samples().len()
    }
}

impl Identified for IdentifiedRecord {
    fn id(&self) -> &SegmentId {
        &self.id
    }

    fn id_for(&self, asset: &AssetId) -> SegmentId {
        SegmentId::derive(asset, self.record.channel(), self.record.start_time(), &self.raw)
    }
}

impl Identified for RecordMetadata {
    fn id(&self) -> &SegmentId {
        &self.id
    }

    fn id_for(&self, asset: &AssetId) -> SegmentId {
        SegmentId::derive(asset, &self.channel, self.start_time, &self.raw)
    }
}

fn check(record: &Record, reference_wear_um: Option<f64>) -> Result<(), ServiceError> {
    let refuse = |field, value, expected: &'static str| {
        Err(ServiceError::Field { field, value, expected: expected.into() })
    };
    let channel = record.channel();
    if channel.is_empty() || channel.chars().count() > 200 || channel.chars().any(char::is_control) {
        let expected = "a name of 1 to 200 characters, none of them control characters";
        return refuse("channel", format!("{channel:?}"), expected);
    }
    check_unit(record.unit())?;
    if i64::try_from(record.start_time().as_nanosecond()).is_err() {
        let expected = "a time from 1677-09-21 to 2262-04-11";
        return refuse("start_time", record.start_time().to_string(), expected);
    }
    match reference_wear_um {
        Some(wear) if !(0.0..=MAX_DEPTH_UM).contains(&wear) => {
            refuse("reference_wear_um", wear.to_string(), "a depth from 0 to 100000")
        }
        _ => Ok(()),
    }
}

/// Checks that a repeated record states nothing that contradicts the stored one.
///
/// # Errors
/// [`ServiceError::StoredWith`] with the first value that differs.
pub(crate) fn check_repeat(repeated: &IdentifiedRecord, stored: &Segment) -> Result<(), ServiceError> {
    let differ = |field, value: String, stored| Err(ServiceError::StoredWith { field, value, stored });
    let text = |value: Option<f64>| value.map_or_else(|| "none".to_owned(), |value| value.to_string());
    // The scale and unit of the samples are parts of the media type.
    if repeated.raw.media_type != stored.raw.media_type {
        return differ("media_type", repeated.raw.media_type.clone(), stored.raw.media_type.clone());
    }
    let (given, known) = (repeated.record.operating_point(), &stored.operating_point);
    for (field, given, known) in [
        ("shaft_speed_hz", given.shaft_speed_hz, known.shaft_speed_hz),
        ("torque_nm", given.torque_nm, known.torque_nm),
        ("temperature_c", given.temperature_c, known.temperature_c),
        ("reference_wear_um", repeated.reference_wear_um, stored.reference_wear_um),
    ] {
        if given.is_some() && given != known {
            return differ(field, text(given), text(known));
        }
    }
    Ok(())
}

/// Returns an error if a record is so far in the future that a clock must be wrong: it would turn every later
/// record into a late one.
pub(crate) fn check_time(start_time: Timestamp, latest: Timestamp) -> Result<(), ServiceError> {
    if start_time <= latest {
        return Ok(());
    }
    Err(ServiceError::Field {
        field: "start_time",
        value: start_time.to_string(),
        expected: "a time no further ahead of the service's clock than limits.start_time_ahead_s".into(),
    })
}

/// Identifies the records of one upload, one for each channel.
pub(crate) fn identify_upload(
    asset: &AssetId,
    mut units: ChannelUnits,
    format: RecordFormat,
    bytes: &[u8],
    records: Vec<Record>,
    reference_wear_um: Option<f64>,
) -> Result<Vec<IdentifiedRecord>, ServiceError> {
    let sha256 = Objects::name(bytes);
    let identified = (0..).zip(records).map(|(channel_index, record)| {
        check_unit(record.unit())?;
        units.learn_unit(&record);
        let (record, original_unit) = units.convert(record)?;
        let raw = RawReference {
            sha256: sha256.clone(),
            bytes: bytes.len() as u64,
            media_type: format.stored_media_type(original_unit.as_deref()),
            channel_index,
        };
        IdentifiedRecord::new(asset, record, raw, reference_wear_um)
    });
    identified.collect()
}

/// An identified record with its raw bytes, or its channel and why it is refused.
pub(crate) type IdentifiedOrRefused = Result<(IdentifiedRecord, Vec<u8>), (Option<String>, ServiceError)>;

/// Identifies one record of a recording of many.
pub(crate) fn identify_recorded(
    asset: &AssetId,
    units: &ChannelUnits,
    record: Result<Recorded, RecordingError>,
) -> IdentifiedOrRefused {
    let recorded = record.map_err(|error| (None, error.into()))?;
    let channel = recorded.record.channel().to_string();
    let fixed = check_unit(recorded.record.unit()).and_then(|()| units.convert(recorded.record));
    let (record, original_unit) = fixed.map_err(|error| (Some(channel.clone()), error))?;
    let raw = RawReference {
        sha256: Objects::name(&recorded.raw),
        bytes: recorded.raw.len() as u64,
        media_type: RecordFormat::of_block(recorded.encoding).stored_media_type(original_unit.as_deref()),
        channel_index: 0,
    };
    match IdentifiedRecord::new(asset, record, raw, recorded.reference_wear_um) {
        Ok(identified) => Ok((identified, recorded.raw)),
        Err(error) => Err((Some(channel), error)),
    }
}

/// Returns the segments of the records that are stored already for their asset and for all other assets of
/// its sensor.
pub(crate) async fn known_to_all(
    store: &Store,
    records: &[impl Identified],
    members: &[AssetSpec],
) -> Result<Vec<Segment>, ServiceError> {
    let ids: Vec<SegmentId> = records.iter().map(|record| record.id().clone()).collect();
    let mut known = store.segments_by_id(&ids).await?;
    for member in members {
        let theirs: Vec<SegmentId> = records.iter().map(|record| record.id_for(&member.id)).collect();
        let found = store.segments_by_id(&theirs).await?;
        let found: HashSet<&SegmentId> = found.iter().map(|segment| &segment.id).collect();
        let missing: HashSet<&SegmentId> =
            theirs.iter().zip(&ids).filter(|(theirs, _)| !found.contains(theirs)).map(|(_, id)| id).collect();
        known.retain(|segment| !missing.contains(&segment.id));
    }
    Ok(known)
}
