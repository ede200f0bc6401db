//! Everything that is kept of one record: indicators of its spectrum and over the shaft's angle, features,
//! and what they rest on.

use serde::{Deserialize, Serialize};

use super::analyzer::{Analysis, Analyzer};
use super::band::Band;
use super::features::PREPROCESSING;
use super::gear_indicators::AngleUsed;
use super::impacts::BearingSettings;
use super::indicators::NotComputed;
use super::record::{Quality, Record};
use super::speed::MeshContext;

/// Identifier of what the indicators over the shaft's angle are made by.
pub const GEAR_PREPROCESSING: &str = "turns-1";

/// Indicators that are those of the converter and not of the machine where samples stand at its limit.
const SPOILT_BY_CLIPPING: [&str; 3] = ["peak", "crest_factor", "kurtosis"];

/// What is wanted of a record.
#[derive(Debug, Clone, Copy)]
pub struct ConditionSettings<'a> {
    /// What is known of the mesh.
    pub mesh: MeshContext,
    /// Bands whose values become indicators.
    pub bands: &'a [Band],
    /// Whether the indicators over the shaft's angle are wanted, where there is a mesh.
    pub gear_indicators: bool,
    /// The bearings that the sensor hears.
    pub bearings: BearingSettings<'a>,
}

/// What a record's indicators and features rest on.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Basis {
    /// Identifier of how they were made; numbers are comparable only where it is the same.
    pub preprocessing: String,
    /// What the acquisition says of the samples.
    pub quality: Quality,
    /// The shaft's angle that the gear indicators were computed over; none where there are none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shaft_angle: Option<AngleUsed>,
}

/// What one record says of the machine.
#[derive(Debug, Clone, PartialEq)]
pub struct Condition {
    /// Indicators, those over the shaft's angle among them, features, speed and mesh lines.
    pub analysis: Analysis,
    /// What they rest on.
    pub basis: Basis,
}

impl Analyzer {
    /// All that is kept of a record, from one transform and one resampling.
    pub fn condition(&mut self, record: &Record, settings: &ConditionSettings<'_>) -> Condition {
        let mesh = &settings.mesh;
        let located = self.locate(record, mesh);
        let mut analysis = self.analyze_located(record, mesh, settings.bands, &located);
        self.insert_impacts(record, &settings.bearings, mesh.tolerance, &mut analysis);
        let gear_indicators = settings.gear_indicators && mesh.teeth > 0;
        let wanted = gear_indicators || located.1.mesh.is_ok();
        let turned = if wanted {
            self.turned_located(record, mesh, &located, analysis.features.fault)
        } else {
            Err(NotComputed::NoSpeed)
        };
        self.insert_tooth_checks(mesh, &turned, &mut analysis.features);
        let mut basis =
            Basis { preprocessing: PREPROCESSING.to_owned(), quality: record.quality(), shaft_angle: None };
        let mut clipped = record.quality().clipped;
        if gear_indicators {
            let gear = self.gear_indicators_turned(mesh, &turned);
            clipped |= gear.indicators.absent.values().any(|reason| *reason == NotComputed::Clipped);
            analysis.indicators.extend(gear.indicators);
            basis.preprocessing = format!("{PREPROCESSING}+{GEAR_PREPROCESSING}");
            basis.shaft_angle = gear.angle;
        }
        if clipped {
            for name in SPOILT_BY_CLIPPING {
                analysis.indicators.values.remove(name);
                analysis.indicators.insert(name, Err(NotComputed::Clipped));
            }
        }
        self.take_back(turned);
        self.give_back(record);
        Condition { analysis, basis }
    }
}
