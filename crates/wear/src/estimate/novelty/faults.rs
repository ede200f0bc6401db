//! Faults of the sensor, and suspected faults of the machine other than wear.

use flankwatch_signal::NotComputed;
use serde::{Deserialize, Serialize};

/// Prefix of the tooth checks' names.
pub(in crate::estimate) const TEETH: &str = "ln_tooth_";

/// A fault of the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum SensorFault {
    /// The sensor gives no vibration signal.
    Dead,
    /// The signal is clipped at the converter's limit.
    Clipped,
    /// Stretches of the record are missing.
    Gaps,
    /// From one record to the next, all lines and the noise changed by the same lasting factor, and the
    /// kurtosis did not: the sensitivity or gain has changed.
    GainChanged,
    /// High frequencies are lost and low ones are not: the sensor is loose.
    LooseMount,
}

impl SensorFault {
    /// Returns the fault that the samples themselves show, if they show one.
    pub(in crate::estimate) fn of_samples(fault: NotComputed) -> Option<Self> {
        match fault {
            NotComputed::Constant => Some(Self::Dead),
            NotComputed::Clipped => Some(Self::Clipped),
            NotComputed::Gaps => Some(Self::Gaps),
            _ => None,
        }
    }

    /// Returns the fault in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Dead => "the sensor gives no signal",
            Self::Clipped => "the signal is clipped",
            Self::Gaps => "samples are missing",
            Self::GainChanged => {
                "all lines and the noise changed by the same factor at once: the sensor's gain has changed"
            }
            Self::LooseMount => "high frequencies are lost: the sensor's mount is loose",
        }
    }
}

/// A fault of the machine other than wear that a record suggests, where the sensor is not the cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum SuspectedFault {
    /// One tooth of the shaft's gear has more energy between the mesh harmonics than the others.
    OneTooth,
    /// The lines at multiples of the shaft rate have grown.
    ShaftLines,
    /// Energy that belongs to no mesh harmonic has grown, and the record is more impulsive than healthy.
    ImpulsiveEnergy,
    /// Energy that belongs to no mesh harmonic has grown, and the record is no more impulsive than healthy.
    BandEnergy,
}

impl SuspectedFault {
    /// Returns the fault in words for a machine without a gear mesh.
    pub fn words_without_mesh(self) -> &'static str {
        match self {
            Self::OneTooth | Self::ShaftLines => {
                "the shaft's own lines have grown: misalignment or unbalance"
            }
            Self::ImpulsiveEnergy => "impulses have grown: a bearing fault or looseness",
            Self::BandEnergy => "energy has grown: a bearing fault, looseness or another machine",
        }
    }

    /// Returns the fault in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::OneTooth => "one tooth differs from the others: a crack or chip, not wear",
            Self::ShaftLines => "the shaft's own lines have grown: misalignment or unbalance, not wear",
            Self::ImpulsiveEnergy => {
                "impulses between the mesh lines have grown: a bearing fault or looseness, not wear"
            }
            Self::BandEnergy => {
                "energy between the mesh lines has grown: a bearing fault, looseness or another machine, not wear"
            }
        }
    }

    /// Returns the possible cause in a few words.
    pub fn short(self) -> &'static str {
        match self {
            Self::OneTooth => "a crack or chip of one tooth",
            Self::ShaftLines => "misalignment or unbalance",
            Self::ImpulsiveEnergy => "a bearing fault or looseness",
            Self::BandEnergy => "a bearing fault, looseness or another machine",
        }
    }

    /// Returns the fault that a check indicates if it has grown.
    pub(super) fn of(check: &str, impulsive: bool) -> Option<Self> {
        let energy = if impulsive { Self::ImpulsiveEnergy } else { Self::BandEnergy };
        let faults = [
            (TEETH, Self::OneTooth),
            ("ln_shaft_", Self::ShaftLines),
            ("ln_rest_", energy),
            ("ln_band_", energy),
            ("ln_floor_", energy),
        ];
        faults.into_iter().find_map(|(kind, fault)| check.starts_with(kind).then_some(fault))
    }
}
