//! Decodes the bytes of an upload: one record for each channel.

use std::fmt;

use jiff::Timestamp;

use super::channel_units::ChannelUnits;
use crate::asset::AssetSpec;
use crate::recording::{
    BlockEncoding, CsvLayout, Format, RawLayout, RecordDefaults, RecordingError, TimeOfDay, decode_block,
    decode_csv, decode_flac, decode_mat, decode_npy, decode_raw, decode_wav,
};
use crate::service::error::ServiceError;
use crate::signal::{OperatingPoint, Record, Tachometer};

/// The format of the bytes of one upload.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RecordFormat {
    /// A file of samples.
    File(SampleFile),
    /// A `WaveformBlock` message in protobuf.
    Protobuf,
    /// A `WaveformBlock` message in JSON.
    Json,
    /// Bare samples.
    Raw(RawLayout),
    /// CSV.
    Csv(CsvLayout),
}

/// A WAV, FLAC, MATLAB or NumPy file, with what it does not contain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampleFile {
    /// The format of the file.
    pub kind: SampleFileKind,
    /// Sampling rate in hertz, if the file lacks it.
    pub sample_rate_hz: Option<f64>,
    /// Factor for each value; full-scale integers of WAV and FLAC are 1 before it is applied.
    pub scale: Option<f64>,
    /// Sensitivity of the sensor in mV/g, which converts volts to g.
    pub sensitivity_mv_per_g: Option<f64>,
}

/// The format of a file of samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SampleFileKind {
    /// WAV.
    Wav,
    /// FLAC.
    Flac,
    /// MATLAB, version 5.
    Mat,
    /// A NumPy array.
    Npy,
}

impl SampleFileKind {
    const ALL: [Self; 4] = [Self::Wav, Self::Flac, Self::Mat, Self::Npy];

    /// The media types, the preferred one first.
    fn media_types(self) -> &'static [&'static str] {
        match self {
            Self::Wav => &["audio/wav", "audio/x-wav", "audio/wave", "audio/vnd.wave"],
            Self::Flac => &["audio/flac", "audio/x-flac"],
            Self::Mat => &["application/x-matlab-data"],
            Self::Npy => &["application/x-npy"],
        }
    }

    /// Whether every such file contains its sampling rate.
    pub fn has_rate(self) -> bool {
        matches!(self, Self::Wav | Self::Flac)
    }
}

impl SampleFile {
    fn from_media_type(media_type: &str) -> Option<Self> {
        let mut parts = media_type.split(';');
        let name = parts.next()?;
        let kind = SampleFileKind::ALL.into_iter().find(|kind| kind.media_types().contains(&name))?;
        let mut file = Self { kind, sample_rate_hz: None, scale: None, sensitivity_mv_per_g: None };
        for part in parts {
            match part.split_once('=')? {
                ("rate", rate) => file.sample_rate_hz = Some(rate.parse().ok()?),
                ("scale", scale) => file.scale = Some(scale.parse().ok()?),
                ("sensitivity", value) => file.sensitivity_mv_per_g = Some(value.parse().ok()?),
                _ => return None,
            }
        }
        Some(file)
    }

    fn decode(self, bytes: &[u8], defaults: &RecordDefaults) -> Result<Vec<Record>, RecordingError> {
        let defaults = RecordDefaults {
            sample_rate_hz: self.sample_rate_hz.or(defaults.sample_rate_hz),
            scale: self.scale.or(defaults.scale),
            sensitivity_mv_per_g: self.sensitivity_mv_per_g.or(defaults.sensitivity_mv_per_g),
            ..defaults.clone()
        };
        match self.kind {
            SampleFileKind::Wav => decode_wav(bytes, &defaults),
            SampleFileKind::Flac => decode_flac(bytes, &defaults),
            SampleFileKind::Mat => decode_mat(bytes, &defaults),
            SampleFileKind::Npy => decode_npy(bytes, &defaults),
        }
    }
}

impl fmt::Display for SampleFile {
    /// Writes the media type with all parameters that are needed to decode the file.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.kind.media_types()[0])?;
        if let Some(rate_hz) = self.sample_rate_hz {
            write!(f, ";rate={rate_hz}")?;
        }
        if let Some(scale) = self.scale {
            write!(f, ";scale={scale}")?;
        }
        match self.sensitivity_mv_per_g {
            Some(sensitivity) => write!(f, ";sensitivity={sensitivity}"),
            None => Ok(()),
        }
    }
}

