//! The monitored mesh.

use serde::{Deserialize, Serialize};

use super::error::{AssetError, field};
use super::other_mesh::OtherMeshSpec;
use super::{pair_of_numbers, shaft};
use crate::gear::PairSpec;

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

fn default_speed_tolerance() -> f64 {
    0.05
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
