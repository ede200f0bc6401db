//! A frame of a live view: the last samples of a stream, their spectrum and their level.

use bytes::Bytes;
use jiff::Timestamp;
use serde::Serialize;

use crate::asset::AssetSpec;
use crate::recording::stream::StreamFormat;
use crate::service::workers::with_analyzer;
use crate::signal::{MeshContext, OperatingPoint, Record, ShaftSpeed, SpeedSource, reduction};

/// Seconds of samples for a spectrum, and the minimum and maximum number of samples of a channel.
const SPECTRUM_S: f64 = 1.0;
const SPECTRUM_FRAMES: std::ops::RangeInclusive<u64> = 256..=32_768;

/// Maximum number of samples of all channels for one frame.
const MAX_SAMPLES: u64 = 1 << 19;

/// The scope shows the last one in this many parts of the samples.
const SCOPE_PART: usize = 4;

/// Maximum number of points of all scopes and of all spectra of a frame, and the ranges for one channel.
const ALL_POINTS: usize = 8000;
const SCOPE_POINTS: std::ops::RangeInclusive<usize> = 32..=600;
const SPECTRUM_POINTS: std::ops::RangeInclusive<usize> = 32..=1000;

/// A frame of a live view.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct LiveFrame {
    /// Index after the last sample.
    pub next: u64,
    /// Time of the last sample.
    pub time: Option<Timestamp>,
    /// Number of samples of each channel, up to the last one, used for spectrum and level.
    pub samples: u64,
    /// Sampling rate in hertz.
    pub sample_rate_hz: f64,
    /// Unit of the samples; `1` if unknown.
    pub unit: String,
    /// Spacing of the spectrum's bins in hertz; null if there are too few samples.
    pub resolution_hz: Option<f64>,
    /// Number of samples of each channel, up to the last one, shown by the scope.
    pub scope_samples: u64,
    /// Rotational frequency of the mesh's driving shaft in hertz, if known.
    pub shaft_speed_hz: Option<f64>,
    /// The source of the shaft speed.
    pub shaft_speed_source: Option<LiveSpeedSource>,
    /// Mesh frequency at that speed in hertz.
    pub mesh_frequency_hz: Option<f64>,
    /// The channels in order.
    pub channels: Vec<LiveChannel>,
}

/// The source of a shaft speed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LiveSpeedSource {
    /// The sender of the stream.
    Stream,
    /// The lines of the mesh, or of a shaft without one, in the spectrum of a channel.
    Spectrum,
    /// The asset's description: its nominal speed.
    Asset,
}

/// One channel of a frame.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct LiveChannel {
    /// Its name.
    pub name: String,
    /// Root mean square including the mean; null if no sample is a number.
    pub rms: f32,
    /// Largest magnitude.
    pub peak: f32,
    /// Number of samples that are not a number. If there are any, there is no spectrum.
    pub invalid_samples: u64,
    /// Indices, from 0, of the scope samples to draw: the minimum and the maximum of each interval.
    pub scope_index: Vec<u32>,
    /// Their values.
    pub scope: Vec<f32>,
    /// Indices of the spectrum bins to draw: the maximum of each interval. Bin k is at k × `resolution_hz`.
    pub bin: Vec<u32>,
    /// Their peak amplitudes with a Hann window, mean removed.
    pub amplitude: Vec<f32>,
}

/// The number of samples of each channel for a frame of a stream.
pub(super) fn frames_of(format: &StreamFormat) -> u64 {
    let max = (MAX_SAMPLES / format.channels().max(1) as u64).max(1);
    format.frames_in(SPECTRUM_S).clamp(*SPECTRUM_FRAMES.start(), *SPECTRUM_FRAMES.end()).min(max)
}

/// The input of a frame.
pub(super) struct LatestSamples {
    pub(super) format: StreamFormat,
    pub(super) first: u64,
    pub(super) bytes: Bytes,
    pub(super) time: Option<Timestamp>,
    pub(super) operating_point: OperatingPoint,
}

impl LatestSamples {
    /// Index after the last sample.
    pub(super) fn end(&self) -> u64 {
        self.first + (self.bytes.len() / self.format.frame_bytes()) as u64
    }

    pub(super) fn frame(&self, asset: &AssetSpec) -> LiveFrame {
        let channels = self.format.channels();
        let samples = self.bytes.len() / self.format.frame_bytes();
        let unit = self.format.unit.clone().or_else(|| asset.sensor.unit.clone());
        let unit = unit.unwrap_or_else(|| "1".to_owned());
        let (speed_hz, source) = self.described_speed(asset);
        let mut frame = LiveFrame {
            next: self.end(),
            time: self.time,
            samples: samples as u64,
            sample_rate_hz: self.format.sample_rate_hz(),
            unit,
            resolution_hz: None,
            scope_samples: samples.div_ceil(SCOPE_PART) as u64,
            shaft_speed_hz: speed_hz,
            shaft_speed_source: source,
            mesh_frequency_hz: None,
            channels: Vec::with_capacity(channels),
        };
        let mesh = asset.mesh_context();
        let all: Vec<f32> = self.format.values(&self.bytes).collect();
        for n in 0..channels {
            let values: Vec<f32> = all.iter().skip(n).step_by(channels).copied().collect();
            let name = self.format.channel_names.get(n).cloned().unwrap_or_else(|| (n + 1).to_string());
            let channel = self.channel(name, values, &mesh, &mut frame);
            frame.channels.push(channel);
        }
        let teeth = asset.gear.as_ref().map(|gear| f64::from(gear.teeth[0]));
        frame.mesh_frequency_hz = frame.shaft_speed_hz.zip(teeth).map(|(speed_hz, teeth)| speed_hz * teeth);
        frame
    }