/// Metadata that the sender gives with a record; values in the bytes themselves take precedence.
#[derive(Debug, Clone, Default)]
pub struct UploadMetadata {
    /// The time of the first sample; by default the time of receipt, or the last time before it with the time
    /// of day in the recording.
    pub start_time: Option<Timestamp>,
    /// The channel's name, for a recording of one channel.
    pub channel: Option<String>,
    /// The names of the channels in order, for a recording of several; empty if the recording contains them
    /// or they do not matter.
    pub channel_names: Vec<String>,
    /// Unit of the samples.
    pub unit: Option<String>,
    /// Units of the named channels in order; an empty text stands for `unit`. Empty if all channels have the
    /// same unit.
    pub channel_units: Vec<String>,
    /// Operating point.
    pub operating_point: OperatingPoint,
    /// Reference wear depth in µm from another source.
    pub reference_wear_um: Option<f64>,
}

impl RecordFormat {
    /// The media type of the format, with all parameters that are needed to decode it.
    pub fn media_type(self) -> String {
        match self {
            Self::File(file) => file.to_string(),
            Self::Protobuf => "application/x-protobuf".to_string(),
            Self::Json => "application/json".to_string(),
            Self::Raw(layout) => layout.to_string(),
            Self::Csv(layout) => layout.to_string(),
        }
    }

    /// The media type that is stored with a record whose samples were converted from `unit`.
    pub(crate) fn stored_media_type(self, unit: Option<&str>) -> String {
        let has_others =
            matches!(self, Self::Csv(_) | Self::File(SampleFile { kind: SampleFileKind::Mat, .. }));
        with_unit(self.media_type() + if has_others { VIBRATION } else { "" }, unit)
    }

    /// The format of a media type, without parameters or as written by [`media_type`](Self::media_type).
    pub fn from_media_type(media_type: &str) -> Option<Self> {
        let StoredMediaType { media_type, .. } = StoredMediaType::of(media_type);
        match media_type {
            "application/x-protobuf" | "application/protobuf" => Some(Self::Protobuf),
            "application/json" => Some(Self::Json),
            _ => SampleFile::from_media_type(media_type)
                .map(Self::File)
                .or_else(|| CsvLayout::from_media_type(media_type).map(Self::Csv))
                .or_else(|| RawLayout::from_media_type(media_type).map(Self::Raw)),
        }
    }

    pub(crate) fn of_block(encoding: BlockEncoding) -> Self {
        match encoding {
            BlockEncoding::Protobuf => Self::Protobuf,
            BlockEncoding::Json => Self::Json,
        }
    }

    /// Decodes the records in the bytes, one for each channel.
    ///
    /// # Errors
    /// The bytes are in another format, which is named if it is a known one, or they are damaged.
    pub(crate) fn decode(
        self,
        bytes: &[u8],
        defaults: &RecordDefaults,
    ) -> Result<Vec<Record>, RecordingError> {
        let records = match self {
            Self::File(file) => file.decode(bytes, defaults),
            Self::Protobuf => decode_block(bytes, BlockEncoding::Protobuf, defaults).map(|one| vec![one]),
            Self::Json => decode_block(bytes, BlockEncoding::Json, defaults).map(|one| vec![one]),
            Self::Raw(layout) => decode_raw(bytes, layout, defaults),
            Self::Csv(layout) => decode_csv(bytes, layout, defaults),
        };
        records.map_err(|error| match Format::detect(bytes) {
            Err(foreign @ RecordingError::Foreign { .. }) => foreign,
            _ => error,
        })
    }
}

/// Adds the original unit of converted samples to a stored media type that has none.
pub(crate) fn with_unit(media_type: String, unit: Option<&str>) -> String {
    match unit {
        Some(unit) if !media_type.contains(UNIT) => media_type + UNIT + unit,
        _ => media_type,
    }
}

/// Precedes the original unit of the samples in a stored media type, if records were converted.
const UNIT: &str = "; unit=";

/// Ends a stored media type, before the unit, if the channels of the file are those of vibration.
const VIBRATION: &str = "; channels=vibration";

/// The parts of a stored media type.
pub(crate) struct StoredMediaType<'a> {
    media_type: &'a str,
    /// Whether times, counters and logical arrays count as channels, and stated units do not count.
    pub(crate) has_every_series: bool,
    /// The original unit of the samples, if records were converted.
    pub(crate) unit: Option<&'a str>,
}

