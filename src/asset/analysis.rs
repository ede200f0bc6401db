//! The parts of an asset's description on which the analysis of its records depends.

use std::borrow::Cow;

use super::gear_spec::GearSpec;
use super::spec::AssetSpec;
use super::velocity_zones::VelocityZone;
use crate::signal::{
    BandSource, Bearing, BearingSettings, ConditionSettings, EnvelopeBand, IndicatorScope, Indicators,
    MeshContext, Record, VELOCITY_RMS,
};

impl AssetSpec {
    /// The band of the envelope spectrum, if it is given.
    pub fn given_envelope_band(&self) -> Option<EnvelopeBand> {
        self.envelope_band_hz.map(|band_hz| EnvelopeBand::given(band_hz, BandSource::Asset))
    }

    /// The settings of the analysis of each record; `bearings` are those of [`bearings`](Self::bearings).
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

    /// The bearings, with their shaft speeds relative to the reference shaft.
    pub fn bearings(&self) -> Vec<Bearing> {
        let driving_turns = self.gear.as_ref().map_or(1.0, GearSpec::driving_shaft_turns);
        self.bearings.iter().filter_map(|bearing| bearing.seen_from(driving_turns)).collect()
    }

    /// The names of all indicators that its records can have.
    pub fn indicator_names(&self) -> Vec<String> {
        let bearings = self.bearings();
        let has_mesh = self.gear.is_some();
        Indicators::names(&IndicatorScope { bands: &self.bands, bearings: &bearings, has_mesh })
    }

    /// The velocity zone of a record; `None` if no zones are described or the record has no velocity.
    pub fn velocity_zone(&self, indicators: &Indicators) -> Option<VelocityZone> {
        Some(self.velocity_zones?.zone(indicators.get(VELOCITY_RMS)?))
    }

    /// Converts a record to the speed, torque and tachometer of the mesh's driving shaft.
    pub fn seen_from_shaft<'a>(&self, record: &'a Record) -> Cow<'a, Record> {
        match &self.gear {
            Some(gear) if gear.shaft_ratio.is_some() => {
                Cow::Owned(record.clone().referred_to_shaft(gear.driving_shaft_turns()))
            }
            _ => Cow::Borrowed(record),
        }
    }

    /// The context of the mesh for the signal analysis, or that of the shaft of a machine without a mesh.
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
