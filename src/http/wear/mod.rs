//! `/v1/assets/{asset}/wear` and its history.

pub(super) mod hindsight;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, Uri, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::app::App;
use super::assets;
use super::problem::Problem;
use super::request::etag;
use super::request::query::{self, AssetPath, Parameters};
use super::request::selection::{self, Selection};
use super::table::{self, Format, Table};
use crate::asset::{AssetId, AssetSpec, OperatingBin, SegmentId, WearLimits, json_name};
use crate::estimate::{BaselineProgress, ChannelContribution, WearEstimate, WearStatus};
use crate::service::JointWear;
use crate::signal::{ShaftSpeed, reduction};
use crate::store::{Trend, WearPoint};

/// Default number of points of a history.
const DEFAULT_POINTS: usize = 2000;

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct WearParameters {
    /// The channel; by default the one named in the description, otherwise all channels combined.
    channel: Option<String>,
}

/// The latest wear estimate.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = LatestWear)]
pub(super) struct WearView {
    /// The asset.
    asset_id: AssetId,
    /// The channel, of several the one that contributes most; none if the asset has no records.
    channel: Option<String>,
    /// Contribution of each channel if several are combined.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    channels: Vec<ChannelContribution>,
    /// Its latest record that is not excluded.
    segment_id: Option<SegmentId>,
    /// Time of its first sample.
    start_time: Option<Timestamp>,
    /// Its shaft speed.
    shaft_speed: Option<ShaftSpeed>,
    /// The asset's limits in µm.
    limits: WearLimits,
    #[serde(flatten)]
    wear: WearEstimate,
}

/// Latest wear estimate
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/wear",
    tag = "trends",
    params(WearParameters),
    responses((status = 200, body = WearView), (status = 304, description = "Not modified")),
)]
pub(super) async fn latest(
    State(app): State<App>,
    AssetPath(id): AssetPath,
    Parameters(params): Parameters<WearParameters>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let asset = app.service.store.asset(&id).await?;
    let known = app.service.store.channels(&id).await?;
    let channels = match params.channel.as_deref() {
        Some(requested) => vec![assets::channel_named(&id, &known, requested)?],
        None => JointWear::contributing_channels(&asset, &known),
    };
    let tag = etag::of_channels(&asset, &channels, &uri, &headers);
    if etag::is_known(&headers, &tag) {
        return Ok(etag::not_modified(tag));
    }
    let limits = asset.spec.limits;
    let view = match JointWear::load(&app.service.store, &channels).await? {
        Some(joint) => WearView {
            asset_id: id,
            channel: Some(joint.leading.channel),
            channels: joint.contributions,
            segment_id: Some(joint.segment.id),
            start_time: Some(joint.segment.start_time),
            shaft_speed: joint.segment.shaft_speed,
            limits,
            wear: joint.wear,
        },
        None => WearView {
            asset_id: id,
            channel: channels.first().map(|channel| channel.channel.clone()),
            channels: Vec::new(),
            segment_id: None,
            start_time: None,
            shaft_speed: None,
            limits,
            wear: nothing_yet(&asset.spec),
        },
    };
    Ok(([(header::ETAG, tag)], Json(view)).into_response())
}

/// The response before the first record.
fn nothing_yet(spec: &AssetSpec) -> WearEstimate {
    let need = spec.baseline.records;
    let reason = format!("no records yet: collecting baseline, 0 of {need}");
    WearEstimate::without_number(WearStatus::CollectingBaseline, reason, BaselineProgress { have: 0, need })
}

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct HistoryParameters {
    /// The channel; by default the one that represents the asset.
    channel: Option<String>,
    /// Only records that start at this time or later.
    from: Option<Timestamp>,
    /// Only records that start before this time.
    to: Option<Timestamp>,
    /// Only records in this operating bin of the asset.
    operating_bin: Option<String>,
    /// Maximum number of points, 10 to 200000; the minimum and maximum of median, ends of the 90 %
    /// interval and reference depth in each part of the time are kept.
    #[param(minimum = 10, maximum = 200000)]
    max_points: Option<usize>,
}

/// Wear over time.
#[derive(Debug, Default, Serialize, utoipa::ToSchema)]
#[schema(as = WearHistory)]
pub(super) struct HistoryView {
    /// The channel; none if the asset has no records.
    channel: Option<String>,
    /// One flat row per record in order of time.
    items: Vec<HistoryRow>,
    /// Whether rows were dropped to meet `max_points`.
    reduced: bool,
}

