//! A segment over the shaft angle: its order spectrum and its average over one turn.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};

use super::line_range::LineRange;
use crate::asset::{SegmentId, json_name};
use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::request::query::{self, Parameters, SegmentPath};
use crate::http::segments;
use crate::signal::{AngleSource, Gear, NotComputed, OrderSpectrum, TurnAverage, reduction};

/// Default number of points of a curve.
const DEFAULT_POINTS: usize = 4000;

/// Number of mesh harmonics whose amplitudes are returned.
const MESH_HARMONICS: u32 = 10;

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct OrderParameters {
    /// Maximum number of points, 10 to 200000.
    #[param(minimum = 10, maximum = 200000)]
    max_points: Option<usize>,
    /// Lowest order shown.
    #[param(minimum = 0.0)]
    from_order: Option<f64>,
    /// Highest order shown.
    #[param(exclusive_minimum = 0.0)]
    to_order: Option<f64>,
}

/// Amplitude (peak) over orders of the driving shaft.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct OrderView {
    /// The record.
    segment_id: SegmentId,
    /// Kind of amplitude: `amplitude_peak`.
    quantity: &'static str,
    /// Unit of the amplitudes.
    unit: String,
    /// Window function.
    window: &'static str,
    /// Equivalent noise bandwidth in orders.
    bandwidth_orders: f64,
    /// Bin spacing in orders.
    resolution_orders: f64,
    /// Whether points were dropped to meet `max_points`.
    reduced: bool,
    /// Orders of the driving shaft.
    order: Vec<f64>,
    /// Peak amplitude at each order in `unit`.
    amplitude: Vec<f64>,
    /// Peak amplitudes of the mesh harmonics in `unit`, the first at order `teeth[0]`, at full resolution.
    mesh_amplitudes: Vec<f64>,
    /// Tooth counts, driving and driven; none for a machine without a mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    teeth: Option<[u32; 2]>,
    /// Source and accuracy of the shaft angle.
    angle: AngleSource,
}

/// Amplitude spectrum over orders of the driving shaft
#[utoipa::path(
    get,
    path = "/v1/segments/{segment}/orders",
    tag = "records",
    params(OrderParameters),
    responses(
        (status = 200, body = OrderView),
        (status = 422, description = "The curve is not available for this record"),
    ),
)]
pub(crate) async fn orders(
    State(app): State<App>,
    SegmentPath(id): SegmentPath,
    Parameters(params): Parameters<OrderParameters>,
) -> Result<Json<OrderView>, Problem> {
    let max_points = query::max_points(params.max_points, DEFAULT_POINTS)?;
    let range = LineRange::new(["from_order", "to_order"], params.from_order, params.to_order)?;
    let segment = segments::find(&app, &id).await?;
    let teeth = app.service.store.asset(&segment.asset_id).await?.spec.teeth();
    let _ticket = app.service.workers.admit_response()?;
    let computed = app.service.records.analyse_stored(
        &segment,
        "compute an order spectrum",
        |analyzer, record, mesh| analyzer.order_spectrum(record, mesh),
    );
    let spectrum = computed.await?.map_err(|reason| absent("spectrum over orders", reason))?;
    let resolution_orders = spectrum.resolution_orders;
    let places = range.places(spectrum.amplitude.len(), resolution_orders);
    let mesh_amplitudes = teeth.map_or_else(Vec::new, |[driving, _]| mesh_amplitudes(&spectrum, driving));
    let (first, amplitude) = (places.start, &spectrum.amplitude[places]);
    let indices = reduction::peaks(amplitude, max_points);
    Ok(Json(OrderView {
        segment_id: segment.id,
        quantity: "amplitude_peak",
        unit: spectrum.unit,
        window: "hann",
        bandwidth_orders: spectrum.bandwidth_orders,
        resolution_orders,
        reduced: indices.len() < amplitude.len(),
        order: indices.iter().map(|n| (first + n) as f64 * resolution_orders).collect(),
        amplitude: indices.iter().map(|n| amplitude[*n]).collect(),
        mesh_amplitudes,
        teeth,
        angle: spectrum.angle,
    }))
}

