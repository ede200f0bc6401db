//! Gearboxes with several meshes: how each mesh appears to a sensor within range of all of them.

use serde::{Deserialize, Serialize};

use super::error::{AssetError, field};
use super::gear_spec::GearSpec;
use super::integer_pair;
use super::spec::AssetSpec;
use crate::signal::{OtherMesh, OtherMeshes};

/// Maximum number of other meshes in a description.
const MAX_OTHERS: usize = 7;

/// Maximum number of meshes monitored with one sensor.
pub const MAX_ON_ONE_SENSOR: usize = 8;

/// Maximum product of tooth counts from one shaft to another.
const MAX_TEETH: u32 = 1_000_000;

/// Another mesh within range of the sensor that no asset monitors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct OtherMeshSpec {
    /// Tooth counts of its driving and its driven gear.
    #[schema(example = json!([19, 57]))]
    #[serde(deserialize_with = "integer_pair::other_teeth")]
    pub teeth: [u32; 2],
    /// Turns of its driving shaft relative to turns of the reference shaft of the records; as
    /// `gear.shaft_ratio`.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "integer_pair::other_shaft_ratio"
    )]
    #[schema(example = json!([24, 36]))]
    pub shaft_ratio: Option<[u32; 2]>,
}

impl OtherMeshSpec {
    /// The mesh of an asset as another mesh of the same sensor.
    pub fn of(gear: &GearSpec) -> Self {
        Self { teeth: gear.teeth, shaft_ratio: gear.shaft_ratio }
    }

    /// Its orders relative to the driving shaft of `own`.
    fn seen_from(self, own: &GearSpec) -> OtherMesh {
        let [driving, driven] = self.teeth.map(f64::from);
        let turns = turns(self.shaft_ratio) / own.driving_shaft_turns();
        OtherMesh { mesh_orders: driving * turns, shaft_orders: [turns, turns * driving / driven] }
    }

    /// Formats it as in a description.
    fn words(self) -> String {
        let ratio = self.shaft_ratio.map_or_else(String::new, |ratio| format!(", shaft_ratio = {ratio:?}"));
        format!("teeth = {:?}{ratio}", self.teeth)
    }

    fn is_usable(self) -> bool {
        self.teeth.iter().all(|teeth| (4..=1000).contains(teeth)) && is_ratio(self.shaft_ratio)
    }
}

impl GearSpec {
    /// Turns of the driving shaft for each turn of the reference shaft of the records.
    pub fn driving_shaft_turns(&self) -> f64 {
        turns(self.shaft_ratio)
    }

    /// The other meshes within range of the sensor.
    pub(super) fn others(&self) -> OtherMeshes {
        OtherMeshes::of(self.other_meshes.iter().map(|mesh| mesh.seen_from(self)))
    }
}

impl AssetSpec {
    /// Adds the meshes of all other assets of the same sensor to the description; `all` may include this one.
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
            "two numbers from 1 to 1000000: the products of the driving and of the driven tooth counts",
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
            "two tooth counts from 4 to 1000 each, and shaft_ratio of two numbers from 1 to 1000000",
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
    fn meshes_of_one_sensor_include_each_other() {
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
    fn errors_name_their_field() {
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
