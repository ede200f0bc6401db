//! Descriptions of rolling bearings: by their geometry, or by their fault orders.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::error::{AssetError, field};
use super::integer_pair;
use super::other_mesh::{is_ratio, turns};
use crate::signal::{Bearing, BearingLine, BearingOrders, is_name};

/// Maximum number of bearings of an asset: each adds eight indicators to every record.
const MAX_BEARINGS: usize = 6;

/// Maximum number of rolling elements.
const MAX_ELEMENTS: u32 = 1000;

/// Maximum diameter in mm.
const MAX_DIAMETER_MM: f64 = 1e5;

/// Maximum fault order.
const MAX_ORDER: f64 = 1000.0;

/// A rolling bearing within range of the sensor, with a stationary outer race: its geometry or its fault
/// orders.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BearingSpec {
    /// Its name in indicators: 1 to 32 characters of `a-z`, `0-9` and `_`.
    #[schema(example = "drive_end")]
    pub name: String,
    /// Number of rolling elements.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = 9)]
    pub rolling_elements: Option<u32>,
    /// Diameter of a rolling element in mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = 7.94)]
    pub roller_diameter_mm: Option<f64>,
    /// Diameter of the circle through the centres of the rolling elements in mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = 39.04)]
    pub pitch_diameter_mm: Option<f64>,
    /// Contact angle in degrees; by default 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contact_angle_deg: Option<f64>,
    /// The four fault frequencies relative to the rotational frequency of its shaft, instead of the geometry.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub orders: Option<BearingOrders>,
    /// Turns of its shaft relative to turns of the reference shaft of the records; as `gear.shaft_ratio`.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "integer_pair::bearing_shaft_ratio"
    )]
    #[schema(example = json!([24, 36]))]
    pub shaft_ratio: Option<[u32; 2]>,
}

impl BearingSpec {
    /// Converts the bearing to the shaft that makes `driving_turns` turns for each turn of the reference
    /// shaft.
    pub(super) fn seen_from(&self, driving_turns: f64) -> Option<Bearing> {
        Some(Bearing {
            name: self.name.clone(),
            shaft_turns: turns(self.shaft_ratio) / driving_turns,
            orders: self.fault_orders()?,
        })
    }

    /// Its fault orders, given or derived from its geometry.
    fn fault_orders(&self) -> Option<BearingOrders> {
        self.orders.or_else(|| {
            let ratio = self.roller_diameter_mm? / self.pitch_diameter_mm?;
            let angle_deg = self.contact_angle_deg.unwrap_or(0.0);
            Some(BearingOrders::of_geometry(self.rolling_elements?, ratio, angle_deg))
        })
    }

    fn validate(&self) -> Result<(), AssetError> {
        if !is_name(&self.name) {
            let expected = "1 to 32 characters of a-z, 0-9 and _";
            return Err(field("bearings.name", format!("{:?}", self.name), expected));
        }
        if !is_ratio(self.shaft_ratio) {
            let value = format!("{:?}", self.shaft_ratio.unwrap_or_default());
            return Err(field("bearings.shaft_ratio", value, "two numbers from 1 to 1000000"));
        }
        let has_geometry = self.rolling_elements.is_some()
            || self.roller_diameter_mm.is_some()
            || self.pitch_diameter_mm.is_some()
            || self.contact_angle_deg.is_some();
        match &self.orders {
            Some(_) if has_geometry => Err(self.error_in_bearing(
                "bearings.orders",
                "given",
                "either orders or the geometry, not both",
            )),
            Some(orders) => check_orders(orders),
            None => self.check_geometry(),
        }
    }

    fn check_geometry(&self) -> Result<(), AssetError> {
        let missing = |name: &'static str| self.error_in_bearing(name, "missing", "the geometry, or orders");
        let elements = self.rolling_elements.ok_or_else(|| missing("bearings.rolling_elements"))?;
        let roller_mm = self.roller_diameter_mm.ok_or_else(|| missing("bearings.roller_diameter_mm"))?;
        let pitch_mm = self.pitch_diameter_mm.ok_or_else(|| missing("bearings.pitch_diameter_mm"))?;
        if !(3..=MAX_ELEMENTS).contains(&elements) {
            return Err(field("bearings.rolling_elements", elements, "a number from 3 to 1000"));
        }
        if !(pitch_mm > 0.0 && pitch_mm <= MAX_DIAMETER_MM) {
            let expected = "a diameter above 0 and at most 100000";
            return Err(field("bearings.pitch_diameter_mm", pitch_mm, expected));
        }
        if !(roller_mm > 0.0 && roller_mm < pitch_mm) {
            let expected = format!("a diameter above 0 and below the pitch diameter, {pitch_mm}");
            return Err(field("bearings.roller_diameter_mm", roller_mm, expected));
        }
        match self.contact_angle_deg {
            Some(angle_deg) if !(0.0..90.0).contains(&angle_deg) => {
                Err(field("bearings.contact_angle_deg", angle_deg, "an angle from 0 to below 90"))
            }
            _ => Ok(()),
        }
    }

