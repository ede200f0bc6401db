//! `/v1/assets/{asset}/indicators`: indicator trends as flat rows.

pub(super) mod baseline_statistics;

use std::borrow::Cow;
use std::collections::BTreeMap;

use axum::extract::State;
use axum::http::{HeaderMap, Uri};
use axum::response::Response;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::app::App;
use super::assets;
use super::problem::Problem;
use super::request::etag;
use super::request::query::{self, AssetPath, Parameters};
use super::request::selection::{self, Selection};
use super::table::{self, Format, Table};
use crate::asset::AssetSpec;
use crate::estimate::WearStatus;
use crate::signal::{Indicators, VELOCITY_RMS, reduction};
use crate::store::Trend;

/// Default number of points of a trend.
const DEFAULT_POINTS: usize = 2000;

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct TrendParameters {
    /// Indicator names, comma-separated, at most 64; all by default.
    #[param(example = "rms,kurtosis")]
    names: Option<String>,
    /// The channel; by default the one that represents the asset.
    channel: Option<String>,
    /// Only records that start at this time or later.
    from: Option<Timestamp>,
    /// Only records that start before this time.
    to: Option<Timestamp>,
    /// Only records in this operating bin of the asset.
    operating_bin: Option<String>,
    /// Maximum number of points, 10 to 200000; the minimum and maximum of every name in each interval are
    /// kept. At least two points of each name, the first and the last are returned.
    #[param(minimum = 10, maximum = 200000)]
    max_points: Option<usize>,
}

/// Indicators over time.
#[derive(Debug, Default, Serialize, utoipa::ToSchema)]
#[schema(as = Trend)]
pub(super) struct TrendView {
    /// The channel; none if the asset has no records.
    channel: Option<String>,
    /// Unit of each indicator; `1` if dimensionless.
    units: BTreeMap<String, String>,
    /// One flat row per record in order of time: `start_time`, `segment_id`, `operating_bin` if it is in one,
    /// `excluded` if it is, each indicator by name (null if missing), and beside `velocity_rms` the
    /// `velocity_zone` if the asset has zones.
    items: Vec<Map<String, Value>>,
    /// Whether rows were dropped to meet `max_points`.
    reduced: bool,
}

/// Trend of indicators
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/indicators",
    tag = "trends",
    params(TrendParameters),
    responses((status = 200, content((TrendView = "application/json"), (String = "text/csv"), (Vec<u8> = "application/vnd.apache.parquet"))), (status = 304, description = "Not modified")),
)]
pub(super) async fn trend(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<TrendParameters>,
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
    let names = params.names.as_deref();
    let names: Option<Vec<String>> =
        names.map(|names| query::entries(Some(names)).map(str::to_owned).collect());
    if let Some(names) = names.as_ref().filter(|names| names.len() > 64) {
        return Err(Problem::query("names", format!("{} names", names.len()), "at most 64 names"));
    }
    let check = |known: &BTreeMap<String, Vec<f64>>| {
        check_names(names.as_deref().unwrap_or_default(), known, &asset.spec)
    };
    let bin = selection::requested_bin(&asset.spec, params.operating_bin.as_deref())?;
    let Some(channel) = channel else {
        check(&BTreeMap::new())?;
        return table::respond(tag, format, TrendView::default(), table_of);
    };
    let trend = app.service.store.trend(&channel).await?;
    check(&trend.indicators)?;
    let names = names.unwrap_or_else(|| trend.indicators.keys().cloned().collect());
    let render = move || {
        let selection = Selection::of(&trend, params.from, params.to, bin.as_ref());
        render(&trend, &asset.spec, &names, &selection, max_points)
    };
    let mut view = app.service.workers.run("reduce a trend", render).await?;
    view.channel = Some(channel.channel);
    table::respond(tag, format, view, table_of)
}

