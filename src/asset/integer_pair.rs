//! Deserialisation of pairs of integers, with errors that name the field.

use serde::de::{Deserialize, Deserializer, Error};

/// Maximum number of list elements shown in an error.
const MAX_SHOWN: usize = 8;

const TEETH: &str = "two tooth counts from 4 to 1000";
const RATIO: &str = "two whole numbers from 1 to 1000000";

/// `gear.teeth`.
pub(super) fn teeth<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[u32; 2], D::Error> {
    pair("gear.teeth", TEETH, &Vec::deserialize(deserializer)?)
}

/// `teeth` of other meshes.
pub(super) fn other_teeth<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[u32; 2], D::Error> {
    pair("gear.other_meshes.teeth", TEETH, &Vec::deserialize(deserializer)?)
}

/// `gear.shaft_ratio`, optional.
pub(super) fn shaft_ratio<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[u32; 2]>, D::Error> {
    ratio("gear.shaft_ratio", deserializer)
}

/// `shaft_ratio` of other meshes, optional.
pub(super) fn other_shaft_ratio<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<[u32; 2]>, D::Error> {
    ratio("gear.other_meshes.shaft_ratio", deserializer)
}

/// `shaft_ratio` of bearings, optional.
pub(super) fn bearing_shaft_ratio<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<[u32; 2]>, D::Error> {
    ratio("bearings.shaft_ratio", deserializer)
}

fn ratio<'de, D: Deserializer<'de>>(field: &str, deserializer: D) -> Result<Option<[u32; 2]>, D::Error> {
    let numbers = Option::<Vec<f64>>::deserialize(deserializer)?;
    numbers.map(|numbers| pair(field, RATIO, &numbers)).transpose()
}

fn pair<E: Error>(field: &str, expected: &str, numbers: &[f64]) -> Result<[u32; 2], E> {
    let whole = |value: &f64| {
        (value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(value)).then_some(*value as u32)
    };
    let wholes: Option<Vec<u32>> = numbers.iter().take(MAX_SHOWN).map(whole).collect();
    match wholes.as_deref() {
        Some([first, second]) if numbers.len() == 2 => Ok([*first, *second]),
        _ => {
            let shown: Vec<String> = numbers.iter().take(MAX_SHOWN).map(f64::to_string).collect();
            let more = if numbers.len() > MAX_SHOWN { ", …" } else { "" };
            Err(E::custom(format!("{field} is [{}{more}], expected {expected}", shown.join(", "))))
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::asset::AssetSpec;

    #[test]
    fn an_error_in_a_pair_names_its_field() {
        let spec = |teeth: &str| {
            AssetSpec::from_toml(&format!("id = \"a\"\n[gear]\nteeth = {teeth}\nshaft_speed_hz = 10.0"))
        };
        assert_eq!(spec("[24, 36]").unwrap().teeth(), Some([24, 36]));
        for (teeth, shown) in [
            ("[24, 26, 27]", "gear.teeth is [24, 26, 27], expected two tooth counts from 4 to 1000"),
            ("[24]", "gear.teeth is [24], expected"),
            ("[24, 26.5]", "gear.teeth is [24, 26.5], expected"),
            ("[24, -1]", "gear.teeth is [24, -1], expected"),
            ("[1, 2, 3, 4, 5, 6, 7, 8, 9]", "gear.teeth is [1, 2, 3, 4, 5, 6, 7, 8, …], expected"),
            ("[24, 26]\nother_meshes = [{ teeth = [19] }]", "gear.other_meshes.teeth is [19], expected"),
            (
                "[24, 26]\nshaft_ratio = [1, 2, 3]",
                "gear.shaft_ratio is [1, 2, 3], expected two whole numbers",
            ),
        ] {
            let error = spec(teeth).unwrap_err().to_string();
            assert!(error.contains(shown), "{teeth}: {error}");
        }
    }
}
