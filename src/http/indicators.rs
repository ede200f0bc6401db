//! `/v1/assets/{asset}/indicators`: trends as flat rows.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::problem::Problem;
use super::query::{self, AssetInPath, Parameters};
use super::router::App;
use super::{assets, reduction};
use crate::store::Trend;

/// Points of a trend where the client does not say how many.
const DEFAULT_POINTS: usize = 2000;

/// Indicators without a unit; all others are in the record's.
const DIMENSIONLESS: [&str; 2] = ["kurtosis", "crest_factor"];

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TrendParameters {
    names: Option<String>,
    channel: Option<String>,
    from: Option<Timestamp>,
    to: Option<Timestamp>,
    max_points: Option<usize>,
}

/// Indicators over time.
#[derive(Debug, Default, Serialize)]
pub(super) struct TrendView {
    channel: Option<String>,
    units: BTreeMap<String, String>,
    items: Vec<Map<String, Value>>,
    reduced: bool,
}

pub(super) async fn trend(
    State(app): State<App>,
    AssetInPath(asset): AssetInPath,
    Parameters(asked): Parameters<TrendParameters>,
) -> Result<Json<TrendView>, Problem> {
    let most = query::max_points(asked.max_points, DEFAULT_POINTS)?;
    let (_, channel) = assets::asset_and_channel(&app, &asset, asked.channel.as_deref()).await?;
    let Some(channel) = channel else {
        return Ok(Json(TrendView::default()));
    };
    let trend = app.ingest.store().trend(&channel).await?;
    let names: Vec<String> = match &asked.names {
        Some(names) => names
            .split(',')
            .map(|name| name.trim().to_string())
            .filter(|name| !name.is_empty())
            .collect(),
        None => trend.indicators.keys().cloned().collect(),
    };
    if names.len() > 64 {
        return Err(Problem::query("names", format!("{} names", names.len()), "at most 64 names"));
    }
    let render = move || render(&trend, &names, &asked, most);
    let mut view = app.ingest.workers().run("reduce a trend", render).await?;
    view.channel = Some(channel.channel);
    Ok(Json(view))
}

fn render(trend: &Trend, names: &[String], asked: &TrendParameters, most: usize) -> TrendView {
    let range = trend.range(asked.from, asked.to);
    let unknown = vec![f64::NAN; range.len()];
    let columns: Vec<&[f64]> = names
        .iter()
        .map(|name| trend.indicators.get(name).map_or(&unknown[..], |column| &column[range.clone()]))
        .collect();
    let kept = reduction::extremes(&columns, range.len(), most);
    let row = |n: &usize| {
        let mut row = Map::with_capacity(2 + names.len());
        row.insert("start_time".into(), trend.start_time[range.start + n].to_string().into());
        row.insert("segment_id".into(), trend.segment_id[range.start + n].0.clone().into());
        for (name, column) in names.iter().zip(&columns) {
            // NaN, for no value, becomes null.
            row.insert(name.clone(), column[*n].into());
        }
        row
    };
    let unit = |name: &String| {
        let is_dimensionless = DIMENSIONLESS.contains(&name.as_str());
        (name.clone(), if is_dimensionless { "1".to_string() } else { trend.unit.clone() })
    };
    TrendView {
        channel: None,
        units: names.iter().map(unit).collect(),
        reduced: kept.len() < range.len(),
        items: kept.iter().map(row).collect(),
    }
}
