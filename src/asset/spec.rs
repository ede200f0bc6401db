//! The description of an asset: one gear mesh, or a machine without one, with one or more measuring channels.
//! Each mesh within range of a shared sensor is a separate asset.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::alarm_rules;
use super::asset_id::AssetId;
use super::bearing::{self, BearingSpec};
use super::error::{AssetError, field};
use super::gear_spec::GearSpec;
use super::location::{self, Location, MeasuringPoint};
use super::operating_bin::{self, OperatingBin};
use super::other_mesh;
use super::shaft::ShaftSpec;
use super::stream_spec::StreamSpec;
use super::velocity_zones::VelocityZones;
use super::wear_limits::WearLimits;
use crate::estimate::AlarmRule;
use crate::gear::{DescriptionError, PairSpec, from_toml};
use crate::signal::{Band, EnvelopeSearch};

/// The user's description of an asset (TOML in files, JSON over HTTP).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct AssetSpec {
    /// Identifier in URLs.
    pub id: AssetId,
    /// Display name.
    #[serde(default)]
    pub name: String,
    /// Its location.
    #[serde(default, skip_serializing_if = "Location::is_empty")]
    pub location: Location,
    /// The monitored mesh; not given for a machine without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gear: Option<GearSpec>,
    /// The shaft of a machine without a mesh.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shaft: Option<ShaftSpec>,
    /// The rolling bearings within range of the sensor.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub bearings: Vec<BearingSpec>,
    /// The zones of ISO 20816 for the root mean square of velocity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub velocity_zones: Option<VelocityZones>,
    /// The accelerometer.
    #[serde(default)]
    pub sensor: SensorSpec,
    /// Optional details of the measuring points and their sensors.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub points: Vec<MeasuringPoint>,
    /// How the healthy baseline is collected.
    #[serde(default)]
    pub baseline: BaselineSpec,
    /// Limits on wear depth.
    #[serde(default)]
    pub limits: WearLimits,
    /// The alarm rules; by default they are derived from the limits. An empty list means no alarms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alarms: Option<Vec<AlarmRule>>,
    /// Ranges of operating points that trends can be filtered by.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub operating_bins: Vec<OperatingBin>,
    /// Band of the envelope spectrum in hertz; by default it is searched in each record.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub envelope_band_hz: Option<[f64; 2]>,
    /// How the band of the envelope spectrum is searched.
    #[serde(default, skip_serializing_if = "EnvelopeSearch::is_default")]
    pub envelope_band: EnvelopeSearch,
    /// Whether the indicators over the shaft's angle (FM0, FM4, NA4 …) are computed for each record.
    #[serde(default = "default_gear_indicators")]
    pub gear_indicators: bool,
    /// Frequency bands whose root mean square becomes an indicator of each record.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub bands: Vec<Band>,
    /// How records are cut out of live streams.
    #[serde(default, skip_serializing_if = "StreamSpec::is_default")]
    pub stream: StreamSpec,
}

/// The accelerometer of an asset.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SensorSpec {
    /// Unit of the samples if the recording does not give it (`"m/s2"`, `"g"`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// The channel whose wear estimate is used for the asset; by default all channels together, and the first
    /// one where a single channel is needed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub channel: Option<String>,
    /// Another asset whose sensor also measures this mesh: the records of that asset are analysed for this
    /// one too, and this one accepts no records of its own. It cannot be changed once the asset has records.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub of: Option<AssetId>,
}

/// How the healthy baseline is collected.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BaselineSpec {
    /// Number of records, at least 8.
    #[serde(default = "default_baseline_records")]
    pub records: u32,
}

/// Maximum number of bands of an asset: each is stored with every record.
const MAX_BANDS: usize = 16;

/// Maximum frequency of a band in hertz, above half of any sampling rate.
const MAX_FREQUENCY_HZ: f64 = 1e7;

fn default_gear_indicators() -> bool {
    true
}

