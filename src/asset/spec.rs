//! An asset: one gear mesh, or a machine without one, seen by one or more measuring channels. Meshes that one sensor hears together are
//! an asset each.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::alarm_rules;
use super::bearing::{self, BearingSpec};
use super::operating_bin::{self, OperatingBin};
use super::other_mesh::{self, OtherMeshSpec};
use super::pair_of_numbers;
use super::place::{self, Location, MeasuringPoint};
use super::shaft::{self, ShaftSpec};
use super::stream_spec::StreamSpec;
use super::velocity_zones::{VelocityZone, VelocityZones};
use crate::estimate::AlarmRule;
use crate::gear::PairSpec;
use crate::signal::{
    Band, BandSource, Bearing, BearingSettings, ConditionSettings, Described, EnvelopeBand, EnvelopeSearch,
    Indicators, MeshContext, Record, VELOCITY_RMS,
};

/// An asset's name in addresses and topics: 1 to 64 of `a-z`, `0-9`, `-`, `_`, starting with a letter or
/// digit.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(try_from = "String", into = "String")]
#[schema(value_type = String, pattern = "^[a-z0-9][a-z0-9_-]{0,63}$", example = "gearbox-1")]
pub struct AssetId(String);

/// Why an asset's description cannot be used.
#[derive(Debug, Error)]
pub enum AssetError {
    /// The name has characters that do not belong in addresses.
    #[error(
        "asset id {0:?} is not usable, expected 1 to 64 characters of a-z, 0-9, - and _, the first a letter or digit"
    )]
    Id(String),
    /// A field has a value that cannot be used.
    #[error("{field} is {value}, expected {expected}")]
    Field {
        /// Path of the field.
        field: &'static str,
        /// Its value.
        value: String,
        /// What would have been right.
        expected: Cow<'static, str>,
    },
    /// The gear pair cannot be built.
    #[error("gear.pair: {0}")]
    Pair(#[from] crate::gear::GearError),
    /// Not TOML, or a field is missing, unknown or of the wrong type.
    #[error("not an asset description: {0}")]
    Toml(#[from] toml::de::Error),
}

/// An asset as the user describes it (TOML in files, JSON over HTTP).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct AssetSpec {
    /// Name in addresses.
    pub id: AssetId,
    /// Name for people.
    #[serde(default)]
    pub name: String,
    /// Where it is.
    #[serde(default, skip_serializing_if = "Location::is_empty")]
    pub location: Location,
    /// The monitored mesh; none where the machine has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gear: Option<GearSpec>,
    /// The shaft of a machine without a mesh.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shaft: Option<ShaftSpec>,
    /// The rolling bearings that the sensor hears.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub bearings: Vec<BearingSpec>,
    /// The zones of ISO 20816 for the root mean square of velocity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub velocity_zones: Option<VelocityZones>,
    /// The accelerometer.
    #[serde(default)]
    pub sensor: SensorSpec,
    /// The measuring points with their sensors, where more is to be said of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub points: Vec<MeasuringPoint>,
    /// How the healthy baseline is collected.
    #[serde(default)]
    pub baseline: BaselineSpec,
    /// Limits on wear depth.
    #[serde(default)]
    pub limits: WearLimits,
    /// When alarms are raised; where not given it follows from the limits. An empty list is none at all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alarms: Option<Vec<AlarmRule>>,
    /// Operating points told apart in trends.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub operating_bins: Vec<OperatingBin>,
    /// Band of the envelope spectrum in hertz; where not given it is looked for in each record.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub envelope_band_hz: Option<[f64; 2]>,
    /// How the band of the envelope spectrum is looked for.
    #[serde(default, skip_serializing_if = "EnvelopeSearch::is_default")]
    pub envelope_band: EnvelopeSearch,
    /// Whether the indicators over the shaft's angle (FM0, FM4, NA4 …) are computed of each record.
    #[serde(default = "default_gear_indicators")]
    pub gear_indicators: bool,
    /// Frequency bands whose root mean square becomes an indicator of each record.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub bands: Vec<Band>,
    /// Which parts of live streams become records.
    #[serde(default, skip_serializing_if = "StreamSpec::is_default")]
    pub stream: StreamSpec,
}

