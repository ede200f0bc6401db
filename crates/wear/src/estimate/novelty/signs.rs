//! What is not wear, by name.

use serde::{Deserialize, Serialize};

/// What the checks of the teeth begin with.
pub(super) const TEETH: &str = "ln_tooth_";

/// What is wrong with the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum SensorFault {
    /// No vibration comes through.
    Dead,
    /// The signal is cut off at the converter's limit.
    Clipped,
    /// Stretches of the record are missing.
    Gaps,
    /// From one record to the next, all lines and all noise have moved by one factor that stays, and the
    /// kurtosis has not: sensitivity or gain has changed.
    GainChanged,
    /// High frequencies are lost, low ones are not: the sensor is loose.
    LooseMount,
}

impl SensorFault {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Dead => "the sensor gives no signal",
            Self::Clipped => "the signal is clipped",
            Self::Gaps => "samples are missing",
            Self::GainChanged => {
                "all lines and all noise moved by one factor at once: the sensor's gain has changed"
            }
            Self::LooseMount => "high frequencies are lost: the sensor's mount is loose",
        }
    }
}

/// What a record that wear does not explain looks like, where the sensor is not the reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum MachineSign {
    /// One tooth of the shaft has more between the mesh harmonics than the others.
    OneTooth,
    /// The shaft's own lines have grown.
    ShaftLines,
    /// Energy that belongs to no mesh harmonic has grown, and the record is more impulsive than the healthy
    /// ones.
    ImpulsiveEnergy,
    /// Energy that belongs to no mesh harmonic has grown, and the record is no more impulsive.
    BandEnergy,
}

impl MachineSign {
    /// In words, of a machine without a gear mesh.
    pub fn words_without_mesh(self) -> &'static str {
        match self {
            Self::OneTooth | Self::ShaftLines => {
                "the shaft's own lines have grown: misalignment or unbalance"
            }
            Self::ImpulsiveEnergy => "impulses have grown: a bearing or looseness",
            Self::BandEnergy => "energy has grown: a bearing, looseness or another machine",
        }
    }

    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::OneTooth => "one tooth differs from the others: a crack or chip, not wear",
            Self::ShaftLines => "the shaft's own lines have grown: misalignment or unbalance, not wear",
            Self::ImpulsiveEnergy => {
                "impulses beside the mesh lines have grown: a bearing or looseness, not wear"
            }
            Self::BandEnergy => {
                "energy beside the mesh lines has grown: a bearing, looseness or another machine, not wear"
            }
        }
    }

    /// In few words.
    pub fn short(self) -> &'static str {
        match self {
            Self::OneTooth => "one tooth that differs",
            Self::ShaftLines => "misalignment or unbalance",
            Self::ImpulsiveEnergy => "a bearing or looseness",
            Self::BandEnergy => "a bearing, looseness or another machine",
        }
    }

    /// What a check that has grown is a sign of.
    pub(super) fn of(check: &str, impulsive: bool) -> Option<Self> {
        let energy = if impulsive { Self::ImpulsiveEnergy } else { Self::BandEnergy };
        let signs = [
            (TEETH, Self::OneTooth),
            ("ln_shaft_", Self::ShaftLines),
            ("ln_rest_", energy),
            ("ln_band_", energy),
            ("ln_floor_", energy),
        ];
        signs.into_iter().find_map(|(kind, sign)| check.starts_with(kind).then_some(sign))
    }
}
