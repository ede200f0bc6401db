//! The monitored mesh.

use serde::{Deserialize, Serialize};

use super::error::{AssetError, field};
use super::other_mesh::OtherMeshSpec;
use super::{integer_pair, shaft};
use crate::gear::PairSpec;

/// The monitored gear mesh.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct GearSpec {
    /// Tooth counts of the driving and the driven gear.
    #[serde(deserialize_with = "integer_pair::teeth")]
    pub teeth: [u32; 2],
    /// Nominal rotational frequency of the driving shaft in hertz.
    pub shaft_speed_hz: f64,
    /// Turns of the driving shaft relative to turns of the reference shaft, to which speed, torque and
    /// tachometer of the records refer, for a further stage of a gearbox: the product of the driving tooth
    /// numbers from the reference shaft to this one, and that of the driven ones. By default the driving
    /// shaft is the reference shaft.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "integer_pair::shaft_ratio"
    )]
    #[schema(example = json!([24, 36]))]
    pub shaft_ratio: Option<[u32; 2]>,
    /// Other meshes within range of the sensor that no asset monitors, at most 7. Meshes monitored by assets
    /// with the same sensor are added automatically.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub other_meshes: Vec<OtherMeshSpec>,
    /// Relative range around the nominal speed in which the speed is searched, as a fraction.
    #[serde(default = "default_speed_tolerance")]
    pub speed_tolerance: f64,
    /// Whether the nominal speed is exact (a synchronous drive) and used without a search.
    #[serde(default)]
    pub speed_is_exact: bool,
    /// The gear pair for the wear library. Without it, indicators are computed but no wear estimate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pair: Option<PairSpec>,
}

fn default_speed_tolerance() -> f64 {
    0.05
}

impl GearSpec {
    /// Checks teeth and speed against their limits; [`PairSpec::check`] checks the pair.
    pub fn check_beside_pair(&self) -> Result<(), AssetError> {
        if self.teeth.iter().any(|z| !(4..=1000).contains(z)) {
            return Err(field("gear.teeth", format!("{:?}", self.teeth), "two tooth counts from 4 to 1000"));
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
                "the same tooth counts as gear.teeth",
            )),
            _ => Ok(()),
        }
    }
}
