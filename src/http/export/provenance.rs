//! Provenance of exported records: metadata and the library's manifest.

use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::{Value, json};

use crate::asset::{AssetSpec, Segment};

/// A metadata record: its name and its entries.
pub(crate) type Entries = (&'static str, BTreeMap<String, String>);

/// `asset`, a `sensor` for each measuring point (one for the asset's own sensor if it has none), `gear_pair`
/// or `shaft`, a `bearing` for each bearing, and an `acquisition` for the latest record of each channel.
pub(crate) fn metadata(spec: &AssetSpec, latest: &[Segment]) -> Vec<Entries> {
    let mut all = vec![(
        "asset",
        flat(&json!({ "id": spec.id.to_string(), "name": spec.name, "location": spec.location })),
    )];
    if spec.points.is_empty() {
        all.push(("sensor", flat(&spec.sensor)));
    }
    all.extend(spec.points.iter().map(|point| ("sensor", flat(point))));
    all.push(("gear_pair", flat(&spec.gear)));
    all.push(("shaft", flat(&spec.shaft)));
    all.extend(spec.bearings.iter().map(|bearing| ("bearing", flat(bearing))));
    all.extend(latest.iter().map(|segment| {
        let acquisition = json!({
            "channel": segment.channel,
            "unit": segment.unit,
            "sample_rate_hz": segment.sample_rate_hz,
            "samples": segment.samples,
            "latest_start_time": segment.start_time,
            "media_type": segment.raw.media_type,
        });
        ("acquisition", flat(&acquisition))
    }));
    all.retain(|(_, entries)| !entries.is_empty());
    all
}

/// Flattens a structure to dotted names; lists are written as JSON.
fn flat(value: &impl Serialize) -> BTreeMap<String, String> {
    fn add(name: &str, value: &Value, entries: &mut BTreeMap<String, String>) {
        match value {
            Value::Null => {}
            Value::Object(members) => {
                for (member, value) in members {
                    let name = if name.is_empty() { member.clone() } else { format!("{name}.{member}") };
                    add(&name, value, entries);
                }
            }
            Value::String(text) => {
                entries.insert(name.to_owned(), text.clone());
            }
            value => {
                entries.insert(name.to_owned(), value.to_string());
            }
        }
    }
    let mut entries = BTreeMap::new();
    // A structure of strings, numbers and maps always serialises
    add("", &serde_json::to_value(value).unwrap_or_default(), &mut entries);
    entries
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_measuring_point_is_a_sensor() {
        let spec = AssetSpec::from_toml(
            "id = \"a\"\nlocation = { site = \"mill\" }
             points = [{ channel = \"in\", unit = \"g\", serial = \"7\", calibrated_on = \"2026-01-31\" }, { channel = \"out\" }]
             [gear]\nteeth = [24, 36]\nshaft_speed_hz = 16.6",
        )
        .unwrap();
        let all = metadata(&spec, &[]);
        let names: Vec<&str> = all.iter().map(|(name, _)| *name).collect();
        assert_eq!(names, ["asset", "sensor", "sensor", "gear_pair"]);
        let entry = |record: usize, name: &str| all[record].1.get(name).map(String::as_str);
        assert_eq!(entry(0, "location.site"), Some("mill"));
        assert_eq!((entry(1, "serial"), entry(1, "calibrated_on")), (Some("7"), Some("2026-01-31")));
        assert_eq!((entry(2, "channel"), entry(2, "unit")), (Some("out"), None));
        assert_eq!((entry(3, "teeth"), entry(3, "shaft_speed_hz")), (Some("[24,36]"), Some("16.6")));
    }
}
