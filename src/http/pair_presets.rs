//! `/v1/pair-presets`: example gear pairs as a starting point.

use axum::Json;
use axum::http::StatusCode;
use serde::Serialize;

use super::problem::Problem;
use super::request::query::Page;
use crate::gear::PairSpec;

/// Names and pair files.
const PRESETS: [(&str, &str); 4] = [
    ("steel-module-1", include_str!("../../fixtures/pairs/steel-module-1.toml")),
    ("shen2022", include_str!("../../fixtures/pairs/shen2022.toml")),
    ("steel-module-12", include_str!("../../fixtures/pairs/steel-module-12.toml")),
    ("plastic-module-0.5", include_str!("../../fixtures/pairs/plastic-module-0.5.toml")),
];

/// An example gear pair.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct PairPreset {
    /// Its name.
    name: &'static str,
    /// The pair, in the form of an asset's `gear.pair`.
    pair: PairSpec,
}

/// List example gear pairs
///
/// Complete pairs as a starting point for new descriptions.
#[utoipa::path(
    get,
    path = "/v1/pair-presets",
    tag = "libraries",
    responses((status = 200, body = Page<PairPreset>)),
)]
pub(super) async fn list() -> Result<Json<Page<PairPreset>>, Problem> {
    let preset = |(name, text)| Ok(PairPreset { name, pair: PairSpec::from_toml(text)? });
    let items: Result<_, crate::gear::GearError> = PRESETS.into_iter().map(preset).collect();
    let items = items.map_err(|error| Problem::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
    Ok(Json(Page::from_parts(items, None)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_can_be_modelled() {
        for (name, text) in PRESETS {
            let checked = PairSpec::from_toml(text).unwrap().check();
            assert!(checked.is_ok(), "{name}: {}", checked.unwrap_err());
        }
    }
}
