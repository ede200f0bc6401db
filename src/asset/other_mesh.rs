//! Gearboxes of several meshes: what each of them is to a sensor that hears them all.

use serde::{Deserialize, Serialize};

use super::error::{AssetError, field};
use super::gear_spec::GearSpec;
use super::pair_of_numbers;
use super::spec::AssetSpec;
use crate::signal::{OtherMesh, OtherMeshes};

/// The most other meshes in a description.
const MAX_OTHERS: usize = 7;

/// The most meshes that are monitored through one sensor.
pub const MAX_ON_ONE_SENSOR: usize = 8;

/// The greatest number of teeth, multiplied along the way from one shaft to the other.
const MAX_TEETH: u32 = 1_000_000;

/// Another mesh that the sensor hears and no asset watches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct OtherMeshSpec {
    /// Tooth numbers of its driving and its driven gear.
    #[schema(example = json!([19, 57]))]
    #[serde(deserialize_with = "pair_of_numbers::other_teeth")]
    pub teeth: [u32; 2],
    /// Turns of its driving shaft against turns of the shaft that speed, torque and tachometer of the records
    /// are of; as for the monitored mesh.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "pair_of_numbers::other_shaft_ratio"
    )]
    #[schema(example = json!([24, 36]))]
    pub shaft_ratio: Option<[u32; 2]>,
}

impl OtherMeshSpec {
    /// The mesh of an asset as another asset of the same sensor hears it.
    pub fn of(gear: &GearSpec) -> Self {
        Self { teeth: gear.teeth, shaft_ratio: gear.shaft_ratio }
    }

    /// In orders of the driving shaft of `own`.
    fn seen_from(self, own: &GearSpec) -> OtherMesh {
        let [driving, driven] = self.teeth.map(f64::from);
        let turns = turns(self.shaft_ratio) / own.driving_shaft_turns();
        OtherMesh { mesh_orders: driving * turns, shaft_orders: [turns, turns * driving / driven] }
    }

    /// As it is written in a description.
    fn words(self) -> String {
        let ratio = self.shaft_ratio.map_or_else(String::new, |ratio| format!(", shaft_ratio = {ratio:?}"));
        format!("teeth = {:?}{ratio}", self.teeth)
    }

    fn is_usable(self) -> bool {
        self.teeth.iter().all(|teeth| (4..=1000).contains(teeth)) && is_ratio(self.shaft_ratio)
    }
}

impl GearSpec {
    /// Turns of the driving shaft while the shaft that speed, torque and tachometer of the records are of
    /// makes one.
    pub fn driving_shaft_turns(&self) -> f64 {
        turns(self.shaft_ratio)
    }

    /// What the sensor hears besides this mesh.
    pub(super) fn others(&self) -> OtherMeshes {
        OtherMeshes::of(self.other_meshes.iter().map(|mesh| mesh.seen_from(self)))
    }
}

impl AssetSpec {
    /// The description with the meshes of all assets of the same sensor known to it; `all` may hold this one.
    pub fn among(mut self, all: &[AssetSpec]) -> Self {
        let Some(own) = &mut self.gear else { return self };
        for gear in all.iter().filter(|asset| asset.id != self.id).filter_map(|asset| asset.gear.as_ref()) {
            let mesh = OtherMeshSpec::of(gear);
            if !own.other_meshes.contains(&mesh) {
                own.other_meshes.push(mesh);
            }
        }
        self
    }
}

pub(super) fn turns(ratio: Option<[u32; 2]>) -> f64 {
    ratio.map_or(1.0, |[turns, of]| f64::from(turns) / f64::from(of))
}

pub(super) fn is_ratio(ratio: Option<[u32; 2]>) -> bool {
    ratio.is_none_or(|numbers| numbers.iter().all(|number| (1..=MAX_TEETH).contains(number)))
}

pub(super) fn validate(spec: &AssetSpec) -> Result<(), AssetError> {
    if spec.sensor.of.as_ref() == Some(&spec.id) {
        return Err(field("sensor.of", &spec.id, "the id of another asset"));
    }
    let Some(gear) = &spec.gear else { return Ok(()) };
    if !is_ratio(gear.shaft_ratio) {
        return Err(field(
            "gear.shaft_ratio",
            format!("{:?}", gear.shaft_ratio.unwrap_or_default()),
            "two numbers from 1 to 1000000: the teeth that drive, multiplied along the way, and those that are driven",
        ));
    }
    if gear.other_meshes.len() > MAX_OTHERS {
        return Err(field(
            "gear.other_meshes",
            format!("a list of {}", gear.other_meshes.len()),
            "at most 7 other meshes",
        ));
    }
    if let Some(other) = gear.other_meshes.iter().find(|other| !other.is_usable()) {
        return Err(field(
            "gear.other_meshes",
            other.words(),
            "two tooth numbers from 4 to 1000 each, and shaft_ratio of two numbers from 1 to 1000000",
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec(id: &str, gear: &str) -> Result<AssetSpec, AssetError> {
        AssetSpec::from_toml(&format!("id = \"{id}\"\n[gear]\nshaft_speed_hz = 10.0\n{gear}"))
    }

    fn gear(spec: &AssetSpec) -> &GearSpec {
        spec.gear.as_ref().unwrap()
    }

    #[test]
    fn meshes_of_one_sensor_know_of_each_other() {
        let first = spec("first", "teeth = [24, 36]").unwrap();
        let second = spec("second", "teeth = [19, 57]\nshaft_ratio = [24, 36]").unwrap();
        let all = [first.clone(), second.clone()];
        let heard = OtherMeshSpec::of(gear(&first)).seen_from(gear(&second));
        assert!((heard.mesh_orders - 36.0).abs() < 1e-12 && (heard.shaft_orders[1] - 1.0).abs() < 1e-12);
        let first = first.among(&all);
        assert_eq!(gear(&first).other_meshes, [OtherMeshSpec::of(gear(&second))]);
        assert_eq!(first.clone().among(&all), first);
    }

    #[test]
    fn what_cannot_be_used_names_its_field() {
        for (gear, name) in [
            ("teeth = [24, 36]\nshaft_ratio = [0, 36]", "gear.shaft_ratio"),
            ("teeth = [24, 36]\nother_meshes = [{ teeth = [3, 57] }]", "gear.other_meshes"),
            (
                "teeth = [24, 36]\nother_meshes = [{ teeth = [19, 57], shaft_ratio = [1, 2000000] }]",
                "gear.other_meshes",
            ),
            ("teeth = [24, 36]\n[sensor]\nof = \"a\"", "sensor.of"),
        ] {
            match spec("a", gear) {
                Err(AssetError::Field { field, .. }) => assert_eq!(field, name, "{gear}"),
                other => panic!("{gear}: {other:?}"),
            }
        }
    }
}
