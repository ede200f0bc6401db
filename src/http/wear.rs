//! `/v1/assets/{asset}/wear` and its history.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::problem::Problem;
use super::query::{self, AssetInPath, Parameters};
use super::router::App;
use super::{assets, reduction};
use crate::asset::{AssetId, AssetSpec, SegmentId, WearLimits};
use crate::estimate::{BaselineProgress, WearEstimate, WearStatus};
use crate::signal::{PREPROCESSING, ShaftSpeed};
use crate::store::Trend;

/// Points of a history where the client does not say how many.
const DEFAULT_POINTS: usize = 2000;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WearParameters {
    channel: Option<String>,
}

/// The latest wear estimate.
#[derive(Debug, Serialize)]
pub(super) struct WearView {
    asset_id: AssetId,
    channel: Option<String>,
    segment_id: Option<SegmentId>,
    start_time: Option<Timestamp>,
    shaft_speed: Option<ShaftSpeed>,
    limits: WearLimits,
    #[serde(flatten)]
    wear: WearEstimate,
}

pub(super) async fn latest(
    State(app): State<App>,
    AssetInPath(id): AssetInPath,
    Parameters(asked): Parameters<WearParameters>,
) -> Result<Json<WearView>, Problem> {
    let (asset, channel) = assets::asset_and_channel(&app, &id, asked.channel.as_deref()).await?;
    let last = channel.as_ref().and_then(|channel| channel.last_segment.as_ref());
    let segment = match last {
        Some(id) => app.ingest.store().segment(id).await?,
        None => None,
    };
    Ok(Json(WearView {
        asset_id: id,
        channel: channel.map(|channel| channel.channel),
        segment_id: segment.as_ref().map(|segment| segment.id.clone()),
        start_time: segment.as_ref().map(|segment| segment.start_time),
        shaft_speed: segment.as_ref().and_then(|segment| segment.shaft_speed),
        limits: asset.spec.limits,
        wear: segment.map_or_else(|| nothing_yet(&asset.spec), |segment| segment.wear),
    }))
}

/// The answer before the first record.
fn nothing_yet(spec: &AssetSpec) -> WearEstimate {
    let need = spec.baseline.records;
    WearEstimate {
        status: WearStatus::CollectingBaseline,
        reason: format!("no records yet: collecting baseline, 0 of {need}"),
        baseline: BaselineProgress { have: 0, need },
        median_um: None,
        mean_um: None,
        p05_um: None,
        p95_um: None,
        log_evidence: None,
        best_state: None,
        library_id: None,
        method: PREPROCESSING.to_string(),
        posterior: None,
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct HistoryParameters {
    channel: Option<String>,
    from: Option<Timestamp>,
    to: Option<Timestamp>,
    max_points: Option<usize>,
}

/// Wear over time.
#[derive(Debug, Default, Serialize)]
pub(super) struct HistoryView {
    channel: Option<String>,
    items: Vec<HistoryRow>,
    reduced: bool,
}

#[derive(Debug, Serialize)]
struct HistoryRow {
    start_time: Timestamp,
    segment_id: SegmentId,
    status: WearStatus,
    reason: String,
    median_um: Option<f64>,
    mean_um: Option<f64>,
    p05_um: Option<f64>,
    p95_um: Option<f64>,
    reference_wear_um: Option<f64>,
    log_evidence: Option<f64>,
}

pub(super) async fn history(
    State(app): State<App>,
    AssetInPath(asset): AssetInPath,
    Parameters(asked): Parameters<HistoryParameters>,
) -> Result<Json<HistoryView>, Problem> {
    let most = query::max_points(asked.max_points, DEFAULT_POINTS)?;
    let (_, channel) = assets::asset_and_channel(&app, &asset, asked.channel.as_deref()).await?;
    let Some(channel) = channel else {
        return Ok(Json(HistoryView::default()));
    };
    let trend = app.ingest.store().trend(&channel).await?;
    let render = move || render(&trend, asked.from, asked.to, most);
    let mut view = app.ingest.workers().run("reduce a history", render).await?;
    view.channel = Some(channel.channel);
    Ok(Json(view))
}

fn render(trend: &Trend, from: Option<Timestamp>, to: Option<Timestamp>, most: usize) -> HistoryView {
    let range = trend.range(from, to);
    let points = &trend.wear[range.clone()];
    let column = |value: fn(&crate::store::WearPoint) -> Option<f64>| -> Vec<f64> {
        points.iter().map(|point| value(point).unwrap_or(f64::NAN)).collect()
    };
    let columns = [
        column(|point| point.median_um),
        column(|point| point.p05_um),
        column(|point| point.p95_um),
        column(|point| point.reference_wear_um),
    ];
    let columns: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let kept = reduction::extremes(&columns, points.len(), most);
    let row = |n: &usize| {
        let point = &points[*n];
        HistoryRow {
            start_time: trend.start_time[range.start + n],
            segment_id: trend.segment_id[range.start + n].clone(),
            status: point.status,
            reason: point.reason.to_string(),
            median_um: point.median_um,
            mean_um: point.mean_um,
            p05_um: point.p05_um,
            p95_um: point.p95_um,
            reference_wear_um: point.reference_wear_um,
            log_evidence: point.log_evidence,
        }
    };
    HistoryView {
        channel: None,
        reduced: kept.len() < points.len(),
        items: kept.iter().map(row).collect(),
    }
}