fn default_baseline_records() -> u32 {
    20
}

impl BaselineSpec {
    /// Fewest records of a baseline.
    pub const MIN_RECORDS: u32 = 8;
}

impl Default for BaselineSpec {
    fn default() -> Self {
        Self { records: default_baseline_records() }
    }
}

impl AssetSpec {
    /// Reads a description from TOML and checks it.
    pub fn from_toml(text: &str) -> Result<Self, AssetError> {
        let spec: Self =
            from_toml(text).map_err(|DescriptionError { path, source }| AssetError::Toml { path, source })?;
        spec.validate()?;
        Ok(spec)
    }

    /// Checks every field; an asset with a valid description can be monitored.
    pub fn validate(&self) -> Result<(), AssetError> {
        if let Some(gear) = &self.gear {
            gear.check_beside_pair()?;
        }
        self.check_shaft()?;
        other_mesh::validate(self)?;
        bearing::validate(&self.bearings)?;
        if let Some(zones) = self.velocity_zones {
            zones.validate()?;
        }
        location::check_text("name", Some(self.name.as_str()).filter(|name| !name.is_empty()))?;
        location::check_unit("sensor.unit", self.sensor.unit.as_deref())?;
        location::check_text("sensor.channel", self.sensor.channel.as_deref())?;
        self.location.validate()?;
        location::validate(&self.points)?;
        self.stream.validate()?;
        alarm_rules::validate(self)?;
        operating_bin::validate(&self.operating_bins)?;
        if !(BaselineSpec::MIN_RECORDS..=10_000).contains(&self.baseline.records) {
            return Err(field("baseline.records", self.baseline.records, "a number from 8 to 10000"));
        }
        self.limits.validate(self.gear.is_some())?;
        if let Some([low, high]) = self.envelope_band_hz
            && !(low >= 0.0 && low < high && high <= MAX_FREQUENCY_HZ)
        {
            return Err(field(
                "envelope_band_hz",
                format!("[{low}, {high}]"),
                "two frequencies from 0 to 1e7, the lower one first",
            ));
        }
        if self.envelope_band_hz.is_some() && !self.envelope_band.is_default() {
            return Err(field(
                "envelope_band",
                "kurtogram",
                "either envelope_band_hz or envelope_band, not both",
            ));
        }
        if self.bands.len() > MAX_BANDS {
            return Err(field("bands", format!("a list of {}", self.bands.len()), "at most 16 bands"));
        }
        for (index, band) in self.bands.iter().enumerate() {
            if !band.is_valid()
                || band.band_hz[1] > MAX_FREQUENCY_HZ
                || self.bands[..index].iter().any(|other| other.name == band.name)
            {
                return Err(field(
                    "bands",
                    format!("name = {:?}, band_hz = {:?}", band.name, band.band_hz),
                    "a unique name of 1 to 32 characters of a-z, 0-9 and _, and two frequencies from 0 to 1e7, the lower one first",
                ));
            }
        }
        match &self.gear {
            Some(gear) => {
                if let Some(pair) = &gear.pair {
                    pair.check()?;
                }
                gear.check_pair_teeth()
            }
            None => Ok(()),
        }
    }

    fn check_shaft(&self) -> Result<(), AssetError> {
        match (&self.shaft, &self.gear) {
            (Some(_), Some(_)) => {
                Err(field("shaft", "given together with gear", "only one of both: gear contains the speed"))
            }
            (Some(shaft), None) => shaft.validate(),
            (None, Some(_)) => Ok(()),
            (None, None) => Err(field("gear", "missing", "a mesh, or shaft for a machine without one")),
        }
    }

    /// The display name, or the identifier if there is none.
    pub fn name_or_id(&self) -> &str {
        if self.name.is_empty() { self.id.as_str() } else { &self.name }
    }

    /// Units of the measuring points that give one, by channel.
    pub fn channel_units(&self) -> BTreeMap<String, String> {
        let with_unit = |point: &MeasuringPoint| Some((point.channel.clone(), point.unit.clone()?));
        self.points.iter().filter_map(with_unit).collect()
    }