/// Rejects names that are neither indicators nor have values from before a change of the bands.
pub(super) fn check_names(
    names: &[String],
    recorded: &BTreeMap<String, Vec<f64>>,
    spec: &AssetSpec,
) -> Result<(), Problem> {
    let known = spec.indicator_names();
    let earlier = recorded.keys().filter(|name| !known.contains(name));
    let all: Vec<&str> = known.iter().chain(earlier).map(String::as_str).collect();
    check_known("names", names.iter().map(String::as_str), &all)
}

/// Rejects a parameter with a name that is not known.
pub(super) fn check_known<'a>(
    parameter: &str,
    mut names: impl Iterator<Item = &'a str>,
    known: &[&str],
) -> Result<(), Problem> {
    let Some(unknown) = names.find(|name| !known.contains(name)) else {
        return Ok(());
    };
    let nearest = Indicators::nearest(unknown, known.iter().copied()).join(", ");
    let expected = format!("names of indicators; the nearest are {nearest}");
    Err(Problem::query(parameter, format!("{unknown:?}"), &expected))
}

fn table_of(view: &TrendView) -> Table {
    let mut table = Table::new(view.channel.as_ref(), view.reduced);
    let values = |name: &'static str| view.items.iter().map(move |row| row.get(name));
    let time = |value: Option<&Value>| value.and_then(Value::as_str)?.parse().ok();
    table.times("start_time", values("start_time").map(|value| time(value).unwrap_or_default()));
    let word = |value: Option<&Value>| value.and_then(Value::as_str).unwrap_or_default().to_owned();
    table.words("segment_id", values("segment_id").map(word));
    for (name, unit) in &view.units {
        table.numbers(name, unit, view.items.iter().map(|row| row.get(name)?.as_f64()));
    }
    let is_excluded = |value: Option<&Value>| value.is_some().to_string();
    for (name, text) in [
        ("velocity_zone", word as fn(Option<&Value>) -> String),
        ("operating_bin", word),
        ("excluded", is_excluded),
    ] {
        if view.items.iter().any(|row| row.contains_key(name)) {
            table.words(name, values(name).map(text));
        }
    }
    table
}

fn render(
    trend: &Trend,
    spec: &AssetSpec,
    names: &[String],
    selection: &Selection,
    max_points: usize,
) -> TrendView {
    let unknown = vec![f64::NAN; selection.len()];
    let column = |name| match trend.indicators.get(name) {
        Some(column) => selection.column(column),
        None => Cow::Borrowed(&unknown[..]),
    };
    let columns: Vec<Cow<'_, [f64]>> = names.iter().map(column).collect();
    let columns: Vec<&[f64]> = columns.iter().map(|column| &**column).collect();
    let indices = reduction::extremes(&columns, selection.len(), max_points);
    let row = |n: &usize| {
        let mut row = Map::with_capacity(3 + names.len());
        let position = selection.position(*n);
        row.insert("start_time".into(), trend.start_time[position].to_string().into());
        row.insert("segment_id".into(), trend.segment_id[position].0.clone().into());
        if let Some(bin) = selection::bin_of(&spec.operating_bins, trend, position) {
            row.insert("operating_bin".into(), bin.into());
        }
        if trend.wear[position].status == WearStatus::Excluded {
            row.insert("excluded".into(), true.into());
        }
        for (name, column) in names.iter().zip(&columns) {
            // NaN, which means no value, becomes null
            row.insert(name.clone(), column[*n].into());
            if name == VELOCITY_RMS
                && let Some(zones) = spec.velocity_zones.filter(|_| column[*n].is_finite())
            {
                row.insert("velocity_zone".into(), json!(zones.zone(column[*n])));
            }
        }
        row
    };
    let unit = |name: &String| (name.clone(), Indicators::unit(name, &trend.unit, &spec.bands));
    TrendView {
        channel: None,
        units: names.iter().map(unit).collect(),
        reduced: indices.len() < selection.len(),
        items: indices.iter().map(row).collect(),
    }
}