impl<'a> StoredMediaType<'a> {
    pub(crate) fn of(text: &'a str) -> Self {
        let (start, unit) = text.split_once(UNIT).map_or((text, None), |(start, unit)| (start, Some(unit)));
        let media_type = start.strip_suffix(VIBRATION);
        Self { media_type: media_type.unwrap_or(start), has_every_series: media_type.is_none(), unit }
    }
}

/// The default values for an asset's records.
pub(crate) fn defaults_of(spec: &AssetSpec, units: &ChannelUnits, start_time: Timestamp) -> RecordDefaults {
    RecordDefaults {
        channel: spec.sensor.channel.clone(),
        start_time,
        unit: spec.sensor.unit.clone(),
        channel_units: units.by_channel().collect(),
        ..RecordDefaults::default()
    }
}

/// Decodes the records of an upload, in the order of their channels.
pub(crate) fn decode_upload(
    spec: &AssetSpec,
    units: &ChannelUnits,
    format: RecordFormat,
    bytes: &[u8],
    metadata: &UploadMetadata,
    received_at: Timestamp,
) -> Result<Vec<Record>, ServiceError> {
    let mut defaults = RecordDefaults {
        channel: metadata.channel.clone(),
        channel_names: metadata.channel_names.clone(),
        operating_point: metadata.operating_point,
        time_of_day: match metadata.start_time {
            Some(_) => TimeOfDay::Ignored,
            None => TimeOfDay::UpToStart,
        },
        ..defaults_of(spec, units, metadata.start_time.unwrap_or(received_at))
    };
    if metadata.unit.is_some() {
        defaults.unit.clone_from(&metadata.unit);
        defaults.channel_units.clear();
    }
    let (names, own) = (&metadata.channel_names, &metadata.channel_units);
    if !own.is_empty() && own.len() != names.len() {
        return Err(ServiceError::Field {
            field: "channel_units",
            value: format!("{own:?}"),
            expected: "as many units as channel_names has names".into(),
        });
    }
    let given = names.iter().zip(own).filter(|(_, unit)| !unit.is_empty());
    defaults.channel_units.extend(given.map(|(name, unit)| (name.clone(), unit.clone())));
    let records = format.decode(bytes, &defaults)?;
    check_names(&metadata.channel_names, records.len())?;
    if let Some(channel) = metadata.channel.as_ref().filter(|_| records.len() > 1) {
        return Err(ServiceError::Field {
            field: "channel",
            value: format!("{channel:?}"),
            expected: format!("no value for {} channels: channel_names has their names", records.len())
                .into(),
        });
    }
    records.iter().filter_map(Record::tachometer).try_for_each(check_pulses)?;
    Ok(records)
}

/// Checks the pulses of an upload.
fn check_pulses(tachometer: &Tachometer) -> Result<(), ServiceError> {
    let refuse = |field, value, expected: &'static str| {
        Err(ServiceError::Field { field, value, expected: expected.into() })
    };
    let times = &tachometer.pulse_times_s;
    if tachometer.pulses_per_revolution == 0 && !times.is_empty() {
        return refuse("tachometer.pulses_per_revolution", "0".to_owned(), "a whole number of at least 1");
    }
    match times.windows(2).position(|pair| pair[1] <= pair[0]) {
        Some(n) => {
            let value = format!("descending or repeated at pulse {}", n + 2);
            refuse("tachometer.pulse_time_ns", value, "times in ascending order")
        }
        None => Ok(()),
    }
}

fn check_names(names: &[String], channels: usize) -> Result<(), ServiceError> {
    let refuse = |expected: &'static str| {
        let (field, value) = ("channel_names", format!("{names:?}"));
        Err(ServiceError::Field { field, value, expected: expected.into() })
    };
    if !names.is_empty() && names.len() != channels {
        return refuse("as many names as the recording has channels");
    }
    if (1..names.len()).any(|n| names[..n].contains(&names[n])) {
        return refuse("each name at most once");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stored_media_type_tells_which_series_are_channels() {
        let csv = RecordFormat::from_media_type("text/csv;sensitivity=100").unwrap();
        let stored = csv.stored_media_type(Some("g"));
        assert_eq!(stored, "text/csv;sensitivity=100; channels=vibration; unit=g");
        assert_eq!(RecordFormat::from_media_type(&stored), Some(csv));
        let parts = StoredMediaType::of(&stored);
        assert_eq!((parts.has_every_series, parts.unit), (false, Some("g")));
        assert!(StoredMediaType::of("text/csv; unit=g").has_every_series);
        assert_eq!(RecordFormat::Json.stored_media_type(None), "application/json");
    }
}
