//! What results depend on, as hashes: whatever was computed under another key is computed again.

use std::sync::Arc;

use sha2::{Digest, Sha256};

use crate::asset::AssetSpec;
use crate::estimate::{AlarmRule, EstimatorSettings, LibraryLack, METHOD};
use crate::library::Ensemble;
use crate::signal::{GEAR_PREPROCESSING, INDICATORS, PREPROCESSING};
use crate::store::AnalysisKeys;

/// Identifier of which indicators the fold gives: NA4, NB4 and novelty.
const RUN_INDICATORS: &str = "run-2";

/// Everything but its raw bytes that the analysis of a record of this asset depends on.
pub(crate) fn analysis_keys(spec: &AssetSpec) -> AnalysisKeys {
    let gear = &spec.gear;
    let mut others: Vec<String> =
        gear.other_meshes.iter().map(|mesh| serde_json::to_string(mesh).unwrap_or_default()).collect();
    others.sort_unstable();
    let mut parts = vec![
        PREPROCESSING.to_owned(),
        format!("{:?}", gear.teeth),
        format!("{:?}", gear.shaft_ratio),
        gear.shaft_speed_hz.to_bits().to_string(),
        gear.speed_tolerance.to_bits().to_string(),
        gear.speed_is_exact.to_string(),
    ];
    parts.extend(others);
    let feature = hash(&parts.iter().map(String::as_str).collect::<Vec<_>>());
    let bands = serde_json::to_string(&spec.bands).unwrap_or_default();
    let gear_indicators = if spec.gear_indicators { GEAR_PREPROCESSING } else { "" };
    let analysis = hash(&[INDICATORS, &feature, &bands, gear_indicators]);
    AnalysisKeys { analysis: Arc::from(analysis), feature: Arc::from(feature) }
}

/// Everything but the features that a channel's estimates and alarms depend on, and how the features were
/// made.
pub(crate) fn fold_key(
    settings: &EstimatorSettings,
    feature_key: &str,
    library: Result<&Ensemble, &LibraryLack>,
    rules: &[AlarmRule],
) -> String {
    let compared_with = match library {
        Ok(ensemble) => ensemble.id().to_owned(),
        Err(LibraryLack::NotDescribed) => String::new(),
        Err(LibraryLack::Simulated) => "awaited".to_owned(),
        Err(LibraryLack::Failed(reason)) => format!("failed: {reason}"),
    };
    hash(&[
        env!("CARGO_PKG_VERSION"),
        METHOD,
        RUN_INDICATORS,
        feature_key,
        &compared_with,
        &settings.baseline_records.to_string(),
        &format!("{:?}", settings.limit_um),
        &serde_json::to_string(rules).unwrap_or_default(),
    ])
}

fn hash(parts: &[&str]) -> String {
    let mut hash = Sha256::new();
    for part in parts {
        hash.update((part.len() as u64).to_le_bytes());
        hash.update(part);
    }
    hex::encode(&hash.finalize()[..16])
}