/// The monitored gear mesh.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct GearSpec {
    /// Tooth numbers of the driving and the driven gear.
    #[serde(deserialize_with = "pair_of_numbers::teeth")]
    pub teeth: [u32; 2],
    /// Nominal rotational frequency of the driving shaft in hertz.
    pub shaft_speed_hz: f64,
    /// Turns of the driving shaft against turns of the shaft that speed, torque and tachometer of the records
    /// are of, for a further stage of a gearbox: the teeth that drive, multiplied along the way from that
    /// shaft to this one, and those that are driven. Where not given it is that shaft itself.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "pair_of_numbers::shaft_ratio"
    )]
    #[schema(example = json!([24, 36]))]
    pub shaft_ratio: Option<[u32; 2]>,
    /// Other meshes that the sensor hears and no asset watches, at most 7; those that assets watch through
    /// the same sensor are known without.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub other_meshes: Vec<OtherMeshSpec>,
    /// How far from nominal the speed is searched, as a fraction.
    #[serde(default = "default_speed_tolerance")]
    pub speed_tolerance: f64,
    /// The nominal speed is exact (a synchronous drive): it is used as it is.
    #[serde(default)]
    pub speed_is_exact: bool,
    /// The gear pair for the wear library. Without it indicators are computed, and no wear is claimed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pair: Option<PairSpec>,
}

/// The accelerometer of an asset.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SensorSpec {
    /// Unit of the samples where the recording does not say (`"m/s2"`, `"g"`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// The channel whose wear estimate speaks for the asset; the first one seen where not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub channel: Option<String>,
    /// Another asset whose measuring points hear this mesh too: records that come for that one are looked at
    /// for this one as well, and none are taken for this one alone. It stays what it is once there are
    /// records.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub of: Option<AssetId>,
}

/// How the healthy baseline is collected.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BaselineSpec {
    /// Records needed, at least 8.
    #[serde(default = "default_baseline_records")]
    pub records: u32,
}

/// The user's limits on wear depth in µm.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WearLimits {
    /// Wear depth from which maintenance is to be planned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warning_um: Option<f64>,
    /// Wear depth from which the gear must not run on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub danger_um: Option<f64>,
}

/// The most bands of an asset: each is stored with every record.
const MAX_BANDS: usize = 16;

/// The greatest depth of a limit in µm, as of an inspection.
const GREATEST_DEPTH_UM: f64 = 1e5;

/// The highest frequency of a band in hertz: half of more than any sampling rate.
const GREATEST_FREQUENCY_HZ: f64 = 1e7;

fn default_speed_tolerance() -> f64 {
    0.05
}

fn default_gear_indicators() -> bool {
    true
}

fn default_baseline_records() -> u32 {
    20
}

impl Default for BaselineSpec {
    fn default() -> Self {
        Self { records: default_baseline_records() }
    }
}

