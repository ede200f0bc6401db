//! The query parameters of an upload, and the format and metadata they give.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::csv_preview::{CsvParameters, check_rate};
use crate::http::problem::Problem;
use crate::http::request::body;
use crate::recording::RawLayout;
use crate::service::{ChannelNames, RecordFormat, SampleFile, UploadMetadata};
use crate::signal::OperatingPoint;

const RAW: &str = "application/octet-stream";
const EXPECTED: &str = "audio/wav, audio/flac, text/csv, application/x-matlab-data, application/x-npy, application/x-protobuf, application/json, application/mcap or application/octet-stream";

/// Parameters that only some formats use.
const OF_FORMATS: [&str; 8] = [
    "sample",
    "channels",
    "recorded_channels",
    "time_column",
    "columns",
    "sample_rate_hz",
    "scale",
    "sensitivity_mv_per_g",
];

/// Record metadata in the query of an upload.
#[derive(Debug, Clone, Default, Deserialize, Serialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct UploadParameters {
    /// Time of the first sample if the recording does not contain it; by default the time of receipt.
    start_time: Option<Timestamp>,
    /// Rotational frequency of the driving shaft in hertz.
    #[param(example = 29.7)]
    shaft_speed_hz: Option<f64>,
    /// Torque on the driving shaft in newton metres.
    torque_nm: Option<f64>,
    /// Oil or housing temperature in degrees Celsius.
    #[param(example = 62.5)]
    temperature_c: Option<f64>,
    /// The channel's name, if the recording has none.
    channel: Option<String>,
    /// Names of the channels of a multi-channel recording, in order, comma-separated; for MCAP, those of the
    /// channels in `recorded_channels`.
    #[param(example = "input,output")]
    channel_names: Option<String>,
    /// For MCAP: names in the recording of the channels that get the names in `channel_names`, in the same
    /// order, comma-separated. Other channels keep their names.
    #[param(example = "gearbox/x,gearbox/y")]
    recorded_channels: Option<String>,
    /// Unit of the samples if the recording does not contain it.
    #[param(example = "m/s2")]
    unit: Option<String>,
    /// Units of the channels named in `channel_names`, in order, comma-separated, for samples whose unit the
    /// recording does not contain; empty entries use `unit`.
    #[param(example = "g,m/s2")]
    channel_units: Option<String>,
    /// Wear depth in µm from an inspection: shown beside the estimate, never used by it.
    reference_wear_um: Option<f64>,
    /// For `application/octet-stream`: sample format, `f32` or `i16`, little-endian, channels interleaved.
    sample: Option<String>,
    /// Sampling rate in hertz: for `application/octet-stream` and `application/x-npy`, and for `text/csv` and
    /// `application/x-matlab-data` that do not contain it.
    #[param(example = 12800.0)]
    sample_rate_hz: Option<f64>,
    /// For `text/csv`: number of the time column, from 1; 0 for none. By default detected from names and
    /// values.
    #[param(minimum = 0, maximum = 256)]
    time_column: Option<u16>,
    /// For `text/csv`: numbers of the channel columns, from 1, comma-separated; by default all but the time
    /// column.
    #[param(example = "2,3")]
    columns: Option<String>,
    /// For `application/octet-stream`: number of channels, default 1.
    channels: Option<u32>,
    /// Factor for each value, stored with the record. Full-scale integers of WAV and FLAC are 1 before it.
    /// For `application/octet-stream`: value of one count in `unit`; default 1 for `f32`, 1/32768 for `i16`.
    /// Not for messages and MCAP.
    scale: Option<f64>,
    /// Sensitivity of the sensor in mV/g: converts values in volts (after `scale`), or in mV if a CSV file
    /// states so, to g. For WAV, FLAC, CSV, MATLAB and NumPy files.
    #[param(example = 100.0)]
    sensitivity_mv_per_g: Option<f64>,
}

impl UploadParameters {
    /// Returns the parameters that are given, by name.
    fn given(&self) -> Map<String, Value> {
        let Ok(Value::Object(mut given)) = serde_json::to_value(self) else { return Map::new() };
        given.retain(|_, value| !value.is_null());
        given
    }

