//! Hashes of all inputs of a result: results computed under another key are recomputed.

use std::sync::Arc;

use serde::Serialize;
use sha2::{Digest, Sha256};

use crate::asset::AssetSpec;
use crate::estimate::{AlarmRule, EstimatorSettings, METHOD, MissingLibrary};
use crate::library::Ensemble;
use crate::signal::{GEAR_PREPROCESSING, INDICATORS, PREPROCESSING};
use crate::store::AnalysisKeys;

/// Identifies the set of indicators that the fold computes (NA4, NB4 and novelty), and after which records
/// its state is stored: a process that expects it after each record does not continue these histories.
const RUN_INDICATORS: &str = "run-3";

/// Hashes everything except the raw bytes that the analysis of a record of this asset depends on.
pub(crate) fn analysis_keys(spec: &AssetSpec) -> AnalysisKeys {
    let mut parts = vec![PREPROCESSING.to_owned()];
    match &spec.gear {
        Some(gear) => {
            parts.extend([
                format!("{:?}", gear.teeth),
                format!("{:?}", gear.shaft_ratio),
                gear.shaft_speed_hz.to_bits().to_string(),
                gear.speed_tolerance.to_bits().to_string(),
                gear.speed_is_exact.to_string(),
            ]);
            let mut others: Vec<String> = gear.other_meshes.iter().map(json).collect();
            others.sort_unstable();
            parts.extend(others);
        }
        None => parts.push(format!("no mesh, {}", json(&spec.shaft))),
    }
    if !spec.bearings.is_empty() {
        parts.extend([json(&spec.bearings), json(&spec.envelope_band_hz), json(&spec.envelope_band)]);
    }
    let feature = hash(&parts.iter().map(String::as_str).collect::<Vec<_>>());
    let bands = json(&spec.bands);
    let gear_indicators = if spec.gear_indicators { GEAR_PREPROCESSING } else { "" };
    let analysis = hash(&[INDICATORS, &feature, &bands, gear_indicators]);
    AnalysisKeys { analysis: Arc::from(analysis), feature: Arc::from(feature) }
}

/// Hashes everything that a channel's estimates and alarms depend on, with the key of the features in place
/// of the features.
pub(crate) fn fold_key(
    settings: &EstimatorSettings,
    feature_key: &str,
    library: Result<&Ensemble, &MissingLibrary>,
    rules: &[AlarmRule],
) -> String {
    let compared_with = match library {
        Ok(ensemble) => ensemble.id().to_owned(),
        Err(MissingLibrary::NotDescribed) => String::new(),
        Err(MissingLibrary::NoMesh) => "no mesh".to_owned(),
        Err(MissingLibrary::Simulating) => "awaited".to_owned(),
        Err(MissingLibrary::Failed(reason)) => format!("failed: {reason}"),
    };
    hash(&[
        env!("CARGO_PKG_VERSION"),
        METHOD,
        RUN_INDICATORS,
        feature_key,
        &compared_with,
        &settings.baseline_records.to_string(),
        &format!("{:?}", settings.limit_um),
        &json(rules),
    ])
}

fn json<T: Serialize + ?Sized>(value: &T) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

fn hash(parts: &[&str]) -> String {
    let mut hash = Sha256::new();
    for part in parts {
        hash.update((part.len() as u64).to_le_bytes());
        hash.update(part);
    }
    hex::encode(&hash.finalize()[..16])
}
