//! Rolling bearings: at which orders of the shaft their faults strike.

use serde::{Deserialize, Serialize};

/// A rolling bearing that the sensor hears.
#[derive(Debug, Clone, PartialEq)]
pub struct Bearing {
    /// Its name: 1 to 32 of `a-z`, `0-9` and `_`.
    pub name: String,
    /// Turns of its shaft while the shaft whose speed is meant makes one.
    pub shaft_turns: f64,
    /// Its fault frequencies over the rotational frequency of its own shaft.
    pub orders: BearingOrders,
}

/// How often a fault strikes while the shaft turns once.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct BearingOrders {
    /// Rolling elements that pass a point of the outer race (BPFO).
    pub bpfo: f64,
    /// Rolling elements that pass a point of the inner race (BPFI).
    pub bpfi: f64,
    /// Turns of a rolling element about itself (BSF).
    pub bsf: f64,
    /// Turns of the cage (FTF).
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
    /// All four.
    pub const ALL: [Self; 4] = [Self::Bpfo, Self::Bpfi, Self::Bsf, Self::Ftf];

    /// Its name in indicators.
    pub fn name(self) -> &'static str {
        match self {
            Self::Bpfo => "bpfo",
            Self::Bpfi => "bpfi",
            Self::Bsf => "bsf",
            Self::Ftf => "ftf",
        }
    }

    /// The part of the bearing that a fault is on.
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
    /// Of a bearing whose inner race turns and whose outer race stands, without slip: number of rolling
    /// elements, their diameter over the pitch diameter, and the contact angle.
    pub fn of_geometry(rolling_elements: u32, diameter_ratio: f64, contact_angle_deg: f64) -> Self {
        let reach = diameter_ratio * contact_angle_deg.to_radians().cos();
        let half = 0.5 * f64::from(rolling_elements);
        Self {
            bpfo: half * (1.0 - reach),
            bpfi: half * (1.0 + reach),
            bsf: 0.5 / diameter_ratio * (1.0 - reach * reach),
            ftf: 0.5 * (1.0 - reach),
        }
    }

    /// One of the four.
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
    /// Its frequencies in orders of the shaft whose speed is meant.
    pub fn seen(&self) -> BearingOrders {
        let BearingOrders { bpfo, bpfi, bsf, ftf } = self.orders;
        let [bpfo, bpfi, bsf, ftf] = [bpfo, bpfi, bsf, ftf].map(|order| self.shaft_turns * order);
        BearingOrders { bpfo, bpfi, bsf, ftf }
    }

    /// One of them.
    pub(super) fn order(&self, line: BearingLine) -> f64 {
        self.seen().of(line)
    }

    /// The names of one line's indicators: its amplitude, and the ratio to the background.
    pub(super) fn indicators(&self, line: BearingLine) -> [String; 2] {
        let name = format!("bearing_{}_{}", self.name, line.name());
        let ratio = format!("{name}{TO_BACKGROUND}");
        [name, ratio]
    }

    /// The names of all its indicators.
    pub(super) fn all_indicators(&self) -> impl Iterator<Item = String> {
        BearingLine::ALL.into_iter().flat_map(|line| self.indicators(line))
    }

    /// The name of the indicator that says how far a line stands out.
    pub fn ratio_indicator(&self, line: BearingLine) -> String {
        let [_, ratio] = self.indicators(line);
        ratio
    }
}

/// What the names of ratios to the background end with.
const TO_BACKGROUND: &str = "_to_background";

/// Whether an indicator is the ratio of a bearing's line to the background.
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
