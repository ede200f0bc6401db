//! `/v1/assets/{asset}/waterfall`: spectra over a channel's life, each reduced to the same cells.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use tokio::task::JoinSet;

use super::line_cache::{Axis, Grid, Line, LineKey};
use crate::asset::{Segment, SegmentId};
use crate::http::app::App;
use crate::http::assets;
use crate::http::problem::Problem;
use crate::http::request::query::{AssetPath, Parameters};
use crate::service::ServiceError;
use crate::signal::Spectrum;

/// Maximum end of the last cell, in the unit of the axis.
const MAX_END: f64 = 1e9;

/// Default and maximum number of records and cells.
const RECORDS: (usize, usize) = (200, 600);
const CELLS: (usize, usize) = (400, 2000);

/// Number of spectra computed at the same time: each holds a whole record.
const MAX_CONCURRENT: usize = 4;

/// Lowest level in dB of one unit; below it there is only quantisation noise.
const LOWEST_DB: f64 = -200.0;

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct WaterfallParameters {
    /// The channel; by default the one that represents the asset.
    channel: Option<String>,
    /// Only records that start at this time or later.
    from: Option<Timestamp>,
    /// Only records that start before this time.
    to: Option<Timestamp>,
    /// Axis of the cells.
    #[serde(default)]
    axis: Axis,
    /// Maximum number of records, 2 to 600, evenly spaced over the life.
    #[param(minimum = 2, maximum = 600)]
    max_records: Option<usize>,
    /// Number of cells per spectrum, 2 to 2000.
    #[param(minimum = 2, maximum = 2000)]
    cells: Option<usize>,
    /// End of the last cell, in the unit of the axis.
    #[param(exclusive_minimum = 0.0, maximum = 1e9)]
    max: Option<f64>,
}

/// Spectra in the order of time.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct WaterfallView {
    /// The channel; null if there are no records.
    channel: Option<String>,
    /// Axis of the cells.
    axis: Axis,
    /// Kind of amplitude: `amplitude_peak`.
    quantity: &'static str,
    /// Unit of the amplitudes.
    unit: String,
    /// Window function.
    window: &'static str,
    /// Centres of the cells.
    position: Vec<f64>,
    /// Position of the mesh frequency, in the unit of the axis.
    mesh_position: Option<f64>,
    /// The records in time order.
    items: Vec<WaterfallRow>,
    /// Whether records were dropped to meet the limit.
    reduced: bool,
}

/// One record's spectrum: the maximum peak amplitude in each cell in dB of one unit.
#[derive(Debug, Serialize, utoipa::ToSchema)]
struct WaterfallRow {
    /// The record.
    segment_id: SegmentId,
    /// Time of the first sample.
    start_time: Timestamp,
    /// Shaft speed in hertz, if known.
    shaft_speed_hz: Option<f64>,
    /// Level of each cell in dB of one unit; null if the axis is orders and the speed is unknown, or if the
    /// raw recording is no longer kept.
    #[serde(serialize_with = "as_list")]
    #[schema(value_type = Option<Vec<f32>>)]
    level_db: Option<Line>,
}

fn as_list<S: serde::Serializer>(line: &Option<Line>, serializer: S) -> Result<S::Ok, S::Error> {
    line.as_deref().serialize(serializer)
}

/// Spectra over a channel's life
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/waterfall",
    tag = "trends",
    params(WaterfallParameters),
    responses((status = 200, body = WaterfallView)),
)]
pub(crate) async fn show(
    State(app): State<App>,
    AssetPath(id): AssetPath,
    Parameters(params): Parameters<WaterfallParameters>,
) -> Result<Json<WaterfallView>, Problem> {
    let records = within("max_records", params.max_records, RECORDS)?;
    let cells = within("cells", params.cells, CELLS)?;
    if let Some(max) = params.max.filter(|max| !(*max > 0.0 && *max <= MAX_END)) {
        return Err(Problem::query("max", max, "a number above 0 and at most 1e9"));
    }
    let (asset, channel) = assets::asset_and_channel(&app, &id, params.channel.as_deref()).await?;
    let mut view = WaterfallView {
        channel: None,
        axis: params.axis,
        quantity: "amplitude_peak",
        unit: String::new(),
        window: "hann",
        position: Vec::new(),
        mesh_position: None,
        items: Vec::new(),
        reduced: false,
    };
    let Some(channel) = channel else {
        return Ok(Json(view));
    };
    let trend = app.service.store.trend(&channel).await?;
    let range = trend.range(params.from, params.to);
    let positions = evenly(range.len(), records);
    view.reduced = positions.len() < range.len();
    let ids: Vec<SegmentId> = positions.iter().map(|n| trend.segment_id[range.start + n].clone()).collect();
    view.unit = trend.unit.clone();
    view.channel = Some(channel.channel);
    let segments = app.service.store.segments_by_id(&ids).await?;
    let Some(first) = segments.first() else {
        return Ok(Json(view));
    };
    let latest_speed = segments.iter().rev().find_map(|segment| segment.shaft_speed);
    let speed_hz = asset.spec.nominal_speed_hz().or(latest_speed.map(|speed| speed.shaft_speed_hz));
    let highest = match (params.axis, speed_hz) {
        (Axis::Hz, _) => first.sample_rate_hz / 2.0,
        (Axis::Orders, Some(speed_hz)) => first.sample_rate_hz / 2.0 / speed_hz,
        (Axis::Orders, None) => {
            return Err(Problem::query("axis", "orders", "hz, as the shaft speed is unknown"));
        }
    };
    let end = params.max.unwrap_or(highest);
    let grid = Grid { axis: params.axis, cells, end_bits: end.to_bits() };
    view.mesh_position = match params.axis {
        Axis::Orders => asset.spec.teeth().map(|[driving, _]| f64::from(driving)),
        Axis::Hz => latest_speed.map(|speed| speed.mesh_frequency_hz).filter(|mesh_hz| *mesh_hz > 0.0),
    };
    view.position = (0..cells).map(|n| (n as f64 + 0.5) * end / cells as f64).collect();
    let _ticket = app.service.workers.admit_response()?;
    let lines = lines(&app, &segments, grid).await?;
    view.items = segments
        .into_iter()
        .zip(lines)
        .map(|(segment, level_db)| WaterfallRow {
            segment_id: segment.id,
            start_time: segment.start_time,
            shaft_speed_hz: segment.shaft_speed.map(|speed| speed.shaft_speed_hz),
            level_db,
        })
        .collect();
    Ok(Json(view))
}

