//! The ISO 20816 zones for a machine's root mean square of velocity.

use serde::{Deserialize, Serialize};

use super::error::{AssetError, field};

/// Maximum limit in mm/s.
const MAX_LIMIT_MM_PER_S: f64 = 1e4;

/// The zones of a machine: given by its class, or by the limits themselves.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum VelocityZones {
    /// The class of the machine.
    MachineClass(MachineClass),
    /// The limits between zones A and B, B and C, C and D in mm/s, each above the one before.
    LimitsMmPerS([f64; 3]),
}

/// A machine's class: its group and foundation in ISO 20816-3 (2022), or the class of ISO 10816-1 (1995),
/// Annex B, which ISO 20816-1 replaces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum MachineClass {
    /// Above 300 kW or a shaft height from 315 mm, on a rigid foundation.
    #[serde(rename = "group_1_rigid")]
    Group1Rigid,
    /// The same on a flexible foundation.
    #[serde(rename = "group_1_flexible")]
    Group1Flexible,
    /// Above 15 kW up to 300 kW or a shaft height from 160 mm, on a rigid foundation.
    #[serde(rename = "group_2_rigid")]
    Group2Rigid,
    /// The same on a flexible foundation.
    #[serde(rename = "group_2_flexible")]
    Group2Flexible,
    /// Small machines, motors up to 15 kW.
    #[serde(rename = "class_1")]
    Class1,
    /// Medium machines, motors from 15 to 75 kW.
    #[serde(rename = "class_2")]
    Class2,
    /// Large machines on rigid foundations.
    #[serde(rename = "class_3")]
    Class3,
    /// Large machines on flexible foundations.
    #[serde(rename = "class_4")]
    Class4,
}

/// The zone of a machine's velocity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub enum VelocityZone {
    /// Typical of new machines.
    A,
    /// Acceptable for unrestricted long-term operation.
    B,
    /// Unsatisfactory for long-term operation.
    C,
    /// Severe enough to cause damage.
    D,
}

impl VelocityZones {
    /// The limits between zones A and B, B and C, C and D in mm/s.
    pub fn limits_mm_per_s(self) -> [f64; 3] {
        match self {
            Self::LimitsMmPerS(limits) => limits,
            Self::MachineClass(class) => match class {
                MachineClass::Group1Rigid => [2.3, 4.5, 7.1],
                MachineClass::Group1Flexible => [3.5, 7.1, 11.0],
                MachineClass::Group2Rigid => [1.4, 2.8, 4.5],
                MachineClass::Group2Flexible => [2.3, 4.5, 7.1],
                MachineClass::Class1 => [0.71, 1.8, 4.5],
                MachineClass::Class2 => [1.12, 2.8, 7.1],
                MachineClass::Class3 => [1.8, 4.5, 11.2],
                MachineClass::Class4 => [2.8, 7.1, 18.0],
            },
        }
    }

    /// The zone of a velocity in mm/s; a limit belongs to the lower zone.
    pub fn zone(self, velocity_mm_per_s: f64) -> VelocityZone {
        let [a, b, c] = self.limits_mm_per_s();
        match velocity_mm_per_s {
            velocity if velocity <= a => VelocityZone::A,
            velocity if velocity <= b => VelocityZone::B,
            velocity if velocity <= c => VelocityZone::C,
            _ => VelocityZone::D,
        }
    }

    pub(super) fn validate(self) -> Result<(), AssetError> {
        let limits = self.limits_mm_per_s();
        let [a, b, c] = limits;
        if 0.0 < a && a < b && b < c && c <= MAX_LIMIT_MM_PER_S {
            return Ok(());
        }
        let expected = "three velocities above 0 and at most 10000, each above the one before";
        Err(field("velocity_zones.limits_mm_per_s", format!("{limits:?}"), expected))
    }
}

#[cfg(test)]
mod tests {
    use super::super::AssetSpec;
    use super::*;

    fn zones(text: &str) -> Result<VelocityZones, AssetError> {
        let spec = AssetSpec::from_toml(&format!("id = \"fan\"\nvelocity_zones = {text}\n[shaft]"))?;
        Ok(spec.velocity_zones.unwrap())
    }

    #[test]
    fn a_velocity_lies_in_the_zone_of_the_class_or_of_the_limits() {
        let class = zones("{ machine_class = \"group_2_rigid\" }").unwrap();
        let found = [0.5, 1.4, 1.5, 2.8, 4.5, 4.6].map(|velocity| class.zone(velocity));
        use VelocityZone::{A, B, C, D};
        assert_eq!(found, [A, A, B, B, C, D]);
        assert_eq!(zones("{ limits_mm_per_s = [1, 2, 3] }").unwrap().zone(2.5), C);
    }

    #[test]
    fn invalid_limits_are_refused() {
        for limits in ["[0, 1, 2]", "[1, 1, 2]", "[1, 2, nan]", "[1, 2, 1e9]"] {
            let error = zones(&format!("{{ limits_mm_per_s = {limits} }}")).unwrap_err().to_string();
            assert!(error.starts_with("velocity_zones.limits_mm_per_s is ["), "{error}");
        }
        assert!(zones("{ machine_class = \"group_9\" }").unwrap_err().to_string().contains("group_2_rigid"));
    }
}
