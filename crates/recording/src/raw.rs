//! Raw samples, little-endian, channels interleaved, as converters deliver them. All other data is given
//! separately.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::block::check_sample_count;
use super::{RecordDefaults, RecordingError};
use flankwatch_signal::Record;

/// Media type of raw samples.
const MEDIA_TYPE: &str = "application/octet-stream";

/// Largest number of channels.
const MAX_CHANNELS: u32 = 256;

/// Type of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RawSample {
    /// 32-bit floating point.
    F32,
    /// 16-bit integer.
    I16,
}

impl RawSample {
    /// Returns the size of one sample in bytes.
    pub fn bytes(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::I16 => 2,
        }
    }

    /// Returns `f32` or `i16`.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::I16 => "i16",
        }
    }

    /// Returns the default scale: 1, or integers scaled to −1…1 as in WAV.
    pub(crate) fn default_scale(self) -> f64 {
        match self {
            Self::F32 => 1.0,
            Self::I16 => 1.0 / 32_768.0,
        }
    }

    /// Returns the value of one sample's bytes, before scaling.
    pub(crate) fn value(self, bytes: &[u8]) -> f64 {
        match (self, bytes) {
            (Self::F32, &[a, b, c, d, ..]) => f32::from_le_bytes([a, b, c, d]).into(),
            (Self::I16, &[a, b, ..]) => i16::from_le_bytes([a, b]).into(),
            _ => f64::NAN,
        }
    }
}

impl FromStr for RawSample {
    type Err = RecordingError;

    fn from_str(name: &str) -> Result<Self, RecordingError> {
        match name {
            "f32" => Ok(Self::F32),
            "i16" => Ok(Self::I16),
            _ => Err(RecordingError::field("sample", name, "f32 or i16")),
        }
    }
}

/// Layout of raw samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawLayout {
    sample: RawSample,
    sample_rate_hz: f64,
    channels: u32,
    scale: f64,
}

impl RawLayout {
    /// Creates a layout. `scale` is the value of one count in the record's unit.
    pub fn new(
        sample: RawSample,
        sample_rate_hz: f64,
        channels: u32,
        scale: Option<f64>,
    ) -> Result<Self, RecordingError> {
        if !(1..=MAX_CHANNELS).contains(&channels) {
            return Err(RecordingError::field("channels", channels, "a number from 1 to 256"));
        }
        let scale = scale.unwrap_or_else(|| sample.default_scale());
        if scale == 0.0 || !scale.is_finite() {
            return Err(RecordingError::field("scale", scale, "a finite number other than 0"));
        }
        Ok(Self { sample, sample_rate_hz, channels, scale })
    }

    /// Parses the output of [`Display`](fmt::Display); `None` for another media type.
    pub fn from_media_type(media_type: &str) -> Option<Self> {
        let mut parts = media_type.split(';');
        if parts.next()? != MEDIA_TYPE {
            return None;
        }
        let (mut sample, mut rate, mut channels, mut scale) = (None, None, None, None);
        for part in parts {
            let (name, value) = part.split_once('=')?;
            match name {
                "sample" => sample = value.parse().ok(),
                "rate" => rate = value.parse().ok(),
                "channels" => channels = value.parse().ok(),
                "scale" => scale = value.parse().ok(),
                _ => return None,
            }
        }
        Self::new(sample?, rate?, channels?, scale).ok()
    }
}

impl fmt::Display for RawLayout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { sample, sample_rate_hz, channels, scale } = self;
        write!(
            f,
            "{MEDIA_TYPE};sample={};rate={sample_rate_hz};channels={channels};scale={scale}",
            sample.name()
        )
    }
}

/// Reads raw samples as one record per channel, named like those of a WAV.
pub fn decode_raw(
    bytes: &[u8],
    layout: RawLayout,
    defaults: &RecordDefaults,
) -> Result<Vec<Record>, RecordingError> {
    if bytes.is_empty() {
        return Err(RecordingError::NoBytes);
    }
    let channels = layout.channels as usize;
    let frame = layout.sample.bytes() * channels;
    if !bytes.len().is_multiple_of(frame) {
        return Err(RecordingError::field(
            "the body's length",
            bytes.len(),
            "a multiple of the bytes of one sample of every channel",
        ));
    }
    let names = defaults.names_of(channels);
    check_sample_count(&names[0], bytes.len() / frame)?;
    let value = |at: usize| layout.sample.value(&bytes[at..]);
    let record = |(channel, name): (usize, String)| {
        let at = (channel * layout.sample.bytes()..bytes.len()).step_by(frame);
        let samples = at.map(|at| (value(at) * layout.scale) as f32).collect();
        let unit = defaults.unit_of(&name);
        let record = Record::new(name.as_str(), defaults.start_time, layout.sample_rate_hz, unit, samples)?;
        Ok(record.with_operating_point(defaults.operating_point)?)
    };
    names.into_iter().enumerate().map(record).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(
        bytes: &[u8],
        sample: RawSample,
        channels: u32,
        scale: Option<f64>,
    ) -> Result<Vec<Record>, RecordingError> {
        decode_raw(bytes, RawLayout::new(sample, 1000.0, channels, scale)?, &RecordDefaults::default())
    }

    #[test]
    fn channels_are_deinterleaved_and_integers_scaled() {
        let bytes: Vec<u8> = [16384_i16, -32768, 0, 16384].iter().flat_map(|n| n.to_le_bytes()).collect();
        let records = read(&bytes, RawSample::I16, 2, None).unwrap();
        assert_eq!(records[0].samples(), [0.5, 0.0]);
        assert_eq!(records[1].samples(), [-1.0, 0.5]);
        assert_eq!(records[1].channel(), "2");
        assert_eq!(read(&bytes, RawSample::I16, 1, Some(0.001)).unwrap()[0].samples()[1], -32.768);
    }

    #[test]
    fn mismatched_lengths_are_rejected() {
        assert!(read(&[], RawSample::F32, 1, None).is_err());
        assert!(read(&[0; 6], RawSample::F32, 1, None).is_err());
        assert!(read(&[0; 4], RawSample::F32, 0, None).is_err());
        assert!(read(&[0; 4], RawSample::F32, 1, Some(0.0)).is_err());
        assert!(read(&f32::NAN.to_le_bytes(), RawSample::F32, 1, None).is_err());
        assert!(RawLayout::from_media_type("application/octet-stream").is_none());
        assert!(RawLayout::from_media_type("audio/wav").is_none());
    }

    proptest! {
        #[test]
        fn floats_come_back_and_so_does_the_layout(samples in prop::collection::vec(-1e30f32..1e30, 1..100), rate in 1.0..1e6f64) {
            let bytes: Vec<u8> = samples.iter().flat_map(|x| x.to_le_bytes()).collect();
            let layout = RawLayout::new(RawSample::F32, rate, 1, None).unwrap();
            prop_assert_eq!(RawLayout::from_media_type(&layout.to_string()), Some(layout));
            let records = decode_raw(&bytes, layout, &RecordDefaults::default()).unwrap();
            prop_assert_eq!(records[0].samples(), &samples[..]);
        }
    }
}
