//! The stored result of one record: indicators of its spectrum and over the shaft angle, features, and how
//! they were computed.

use serde::{Deserialize, Serialize};

use super::analyzer::{Analysis, Analyzer};
use super::band::Band;
use super::by_name::Name;
use super::features::PREPROCESSING;
use super::gear_indicators::AngleUsed;
use super::impacts::BearingSettings;
use super::mesh_context::MeshContext;
use super::not_computed::NotComputed;
use super::record::{Quality, RecordOf};

/// Identifier of the method behind the indicators over the shaft angle.
pub const GEAR_PREPROCESSING: &str = "turns-4";

/// Identifiers of the methods behind features and indicators over the shaft angle.
const BOTH_PREPROCESSING: &str = "speed-compensated-lines-2+turns-4";

/// Indicators that a clipped record does not provide: there they describe the converter, not the machine.
const INVALID_WHEN_CLIPPED: [&str; 3] = ["peak", "crest_factor", "kurtosis"];

/// Settings of [`Analyzer::condition`].
#[derive(Debug, Clone, Copy)]
pub struct ConditionSettings<'a> {
    /// What is known of the mesh.
    pub mesh: MeshContext,
    /// Bands whose values become indicators.
    pub bands: &'a [Band],
    /// Whether to compute the indicators over the shaft angle, if there is a mesh.
    pub gear_indicators: bool,
    /// The bearings that the sensor measures.
    pub bearings: BearingSettings<'a>,
}

/// How a record's indicators and features were computed.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Basis {
    /// Identifier of the method; only numbers with the same identifier are comparable.
    #[cfg_attr(feature = "openapi", schema(value_type = String))]
    pub preprocessing: Name,
    /// Quality flags set by the acquisition.
    pub quality: Quality,
    /// The shaft angle that the gear indicators were computed over, if there are any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shaft_angle: Option<AngleUsed>,
}

/// The condition of the machine according to one record.
#[derive(Debug, Clone, PartialEq)]
pub struct Condition {
    /// Indicators (including those over the shaft angle), features, speed and mesh lines.
    pub analysis: Analysis,
    /// How they were computed.
    pub basis: Basis,
}

impl Analyzer {
    /// Computes everything that is stored of a record, from one transform and one resampling.
    pub fn condition(&mut self, record: &RecordOf<'_>, settings: &ConditionSettings<'_>) -> Condition {
        let mesh = &settings.mesh;
        let located = self.locate(record, mesh);
        let mut analysis = self.analyze_located(record, mesh, settings.bands, &located);
        self.insert_impacts(record, &settings.bearings, mesh.tolerance, &mut analysis);
        let gear_indicators = settings.gear_indicators && mesh.teeth > 0;
        let needs_angle = gear_indicators || located.1.mesh.is_ok();
        let angle_record = if needs_angle {
            self.angle_record_located(record, mesh, &located, analysis.features.fault)
        } else {
            Err(NotComputed::NoSpeed)
        };
        self.insert_tooth_checks(mesh, &angle_record, &mut analysis.features);
        let mut basis = Basis {
            preprocessing: Name::new_static(PREPROCESSING),
            quality: record.quality(),
            shaft_angle: None,
        };
        if gear_indicators {
            basis.preprocessing = Name::new_static(BOTH_PREPROCESSING);
            basis.shaft_angle = self.insert_gear_indicators(mesh, &angle_record, &mut analysis.indicators);
        }
        if record.quality().clipped || analysis.features.fault == Some(NotComputed::Clipped) {
            for name in INVALID_WHEN_CLIPPED {
                analysis.indicators.values.remove(name);
                analysis.indicators.insert(name, Err(NotComputed::Clipped));
            }
        }
        self.recycle(angle_record);
        self.release_large_buffers(record);
        Condition { analysis, basis }
    }
}

#[cfg(test)]
mod tests {
    use jiff::Timestamp;

    use super::super::{AnalysisSettings, Record};
    use super::*;

    #[test]
    fn a_clipped_record_has_no_peak_whatever_else_is_computed() {
        let samples = |limit: f32| (0..8000).map(|n| (0.7 * n as f32).sin().clamp(-limit, limit)).collect();
        for mesh in [MeshContext::unknown(), MeshContext::at_exact_speed([20, 0], 10.0)] {
            for gear_indicators in [false, true] {
                let settings = ConditionSettings {
                    mesh,
                    bands: &[],
                    gear_indicators,
                    bearings: BearingSettings::default(),
                };
                let condition = |limit: f32| {
                    let record =
                        Record::new("1", Timestamp::UNIX_EPOCH, 8000.0, "g", samples(limit)).unwrap();
                    Analyzer::new(AnalysisSettings::default())
                        .condition(&record, &settings)
                        .analysis
                        .indicators
                };
                let (whole, clipped) = (condition(1.0), condition(0.6));
                for name in INVALID_WHEN_CLIPPED {
                    assert!(whole.get(name).is_some(), "{name}");
                    assert_eq!(clipped.get(name), None, "{name}");
                    assert_eq!(clipped.absent[name], NotComputed::Clipped, "{name}");
                }
                assert!(clipped.get("rms").is_some());
            }
        }
    }

    #[test]
    fn one_text_has_both_methods() {
        assert_eq!(BOTH_PREPROCESSING, format!("{PREPROCESSING}+{GEAR_PREPROCESSING}"));
    }
}