    fn channel(
        &self,
        name: String,
        values: Vec<f32>,
        mesh: &MeshContext,
        frame: &mut LiveFrame,
    ) -> LiveChannel {
        let (mut squares, mut valid, mut peak) = (0.0, 0_usize, 0.0_f32);
        for value in values.iter().filter(|value| value.is_finite()) {
            squares += f64::from(*value) * f64::from(*value);
            valid += 1;
            peak = peak.max(value.abs());
        }
        let points = |range: &std::ops::RangeInclusive<usize>| {
            (ALL_POINTS / self.format.channels().max(1)).clamp(*range.start(), *range.end())
        };
        let begin = values.len() - frame.scope_samples as usize;
        let scope: Vec<f64> = values[begin..].iter().map(|value| f64::from(*value)).collect();
        let shown = reduction::extremes(&[&scope], scope.len(), points(&SCOPE_POINTS));
        let mut channel = LiveChannel {
            name,
            rms: rounded((squares / valid as f64).sqrt()),
            peak: rounded(f64::from(peak)),
            invalid_samples: (values.len() - valid) as u64,
            scope: shown.iter().map(|n| rounded(scope[*n])).collect(),
            scope_index: shown.into_iter().map(|n| n as u32).collect(),
            bin: Vec::new(),
            amplitude: Vec::new(),
        };
        let samples = values.len();
        let record = Record::new(
            channel.name.as_str(),
            self.time.unwrap_or_default(),
            frame.sample_rate_hz,
            frame.unit.as_str(),
            values,
        );
        // Fails if a sample is not a number.
        if let Ok(record) = record {
            let (spectrum, speed) =
                with_analyzer(samples, |analyzer| analyzer.spectrum_and_speed(&record, mesh));
            frame.resolution_hz = Some(spectrum.resolution_hz);
            let kept = reduction::peaks(&spectrum.amplitude, points(&SPECTRUM_POINTS));
            channel.amplitude = kept.iter().map(|bin| rounded(spectrum.amplitude[*bin])).collect();
            channel.bin = kept.into_iter().map(|bin| bin as u32).collect();
            // The first channel with clear lines has the speed.
            if matches!(frame.shaft_speed_source, None | Some(LiveSpeedSource::Asset))
                && let Some(speed) = speed.filter(is_clear)
            {
                frame.shaft_speed_hz = Some(speed.shaft_speed_hz);
                frame.shaft_speed_source = Some(LiveSpeedSource::Spectrum);
            }
        }
        channel
    }

    /// The speed of the shaft that drives the mesh from the sender or the description, and its source.
    fn described_speed(&self, asset: &AssetSpec) -> (Option<f64>, Option<LiveSpeedSource>) {
        let turns = asset.gear.as_ref().map_or(1.0, |gear| gear.driving_shaft_turns());
        let nominal_hz = asset.mesh_context().nominal_shaft_speed_hz;
        match self.operating_point.shaft_speed_hz {
            Some(speed_hz) => (Some(speed_hz * turns), Some(LiveSpeedSource::Stream)),
            None if nominal_hz > 0.0 => (Some(nominal_hz), Some(LiveSpeedSource::Asset)),
            None => (None, None),
        }
    }
}

/// Whether a speed is found from lines, most of which stand out: a second of samples may show few of them.
fn is_clear(speed: &ShaftSpeed) -> bool {
    matches!(speed.source, SpeedSource::MeshComb | SpeedSource::ShaftLines)
        && 2 * speed.harmonics_found >= speed.harmonics_sought
        && speed.doubt.is_none()
}

