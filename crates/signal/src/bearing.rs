//! The fault frequencies of rolling bearings, in orders of the shaft.

use serde::{Deserialize, Serialize};

/// A rolling bearing that the sensor measures.
#[derive(Debug, Clone, PartialEq)]
pub struct Bearing {
    /// Name: 1 to 32 characters of `a-z`, `0-9` and `_`.
    pub name: String,
    /// Turns of its own shaft per turn of the reference shaft, whose speed is given.
    pub shaft_turns: f64,
    /// Fault frequencies relative to the rotational frequency of its own shaft.
    pub orders: BearingOrders,
}

/// Fault frequencies of a rolling bearing as events per turn of its shaft.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct BearingOrders {
    /// Ball-pass frequency of the outer race (BPFO): rolling elements passing a point of it.
    pub bpfo: f64,
    /// Ball-pass frequency of the inner race (BPFI): rolling elements passing a point of it.
    pub bpfi: f64,
    /// Ball-spin frequency (BSF): turns of a rolling element about its own axis.
    pub bsf: f64,
    /// Fundamental train frequency (FTF): turns of the cage.
    pub ftf: f64,
}

/// One of a bearing's four fault frequencies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum BearingLine {
    /// The outer race.
    Bpfo,
    /// The inner race.
    Bpfi,
    /// A rolling element.
    Bsf,
    /// The cage.
    Ftf,
}

impl BearingLine {
    /// All four fault frequencies.
    pub const ALL: [Self; 4] = [Self::Bpfo, Self::Bpfi, Self::Bsf, Self::Ftf];

    /// Returns its name in indicators.
    pub fn name(self) -> &'static str {
        match self {
            Self::Bpfo => "bpfo",
            Self::Bpfi => "bpfi",
            Self::Bsf => "bsf",
            Self::Ftf => "ftf",
        }
    }

    /// Returns the bearing part that the fault is on.
    pub fn part(self) -> &'static str {
        match self {
            Self::Bpfo => "outer race",
            Self::Bpfi => "inner race",
            Self::Bsf => "rolling elements",
            Self::Ftf => "cage",
        }
    }
}

impl BearingOrders {
    /// Computes the orders of a bearing with rotating inner race and fixed outer race, without slip, from the
    /// number of rolling elements, the ratio of their diameter to the pitch diameter, and the contact angle.
    pub fn of_geometry(rolling_elements: u32, diameter_ratio: f64, contact_angle_deg: f64) -> Self {
        let projected = diameter_ratio * contact_angle_deg.to_radians().cos();
        let half = 0.5 * f64::from(rolling_elements);
        Self {
            bpfo: half * (1.0 - projected),
            bpfi: half * (1.0 + projected),
            bsf: 0.5 / diameter_ratio * (1.0 - projected * projected),
            ftf: 0.5 * (1.0 - projected),
        }
    }

    /// Returns one of the four orders.
    pub fn of(&self, line: BearingLine) -> f64 {
        match line {
            BearingLine::Bpfo => self.bpfo,
            BearingLine::Bpfi => self.bpfi,
            BearingLine::Bsf => self.bsf,
            BearingLine::Ftf => self.ftf,
        }
    }
}

impl Bearing {
    /// Returns the fault frequencies in orders of the reference shaft.
    pub fn reference_orders(&self) -> BearingOrders {
        let BearingOrders { bpfo, bpfi, bsf, ftf } = self.orders;
        let [bpfo, bpfi, bsf, ftf] = [bpfo, bpfi, bsf, ftf].map(|order| self.shaft_turns * order);
        BearingOrders { bpfo, bpfi, bsf, ftf }
    }

    /// Returns one fault frequency in orders of the reference shaft.
    pub(super) fn order(&self, line: BearingLine) -> f64 {
        self.reference_orders().of(line)
    }

    /// Returns the indicator names of one line: its amplitude, and its ratio to the background.
    pub(super) fn indicators(&self, line: BearingLine) -> [String; 2] {
        let name = format!("bearing_{}_{}", self.name, line.name());
        let ratio = format!("{name}{TO_BACKGROUND}");
        [name, ratio]
    }

    /// Returns the names of all indicators of the bearing.
    pub(super) fn all_indicators(&self) -> impl Iterator<Item = String> {
        BearingLine::ALL.into_iter().flat_map(|line| self.indicators(line))
    }

    /// Returns the name of the indicator for the ratio of a line to the background.
    pub fn ratio_indicator(&self, line: BearingLine) -> String {
        let [_, ratio] = self.indicators(line);
        ratio
    }
}

/// Suffix of the names of ratios to the background.
const TO_BACKGROUND: &str = "_to_background";

/// Returns whether an indicator is the ratio of a bearing's line to the background.
pub(super) fn is_ratio(indicator: &str) -> bool {
    indicator.starts_with("bearing_") && indicator.ends_with(TO_BACKGROUND)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// SKF 6205 at the drive end of the Case Western Reserve test rig: 9 balls of 0.3126 in on 1.537 in; the
    /// orders are those the Bearing Data Center publishes (its rolling element strikes both races, so that
    /// its order is twice that of the spin).
    #[test]
    fn geometry_gives_the_published_orders() {
        let orders = BearingOrders::of_geometry(9, 0.3126 / 1.537, 0.0);
        for (got, want) in
            [(orders.bpfi, 5.4152), (orders.bpfo, 3.5848), (orders.ftf, 0.39828), (2.0 * orders.bsf, 4.7135)]
        {
            assert!((got - want).abs() < 5e-4, "{got} {want}");
        }
    }
}