    /// Returns the format of a body; a problem if a value is given that the format does not use.
    pub(crate) fn format(&self, media_type: Option<&str>) -> Result<RecordFormat, Problem> {
        if media_type == Some(RAW) {
            self.check_used(&["sample", "channels", "sample_rate_hz", "scale", "sensitivity_mv_per_g"])?;
            return self.raw_format();
        }
        let format = media_type.and_then(RecordFormat::from_media_type);
        let format = format.ok_or_else(|| body::unsupported(media_type, EXPECTED))?;
        let used: &[&str] = match format {
            RecordFormat::File(SampleFile { kind, .. }) if kind.has_rate() => {
                &["scale", "sensitivity_mv_per_g"]
            }
            RecordFormat::File(_) => &["sample_rate_hz", "scale", "sensitivity_mv_per_g"],
            RecordFormat::Csv(_) => {
                &["sample_rate_hz", "scale", "sensitivity_mv_per_g", "time_column", "columns"]
            }
            _ => &[],
        };
        self.check_used(used)?;
        let (sample_rate_hz, scale) = (self.sample_rate_hz, self.scale()?);
        let sensitivity_mv_per_g = self.sensitivity_mv_per_g()?;
        Ok(match format {
            RecordFormat::Csv(_) => {
                let columns = self.columns.clone();
                let mut layout = CsvParameters::new(sample_rate_hz, self.time_column, columns).layout()?;
                layout.scale = scale;
                layout.sensitivity_mv_per_g = sensitivity_mv_per_g;
                RecordFormat::Csv(layout)
            }
            RecordFormat::File(file) => {
                check_rate(sample_rate_hz)?;
                RecordFormat::File(SampleFile { sample_rate_hz, scale, sensitivity_mv_per_g, ..file })
            }
            other => other,
        })
    }

    /// Refuses a value that the format does not use: ignoring it would give wrong records.
    fn check_used(&self, used: &[&str]) -> Result<(), Problem> {
        let given = self.given();
        let mut unused = OF_FORMATS.iter().filter(|name| !used.contains(name));
        match unused.find(|name| given.contains_key(**name)) {
            Some(name) => Err(Problem::query(name, "given", "no value with this content-type")),
            None => Ok(()),
        }
    }

    fn raw_format(&self) -> Result<RecordFormat, Problem> {
        if self.sensitivity_mv_per_g.is_some() {
            return Err(Problem::query(
                "sensitivity_mv_per_g",
                "given",
                "no value for raw samples: use scale",
            ));
        }
        let missing = |field| Problem::query(field, "missing", "a value, as raw samples do not contain it");
        let sample = self.sample.as_deref().ok_or_else(|| missing("sample"))?;
        let rate = self.sample_rate_hz.ok_or_else(|| missing("sample_rate_hz"))?;
        let layout = sample
            .parse()
            .and_then(|sample| RawLayout::new(sample, rate, self.channels.unwrap_or(1), self.scale));
        Ok(RecordFormat::Raw(layout?))
    }

    /// Returns what is given beside the samples.
    pub(crate) fn metadata(&self) -> Result<UploadMetadata, Problem> {
        if self.sensitivity_mv_per_g.is_some() {
            for (name, given) in [("unit", &self.unit), ("channel_units", &self.channel_units)] {
                if let Some(unit) = listed(given).iter().find(|unit| !["", "g"].contains(&unit.as_str())) {
                    return Err(Problem::query(name, unit, "g, or no value, with sensitivity_mv_per_g"));
                }
            }
        }
        Ok(UploadMetadata {
            start_time: self.start_time,
            channel: self.channel.clone(),
            channel_names: listed(&self.channel_names),
            unit: self.unit.clone(),
            channel_units: listed(&self.channel_units),
            operating_point: OperatingPoint {
                shaft_speed_hz: self.shaft_speed_hz,
                torque_nm: self.torque_nm,
                temperature_c: self.temperature_c,
            },
            reference_wear_um: self.reference_wear_um,
        })
    }

    /// Returns the factor for each value, if one is given.
    fn scale(&self) -> Result<Option<f64>, Problem> {
        if let Some(scale) = self.scale.filter(|scale| *scale == 0.0 || !scale.is_finite()) {
            return Err(Problem::query("scale", scale, "a finite number other than 0"));
        }
        Ok(self.scale)
    }

    /// Returns the sensitivity, if one is given.
    fn sensitivity_mv_per_g(&self) -> Result<Option<f64>, Problem> {
        match self.sensitivity_mv_per_g {
            Some(value) if !(value > 0.0 && value.is_finite()) => {
                Err(Problem::query("sensitivity_mv_per_g", value, "a finite number above 0"))
            }
            given => Ok(given),
        }
    }

    /// Returns the new names of an MCAP recording's channels; a problem if anything else is given, as the
    /// recording contains it.
    pub(crate) fn channels_of_recording(&self) -> Result<ChannelNames, Problem> {
        const USED: [&str; 3] = ["recorded_channels", "channel_names", "channel_units"];
        if let Some(name) = self.given().keys().find(|name| !USED.contains(&name.as_str())) {
            return Err(Problem::query(name, "given", "no value: an MCAP file contains it for each record"));
        }
        let [recorded, names, units] =
            [&self.recorded_channels, &self.channel_names, &self.channel_units].map(listed);
        Ok(ChannelNames::new(&recorded, &names, &units)?)
    }
}

/// The entries of a comma-separated list.
fn listed(list: &Option<String>) -> Vec<String> {
    let list = list.as_deref();
    list.map(|list| list.split(',').map(|each| each.trim().to_string()).collect()).unwrap_or_default()
}