impl AssetId {
    /// Checks a name.
    pub fn new(id: impl Into<String>) -> Result<Self, AssetError> {
        let id = id.into();
        let first_is_alphanumeric =
            id.chars().next().is_some_and(|c| c.is_ascii_lowercase() || c.is_ascii_digit());
        let rest_is_usable =
            id.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_');
        if first_is_alphanumeric && rest_is_usable && id.len() <= 64 {
            Ok(Self(id))
        } else {
            Err(AssetError::Id(id))
        }
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for AssetId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl TryFrom<String> for AssetId {
    type Error = AssetError;

    fn try_from(id: String) -> Result<Self, AssetError> {
        Self::new(id)
    }
}

impl From<AssetId> for String {
    fn from(id: AssetId) -> Self {
        id.0
    }
}

impl AssetSpec {
    /// Reads a description from TOML and checks it.
    pub fn from_toml(text: &str) -> Result<Self, AssetError> {
        let spec: Self = toml::from_str(text)?;
        spec.validate()?;
        Ok(spec)
    }

    /// Checks every number; a description that passes can be monitored.
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
        place::check_text("name", Some(self.name.as_str()).filter(|name| !name.is_empty()))?;
        place::check_text("sensor.unit", self.sensor.unit.as_deref())?;
        place::check_text("sensor.channel", self.sensor.channel.as_deref())?;
        self.location.validate()?;
        place::validate(&self.points)?;
        self.stream.validate()?;
        alarm_rules::validate(self)?;
        operating_bin::validate(&self.operating_bins)?;
        if !(8..=10_000).contains(&self.baseline.records) {
            return Err(field("baseline.records", self.baseline.records, "a number from 8 to 10000"));
        }
        for (name, limit) in
            [("limits.warning_um", self.limits.warning_um), ("limits.danger_um", self.limits.danger_um)]
        {
            if let Some(limit) = limit
                && self.gear.is_none()
            {
                return Err(field(name, limit, "nothing without gear: there is no wear depth"));
            }
            if let Some(limit) = limit
                && !(limit > 0.0 && limit <= GREATEST_DEPTH_UM)
            {
                return Err(field(name, limit, "a depth above 0 and at most 100000"));
            }
        }
        if let (Some(warning), Some(danger)) = (self.limits.warning_um, self.limits.danger_um)
            && warning > danger
        {
            return Err(field("limits.warning_um", warning, "a depth at or below limits.danger_um"));
        }
        if let Some([low, high]) = self.envelope_band_hz
            && !(low >= 0.0 && low < high && high <= GREATEST_FREQUENCY_HZ)
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
                "nothing beside envelope_band_hz: the band is given or looked for",
            ));
        }
        if self.bands.len() > MAX_BANDS {
            return Err(field("bands", format!("a list of {}", self.bands.len()), "at most 16 bands"));
        }
        for (index, band) in self.bands.iter().enumerate() {
            if !band.is_usable()
                || band.band_hz[1] > GREATEST_FREQUENCY_HZ
                || self.bands[..index].iter().any(|other| other.name == band.name)
            {
                return Err(field(
                    "bands",
                    format!("name = {:?}, band_hz = {:?}", band.name, band.band_hz),
                    "a name of its own of 1 to 32 characters of a-z, 0-9 and _, and two frequencies from 0 to 1e7, the lower one first",
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
                Err(field("shaft", "given beside gear", "one of both: the mesh's speed is in gear"))
            }
            (Some(shaft), None) => shaft.validate(),
            (None, Some(_)) => Ok(()),
            (None, None) => Err(field("gear", "missing", "a mesh, or shaft for a machine without one")),
        }
    }

    /// The name for people, or the one in addresses where there is none.
    pub fn name_or_id(&self) -> &str {
        if self.name.is_empty() { self.id.as_str() } else { &self.name }
    }

    /// The band of the envelope spectrum, where it is given.
    pub fn given_envelope_band(&self) -> Option<EnvelopeBand> {
        self.envelope_band_hz.map(|band_hz| EnvelopeBand::given(band_hz, BandSource::Asset))
    }

    /// Units of the samples of measuring points that have one of their own, by channel.
    pub fn channel_units(&self) -> BTreeMap<String, String> {
        let with_unit = |point: &MeasuringPoint| Some((point.channel.clone(), point.unit.clone()?));
        self.points.iter().filter_map(with_unit).collect()
    }

    /// What is worked out of each record, its bearings being [`bearings`](Self::bearings).
    pub fn condition_settings<'a>(&'a self, bearings: &'a [Bearing]) -> ConditionSettings<'a> {
        let bearings = if bearings.is_empty() {
            BearingSettings::default()
        } else {
            BearingSettings { bearings, band_hz: self.envelope_band_hz, search: self.envelope_band }
        };
        ConditionSettings {
            mesh: self.mesh_context(),
            bands: &self.bands,
            gear_indicators: self.gear_indicators,
            bearings,
        }
    }

    /// The bearings as the shaft whose speed is meant hears them.
    pub fn bearings(&self) -> Vec<Bearing> {
        let driving_turns = self.gear.as_ref().map_or(1.0, GearSpec::driving_shaft_turns);
        self.bearings.iter().filter_map(|bearing| bearing.seen_from(driving_turns)).collect()
    }

    /// The names of all indicators that its records can have.
    pub fn indicator_names(&self) -> Vec<String> {
        let bearings = self.bearings();
        let has_mesh = self.gear.is_some();
        Indicators::names(&Described { bands: &self.bands, bearings: &bearings, has_mesh })
    }

    /// The zone of a record's velocity, where zones are described and it has one.
    pub fn velocity_zone(&self, indicators: &Indicators) -> Option<VelocityZone> {
        Some(self.velocity_zones?.zone(indicators.get(VELOCITY_RMS)?))
    }

    /// The gear pair, where it is described.
    pub fn pair(&self) -> Option<&PairSpec> {
        self.gear.as_ref()?.pair.as_ref()
    }

    /// Tooth numbers of the driving and the driven gear.
    pub fn teeth(&self) -> Option<[u32; 2]> {
        Some(self.gear.as_ref()?.teeth)
    }

    /// Nominal rotational frequency in hertz of the shaft whose speed is meant.
    pub fn nominal_speed_hz(&self) -> Option<f64> {
        let of_shaft = || self.shaft?.speed_hz;
        self.gear.as_ref().map(|gear| gear.shaft_speed_hz).or_else(of_shaft)
    }

    /// A record as the driving shaft of the mesh sees it.
    pub fn seen_from_shaft<'a>(&self, record: &'a Record) -> Cow<'a, Record> {
        match &self.gear {
            Some(gear) if gear.shaft_ratio.is_some() => {
                Cow::Owned(record.clone().seen_from_shaft(gear.driving_shaft_turns()))
            }
            _ => Cow::Borrowed(record),
        }
    }

    /// What the signal code needs to know of the mesh, or of the shaft where there is none.
    pub fn mesh_context(&self) -> MeshContext {
        match (&self.gear, self.shaft) {
            (Some(gear), _) => MeshContext {
                teeth: gear.teeth[0],
                mate_teeth: gear.teeth[1],
                nominal_shaft_speed_hz: gear.shaft_speed_hz,
                tolerance: gear.speed_tolerance,
                nominal_is_exact: gear.speed_is_exact,
                others: gear.others(),
            },
            (None, Some(shaft)) => MeshContext {
                nominal_shaft_speed_hz: shaft.speed_hz.unwrap_or(0.0),
                tolerance: shaft.speed_tolerance,
                nominal_is_exact: shaft.speed_is_exact,
                ..MeshContext::unknown()
            },
            (None, None) => MeshContext::unknown(),
        }
    }
}