/// Rounds to four significant digits: more are not visible and cost bandwidth.
fn rounded(value: f64) -> f32 {
    if value == 0.0 || !value.is_finite() {
        return value as f32;
    }
    let scale = 10_f64.powi(3 - value.abs().log10().floor() as i32);
    if scale.is_finite() && scale > 0.0 { ((value * scale).round() / scale) as f32 } else { value as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::RawSample;

    fn asset() -> AssetSpec {
        let text = "id = 'pump'\ngear = { teeth = [20, 40], shaft_speed_hz = 15.0 }";
        AssetSpec::from_toml(text).unwrap()
    }

    fn latest(channels: u32, values: impl IntoIterator<Item = f32>) -> LatestSamples {
        LatestSamples {
            format: StreamFormat::new(RawSample::F32, 20_000.0, channels, None).unwrap(),
            first: 100,
            bytes: values.into_iter().flat_map(f32::to_le_bytes).collect(),
            time: Some(Timestamp::UNIX_EPOCH),
            operating_point: OperatingPoint::default(),
        }
    }

    fn sine(n: usize, hz: f64, amplitude: f64) -> f32 {
        (amplitude * (std::f64::consts::TAU * hz * n as f64 / 20_000.0).sin()) as f32
    }

    #[test]
    fn tones_are_at_their_frequencies_with_their_amplitudes_in_every_channel() {
        let values = (0..20_000).flat_map(|n| [sine(n, 1234.0, 3.0), sine(n, 7007.0, 0.02)]);
        let frame = latest(2, values).frame(&asset());
        assert_eq!((frame.next, frame.samples, frame.scope_samples), (20_100, 20_000, 5000));
        assert_eq!((frame.shaft_speed_hz, frame.mesh_frequency_hz), (Some(15.0), Some(300.0)));
        let resolution_hz = frame.resolution_hz.unwrap();
        for (channel, (hz, amplitude)) in frame.channels.iter().zip([(1234.0, 3.0_f32), (7007.0, 0.02)]) {
            assert!(channel.bin.len() <= 1000 && channel.scope.len() <= 600);
            let top = (0..channel.bin.len())
                .max_by(|a, b| channel.amplitude[*a].total_cmp(&channel.amplitude[*b]))
                .unwrap();
            assert!((f64::from(channel.bin[top]) * resolution_hz - hz).abs() <= resolution_hz);
            assert!((channel.amplitude[top] / amplitude - 1.0).abs() < 0.01, "{}", channel.amplitude[top]);
            assert!((channel.rms / amplitude * 2_f32.sqrt() - 1.0).abs() < 1e-3);
            assert!((channel.peak / amplitude - 1.0).abs() < 1e-3);
        }
        assert_eq!(frame.channels[1].name, "2");
    }

    #[test]
    fn nan_samples_and_short_frames_omit_only_the_spectrum() {
        let mut values: Vec<f32> = (0..1000).map(|n| sine(n, 500.0, 1.0)).collect();
        values[900] = f32::NAN;
        let frame = latest(1, values).frame(&asset());
        let [channel] = frame.channels.as_slice() else { panic!("one channel") };
        assert_eq!((channel.invalid_samples, channel.bin.len(), frame.resolution_hz), (1, 0, None));
        assert!((channel.rms - std::f32::consts::FRAC_1_SQRT_2).abs() < 0.01 && !channel.scope.is_empty());
        for few in 0..5 {
            let frame = latest(1, (0..few).map(|n| n as f32)).frame(&asset());
            assert_eq!(frame.samples, few as u64);
            assert!(serde_json::to_string(&frame).is_ok());
        }
    }

    /// Ten harmonics of a mesh of 20 teeth at 14.8 turns a second, in noise.
    fn mesh(n: usize) -> f32 {
        let noise = ((n * 7919 + n * n * 104_729) % 1000) as f32 / 1000.0 - 0.5;
        noise + (1..=10).map(|order| sine(n, 296.0 * f64::from(order), 1.0)).sum::<f32>()
    }

    #[test]
    fn the_speed_is_detected_from_the_lines_of_any_channel() {
        let frame = latest(2, (0..20_000).flat_map(|n| [sine(n, 1234.0, 3.0), mesh(n)])).frame(&asset());
        assert_eq!(frame.shaft_speed_source, Some(LiveSpeedSource::Spectrum));
        assert!((frame.shaft_speed_hz.unwrap() - 14.8).abs() < 0.005, "{:?}", frame.shaft_speed_hz);
        assert!((frame.mesh_frequency_hz.unwrap() - 296.0).abs() < 0.1);
    }

    #[test]
    fn the_speed_of_the_sender_takes_precedence() {
        let mut latest = latest(1, (0..20_000).map(mesh));
        latest.operating_point.shaft_speed_hz = Some(12.5);
        let frame = latest.frame(&asset());
        assert_eq!(frame.shaft_speed_source, Some(LiveSpeedSource::Stream));
        assert_eq!(frame.mesh_frequency_hz, Some(250.0));
    }

    #[test]
    fn the_size_of_a_frame_is_bounded() {
        for (rate_hz, channels) in [(1.0, 1), (1e7, 1), (51_200.0, 256), (1e6, 64)] {
            let format = StreamFormat::new(RawSample::F32, rate_hz, channels, None).unwrap();
            let frames = frames_of(&format);
            assert!(frames * u64::from(channels) <= MAX_SAMPLES && frames >= 256, "{frames}");
            let values = (0..frames * u64::from(channels)).map(|n| (n % 977) as f32);
            let latest = LatestSamples { format, ..latest(1, values) };
            let text = serde_json::to_string(&latest.frame(&asset())).unwrap();
            assert!(text.len() < 400_000, "{channels}: {}", text.len());
        }
    }

    #[test]
    fn numbers_have_four_digits() {
        assert_eq!([1.0, 0.123_456, -98_765.4, 0.0].map(rounded), [1.0, 0.1235, -98_770.0, 0.0]);
        assert!(rounded(f64::NAN).is_nan());
        assert_eq!(rounded(1e-310), 0.0);
    }
}