fn within(field: &str, requested: Option<usize>, (default, max): (usize, usize)) -> Result<usize, Problem> {
    match requested.unwrap_or(default) {
        number if (2..=max).contains(&number) => Ok(number),
        number => Err(Problem::query(field, number, &format!("a number from 2 to {max}"))),
    }
}

/// Evenly spaced positions in a list, including the first and the last.
pub(crate) fn evenly(length: usize, max: usize) -> Vec<usize> {
    if length <= max {
        return (0..length).collect();
    }
    (0..max).map(|n| n * (length - 1) / (max - 1)).collect()
}

/// The reduced spectra of segments in order; `None` if the axis is orders and the speed is unknown, or if the
/// raw bytes are no longer available.
async fn lines(app: &App, segments: &[Segment], grid: Grid) -> Result<Vec<Option<Line>>, Problem> {
    let mut lines: Vec<Option<Line>> = vec![None; segments.len()];
    let mut missing = Vec::new();
    for (n, segment) in segments.iter().enumerate() {
        let Some(unit_hz) = grid.axis.unit_hz(segment) else { continue };
        let key = LineKey::new(segment.id.clone(), grid, unit_hz);
        lines[n] = app.lines.get(&key);
        if lines[n].is_none() {
            missing.push((n, unit_hz, key));
        }
    }
    for some in missing.chunks(MAX_CONCURRENT) {
        let mut tasks = JoinSet::new();
        for (n, unit_hz, key) in some.iter().cloned() {
            let (service, segment) = (app.service.clone(), segments[n].clone());
            tasks.spawn(async move {
                let reduce = move |spectrum: &Spectrum| {
                    levels(&spectrum.amplitude, spectrum.resolution_hz / unit_hz, grid)
                };
                let line = service
                    .records
                    .analyse_stored(&segment, "reduce a spectrum", move |analyzer, record, _| {
                        reduce(&analyzer.amplitude_spectrum(record))
                    })
                    .await;
                (n, key, line)
            });
        }
        while let Some(done) = tasks.join_next().await {
            let (n, key, line) = done.map_err(|_| ServiceError::WorkerLost("reduce a spectrum"))?;
            let line: Line = match line {
                Err(error) if error.is_raw_unavailable() => continue,
                line => line?.into(),
            };
            app.lines.insert(key, line.clone());
            lines[n] = Some(line);
        }
    }
    Ok(lines)
}

/// The maximum amplitude in each cell in dB, for amplitudes spaced by `resolution`; cells narrower than that
/// take the nearest line.
fn levels(amplitude: &[f64], resolution: f64, grid: Grid) -> Vec<f32> {
    let bins_per_cell = grid.end() / grid.cells as f64 / resolution;
    let last = amplitude.len().saturating_sub(1);
    let level = |n: usize| {
        let low = (n as f64 * bins_per_cell).round() as usize;
        let high = ((n + 1) as f64 * bins_per_cell).round() as usize;
        if low > last {
            return LOWEST_DB as f32;
        }
        let cell = &amplitude[low..high.clamp(low + 1, last + 1)];
        let greatest = cell.iter().copied().fold(0.0, f64::max);
        // One decimal is finer than any colour scale, and needs a third of the digits
        ((20.0 * greatest.log10()).max(LOWEST_DB) * 10.0).round() as f32 / 10.0
    };
    (0..grid.cells).map(level).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_stays_at_its_place_and_height() {
        let mut amplitude = vec![1e-3; 1001];
        amplitude[500] = 10.0;
        let grid = |axis, cells, end: f64| Grid { axis, cells, end_bits: end.to_bits() };
        // 250 Hz of 500 Hz.
        let line = levels(&amplitude, 0.5, grid(Axis::Hz, 100, 500.0));
        assert_eq!((line[49], line[50], line[51]), (-60.0, 20.0, -60.0));
        // Order 10 of a shaft with 25 Hz, of 20 orders.
        let line = levels(&amplitude, 0.5 / 25.0, grid(Axis::Orders, 100, 20.0));
        assert_eq!((line[50], line.iter().filter(|db| **db > 0.0).count()), (20.0, 1));
        // Beyond half the sampling rate there is nothing.
        assert_eq!(levels(&amplitude, 0.5, grid(Axis::Hz, 2, 2000.0))[1], LOWEST_DB as f32);
    }

    #[test]
    fn the_first_and_the_last_are_shown() {
        assert_eq!(evenly(5, 10), [0, 1, 2, 3, 4]);
        assert_eq!(evenly(1000, 3), [0, 499, 999]);
    }
}