#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = WearRow)]
struct HistoryRow {
    /// Time of the record's first sample.
    start_time: Timestamp,
    /// The record.
    segment_id: SegmentId,
    /// The operating bin of the record, if any.
    #[serde(skip_serializing_if = "Option::is_none")]
    operating_bin: Option<String>,
    #[serde(flatten)]
    point: WearPoint,
}

/// Trend of wear
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/wear/history",
    tag = "trends",
    params(HistoryParameters),
    responses((status = 200, content((HistoryView = "application/json"), (String = "text/csv"), (Vec<u8> = "application/vnd.apache.parquet"))), (status = 304, description = "Not modified")),
)]
pub(super) async fn history(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<HistoryParameters>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let max_points = query::max_points(params.max_points, DEFAULT_POINTS)?;
    let (asset, channel) = assets::asset_and_channel(&app, &asset, params.channel.as_deref()).await?;
    let tag = etag::of_channel(&asset, channel.as_ref(), &uri, &headers);
    if etag::is_known(&headers, &tag) {
        return Ok(etag::not_modified(tag));
    }
    let format = Format::accepted(&headers);
    let bin = selection::requested_bin(&asset.spec, params.operating_bin.as_deref())?;
    let Some(channel) = channel else {
        return table::respond(tag, format, HistoryView::default(), table_of);
    };
    let trend = app.service.store.trend(&channel).await?;
    let render = move || {
        let selection = Selection::of(&trend, params.from, params.to, bin.as_ref());
        render(&trend, &asset.spec.operating_bins, &selection, max_points)
    };
    let mut view = app.service.workers.run("reduce a history", render).await?;
    view.channel = Some(channel.channel);
    table::respond(tag, format, view, table_of)
}

fn table_of(view: &HistoryView) -> Table {
    let mut table = Table::new(view.channel.as_ref(), view.reduced);
    let rows = || view.items.iter();
    table.times("start_time", rows().map(|row| row.start_time));
    table.words("segment_id", rows().map(|row| row.segment_id.0.clone()));
    table.words("status", rows().map(|row| json_name(&row.point.status)));
    table.words("reason", rows().map(|row| row.point.reason.to_string()));
    table.numbers("median_um", "µm", rows().map(|row| row.point.median_um));
    table.numbers("mean_um", "µm", rows().map(|row| row.point.mean_um));
    table.numbers("low_um", "µm", rows().map(|row| row.point.low_um));
    table.numbers("p25_um", "µm", rows().map(|row| row.point.p25_um));
    table.numbers("p75_um", "µm", rows().map(|row| row.point.p75_um));
    table.numbers("high_um", "µm", rows().map(|row| row.point.high_um));
    table.numbers("reference_wear_um", "µm", rows().map(|row| row.point.reference_wear_um));
    table.numbers("log_evidence", "1", rows().map(|row| row.point.log_evidence));
    if rows().any(|row| row.operating_bin.is_some()) {
        table.words("operating_bin", rows().map(|row| row.operating_bin.clone().unwrap_or_default()));
    }
    table
}

fn render(trend: &Trend, bins: &[OperatingBin], selection: &Selection, max_points: usize) -> HistoryView {
    let column = |value: fn(&WearPoint) -> Option<f64>| -> Vec<f64> {
        let values = (0..selection.len()).map(|n| value(&trend.wear[selection.position(n)]));
        values.map(|value| value.unwrap_or(f64::NAN)).collect()
    };
    let columns = [
        column(|point| point.median_um),
        column(|point| point.low_um),
        column(|point| point.high_um),
        column(|point| point.reference_wear_um),
    ];
    let columns: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let indices = reduction::extremes(&columns, selection.len(), max_points);
    let row = |n: &usize| {
        let position = selection.position(*n);
        HistoryRow {
            start_time: trend.start_time[position],
            segment_id: trend.segment_id[position].clone(),
            operating_bin: selection::bin_of(bins, trend, position).map(str::to_owned),
            point: trend.wear[position].clone(),
        }
    };
    HistoryView {
        channel: None,
        reduced: indices.len() < selection.len(),
        items: indices.iter().map(row).collect(),
    }
}