impl GearSpec {
    /// Checks teeth and speed against their limits; the numbers of the pair are left to [`PairSpec::check`].
    pub fn check_beside_pair(&self) -> Result<(), AssetError> {
        if self.teeth.iter().any(|z| !(4..=1000).contains(z)) {
            return Err(field("gear.teeth", format!("{:?}", self.teeth), "two tooth numbers from 4 to 1000"));
        }
        let names = ["gear.shaft_speed_hz", "gear.speed_tolerance"];
        shaft::check_speed(names, self.shaft_speed_hz, self.speed_tolerance)
    }

    /// Checks that the pair has the teeth of the mesh.
    pub fn check_pair_teeth(&self) -> Result<(), AssetError> {
        match &self.pair {
            Some(pair) if pair.geometry.teeth != self.teeth => Err(field(
                "gear.pair.geometry.teeth",
                format!("{:?}", pair.geometry.teeth),
                "the same tooth numbers as gear.teeth",
            )),
            _ => Ok(()),
        }
    }
}

pub(super) fn field(
    field: &'static str,
    value: impl fmt::Display,
    expected: impl Into<Cow<'static, str>>,
) -> AssetError {
    AssetError::Field { field, value: value.to_string(), expected: expected.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_bands(bands: &str) -> Result<AssetSpec, AssetError> {
        AssetSpec::from_toml(&format!("id = \"a\"\n{bands}\n[gear]\nteeth = [24, 36]\nshaft_speed_hz = 16.6"))
    }

    #[test]
    fn a_place_and_its_points_are_read_and_checked() {
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
    fn numbers_beyond_all_measure_are_refused_with_their_bound() {
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