    /// The gear pair, if it is described.
    pub fn pair(&self) -> Option<&PairSpec> {
        self.gear.as_ref()?.pair.as_ref()
    }

    /// Tooth counts of the driving and the driven gear.
    pub fn teeth(&self) -> Option<[u32; 2]> {
        Some(self.gear.as_ref()?.teeth)
    }

    /// Nominal rotational frequency in hertz of the mesh's driving shaft, or of the shaft of a machine
    /// without a mesh.
    pub fn nominal_speed_hz(&self) -> Option<f64> {
        let of_shaft = || self.shaft?.speed_hz;
        self.gear.as_ref().map(|gear| gear.shaft_speed_hz).or_else(of_shaft)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_bands(bands: &str) -> Result<AssetSpec, AssetError> {
        AssetSpec::from_toml(&format!("id = \"a\"\n{bands}\n[gear]\nteeth = [24, 36]\nshaft_speed_hz = 16.6"))
    }

    #[test]
    fn locations_and_measuring_points_are_read_and_checked() {
        let spec = with_bands(
            "location = { site = \"mill\", machine = \"3\", gearbox = \"A\", mesh = \"first stage\" }
             points = [{ channel = \"a1\", unit = \"g\", sensitivity = 10.2, sensitivity_unit = \"mV/g\", calibrated_on = \"2026-01-31\" }]",
        )
        .unwrap();
        assert_eq!(spec.location.mesh.as_deref(), Some("first stage"));
        let units = spec.channel_units();
        assert_eq!((units.get("a1").map(String::as_str), units.len()), (Some("g"), 1));
        for wrong in [
            "location = { site = \"\" }",
            "location = { floor = \"2\" }",
            "points = [{ channel = \"a\" }, { channel = \"a\" }]",
            "points = [{ channel = \"a\", sensitivity = 0.0 }]",
            "points = [{ channel = \"a\", calibrated_on = \"yesterday\" }]",
        ] {
            assert!(with_bands(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn errors_about_excessive_numbers_contain_the_limit() {
        for (text, name) in [
            ("limits = { danger_um = 1e308 }", "limits.danger_um"),
            ("envelope_band_hz = [1.0, 1e308]", "envelope_band_hz"),
            ("bands = [{ name = \"a\", band_hz = [1, 1e308] }]", "bands"),
            ("points = [{ channel = \"a\", sensitivity = 1e308 }]", "points.sensitivity"),
            ("operating_bins = [{ name = \"a\", torque_nm = [0, 1e308] }]", "operating_bins.torque_nm"),
            ("alarms = [{ quantity = \"novelty\", warning = 1, hysteresis = 1e308 }]", "alarms.hysteresis"),
        ] {
            match with_bands(text) {
                Err(AssetError::Field { field, expected, .. }) => {
                    assert!(
                        field == name && expected.contains(char::is_numeric),
                        "{text}: {field}, {expected}"
                    );
                }
                other => panic!("{text}: {other:?}"),
            }
        }
    }

    #[test]
    fn bands_are_read_and_checked() {
        let spec =
            with_bands("bands = [{ name = \"velocity\", band_hz = [10, 1000], quantity = \"velocity\" }]")
                .unwrap();
        assert_eq!(spec.bands[0].band_hz, [10.0, 1000.0]);
        assert!(with_bands("").unwrap().bands.is_empty());
        for band in [
            "{ name = \"A\", band_hz = [10, 1000] }",
            "{ name = \"a\", band_hz = [10, 10] }",
            "{ name = \"a\", band_hz = [1, 10] }, { name = \"a\", band_hz = [1, 20] }",
        ] {
            let error = with_bands(&format!("bands = [{band}]")).unwrap_err();
            assert!(matches!(error, AssetError::Field { field: "bands", .. }), "{error}");
        }
    }
}