/// Amplitudes of the first mesh harmonics, as far as the spectrum reaches. Each is the maximum of the line at
/// its order and its neighbours: the angle is tracked, so the energy is in no other line.
fn mesh_amplitudes(spectrum: &OrderSpectrum, teeth: u32) -> Vec<f64> {
    let place = |harmonic: u32| (f64::from(harmonic * teeth) / spectrum.resolution_orders).round() as usize;
    let around = |place: usize| spectrum.amplitude.get(place.checked_sub(1)?..=place + 1);
    let amplitudes = (1..=MESH_HARMONICS).map_while(|harmonic| around(place(harmonic)));
    amplitudes.map(|lines| lines.iter().copied().fold(0.0, f64::max)).collect()
}

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct TurnParameters {
    /// The gear: 1 driving (default), 2 driven.
    #[param(minimum = 1, maximum = 2)]
    gear: Option<u32>,
}

/// The average over whole turns of a gear, and its components.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct TurnView {
    /// The record.
    segment_id: SegmentId,
    /// Unit of the amplitudes.
    unit: String,
    /// The gear: 1 driving, 2 driven.
    gear: u32,
    /// Number of whole turns averaged.
    turns: usize,
    /// Tooth counts, driving and driven.
    #[serde(skip_serializing_if = "Option::is_none")]
    teeth: Option<[u32; 2]>,
    /// Source and accuracy of the shaft angle.
    angle: AngleSource,
    /// Angle of the gear in degrees.
    angle_deg: Vec<f64>,
    /// The average at each angle in `unit`, without its mean.
    average: Vec<f64>,
    /// The average without shaft orders 1 and 2 and the mesh harmonics.
    residual: Vec<f64>,
    /// Envelope of the first mesh line, without its mean.
    mesh_envelope: Vec<f64>,
}

/// Synchronous average over one turn of either gear
#[utoipa::path(
    get,
    path = "/v1/segments/{segment}/turn",
    tag = "records",
    params(TurnParameters),
    responses(
        (status = 200, body = TurnView),
        (status = 422, description = "The curve is not available for this record"),
    ),
)]
pub(crate) async fn turn(
    State(app): State<App>,
    SegmentPath(id): SegmentPath,
    Parameters(params): Parameters<TurnParameters>,
) -> Result<Json<TurnView>, Problem> {
    let number = params.gear.unwrap_or(1);
    let gear = match number {
        1 => Gear::Driving,
        2 => Gear::Driven,
        other => return Err(Problem::query("gear", other, "1 (driving) or 2 (driven)")),
    };
    let segment = segments::find(&app, &id).await?;
    let teeth = app.service.store.asset(&segment.asset_id).await?.spec.teeth();
    if gear == Gear::Driven && teeth.is_none() {
        return Err(Problem::query("gear", number, "1: the machine has no mesh, so it has no driven gear"));
    }
    let _ticket = app.service.workers.admit_response()?;
    let computed = app
        .service
        .records
        .analyse_stored(&segment, "average over a turn", move |analyzer, record, mesh| {
            analyzer.turn_average(record, mesh, gear)
        })
        .await?;
    let TurnAverage { turns, angle, signals } =
        computed.map_err(|reason| absent("average over a turn", reason))?;
    let samples = signals.average.len();
    Ok(Json(TurnView {
        segment_id: segment.id,
        unit: segment.unit,
        gear: number,
        turns,
        teeth,
        angle,
        angle_deg: (0..samples).map(|n| 360.0 * n as f64 / samples as f64).collect(),
        average: signals.average,
        residual: signals.residual,
        mesh_envelope: signals.mesh_envelope,
    }))
}

/// The problem for a curve that is not available for this record.
pub(crate) fn absent(what: &str, absence: NotComputed) -> Problem {
    let reason = json_name(&absence).replace('_', " ");
    Problem::new(StatusCode::UNPROCESSABLE_ENTITY, format!("this record has no {what}: {reason}"))
}