    /// An error that names the bearing.
    fn error_in_bearing(&self, name: &'static str, value: &str, expected: &str) -> AssetError {
        let value = format!("{value} in {:?}", self.name);
        field(name, value, Cow::<'static, str>::Owned(expected.to_owned()))
    }
}

fn check_orders(orders: &BearingOrders) -> Result<(), AssetError> {
    for line in BearingLine::ALL {
        let name = match line {
            BearingLine::Bpfo => "bearings.orders.bpfo",
            BearingLine::Bpfi => "bearings.orders.bpfi",
            BearingLine::Bsf => "bearings.orders.bsf",
            BearingLine::Ftf => "bearings.orders.ftf",
        };
        let order = orders.of(line);
        if !(order > 0.0 && order <= MAX_ORDER) {
            return Err(field(name, order, "a number above 0 and at most 1000"));
        }
    }
    Ok(())
}

pub(super) fn validate(bearings: &[BearingSpec]) -> Result<(), AssetError> {
    if bearings.len() > MAX_BEARINGS {
        return Err(field("bearings", format!("a list of {}", bearings.len()), "at most 6 bearings"));
    }
    for (index, bearing) in bearings.iter().enumerate() {
        bearing.validate()?;
        if bearings[..index].iter().any(|other| other.name == bearing.name) {
            return Err(field("bearings.name", format!("{:?}", bearing.name), "each name at most once"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::AssetSpec;
    use super::*;

    fn spec(bearings: &str) -> Result<AssetSpec, AssetError> {
        AssetSpec::from_toml(&format!("id = \"fan\"\n[shaft]\nspeed_hz = 30.0\n{bearings}"))
    }

    #[test]
    fn geometry_or_orders_describe_a_bearing() {
        let by_geometry = spec(
            "[[bearings]]\nname = \"de\"\nrolling_elements = 13\nroller_diameter_mm = 3.5\npitch_diameter_mm = 25.6",
        )
        .unwrap();
        let orders = by_geometry.bearings()[0].orders;
        assert!((orders.bpfo - 5.6113).abs() < 1e-4 && (orders.bpfi - 7.3887).abs() < 1e-4, "{orders:?}");
        let by_orders = spec(
            "[[bearings]]\nname = \"de\"\norders = { bpfo = 3.5, bpfi = 5.5, bsf = 2.3, ftf = 0.4 }\nshaft_ratio = [1, 2]",
        )
        .unwrap();
        assert_eq!(by_orders.bearings()[0].shaft_turns, 0.5);
        assert_eq!(by_orders.bearings()[0].orders.bsf, 2.3);
    }

    #[test]
    fn errors_name_their_field() {
        let geometry = "rolling_elements = 9\nroller_diameter_mm = 8\npitch_diameter_mm = 39";
        for (fields, name) in [
            ("name = \"de\"".to_owned(), "bearings.rolling_elements"),
            (format!("name = \"DE\"\n{geometry}"), "bearings.name"),
            (geometry.replace("= 9", "= 2") + "\nname = \"de\"", "bearings.rolling_elements"),
            (geometry.replace("= 8", "= 40") + "\nname = \"de\"", "bearings.roller_diameter_mm"),
            (geometry.replace("= 39", "= -1") + "\nname = \"de\"", "bearings.pitch_diameter_mm"),
            (format!("name = \"de\"\ncontact_angle_deg = 90\n{geometry}"), "bearings.contact_angle_deg"),
            (format!("name = \"de\"\nshaft_ratio = [0, 1]\n{geometry}"), "bearings.shaft_ratio"),
            (
                format!(
                    "name = \"de\"\n{geometry}\norders = {{ bpfo = 3.5, bpfi = 5.5, bsf = 2.3, ftf = 0.4 }}"
                ),
                "bearings.orders",
            ),
            (
                "name = \"de\"\norders = { bpfo = 3.5, bpfi = 0, bsf = 2.3, ftf = 0.4 }".to_owned(),
                "bearings.orders.bpfi",
            ),
            (format!("name = \"de\"\n{geometry}\n[[bearings]]\nname = \"de\"\n{geometry}"), "bearings.name"),
        ] {
            match spec(&format!("[[bearings]]\n{fields}")) {
                Err(AssetError::Field { field, .. }) => assert_eq!(field, name, "{fields}"),
                other => panic!("{fields}: {other:?}"),
            }
        }
    }
}
