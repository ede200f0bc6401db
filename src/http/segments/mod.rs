//! `/v1/assets/{asset}/segments` and `/v1/segments/{segment}`.

pub(super) mod exclusions;
pub(super) mod raw_recordings;
pub(super) mod record_choice;

use axum::Extension;
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::IntoResponse;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::access::issued_tokens::by;
use super::access::session::Caller;
use super::app::App;
use super::problem::Problem;
use super::request::query::{self, AssetPath, Page, Parameters, SegmentPath};
use super::request::selection;
use crate::asset::{AssetId, AssetSpec, RawReference, Segment, SegmentId, VelocityZone};
use crate::estimate::WearEstimate;
use crate::signal::{Basis, Indicators, OperatingPoint, ShaftSpeed};
use crate::store::{Order, RecordRange, SegmentFilter, SegmentKey};
use record_choice::RecordChoice;

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct ListParameters {
    /// Only this channel.
    channel: Option<String>,
    /// Only records that start at this time or later.
    from: Option<Timestamp>,
    /// Only records that start before this time.
    to: Option<Timestamp>,
    /// Only records in this operating bin of the asset.
    operating_bin: Option<String>,
    /// Only records whose estimate has one of these statuses, comma-separated.
    #[param(example = "estimated,excluded")]
    status: Option<String>,
    /// Page size: 1 to 1000, default 100.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
    /// `asc`: oldest first; `desc`: newest first.
    #[serde(default)]
    #[param(inline, required = false)]
    order: Order,
}

/// A segment in lists: without features and posterior.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct SegmentRow {
    /// Identifier.
    id: SegmentId,
    /// The asset it belongs to.
    asset_id: AssetId,
    /// The measuring channel.
    channel: String,
    /// Time of the first sample.
    start_time: Timestamp,
    /// When the service received it.
    received_at: Timestamp,
    /// Sampling rate in hertz.
    sample_rate_hz: f64,
    /// Number of samples.
    samples: u64,
    /// Unit of the samples.
    unit: String,
    /// Operating point supplied with the record.
    operating_point: OperatingPoint,
    /// Shaft speed that was used, and its source.
    shaft_speed: Option<ShaftSpeed>,
    /// Wear depth in µm known from another source.
    #[serde(skip_serializing_if = "Option::is_none")]
    reference_wear_um: Option<f64>,
    /// Location of the raw bytes.
    raw: RawReference,
    /// Whether it is excluded from the baseline, the estimate and alarms.
    excluded: bool,
    #[serde(flatten)]
    basis: Basis,
    #[serde(flatten)]
    indicators: Indicators,
    /// The ISO 20816 zone of `velocity_rms`, if the asset has zones.
    #[serde(skip_serializing_if = "Option::is_none")]
    velocity_zone: Option<VelocityZone>,
    /// The wear estimate after this record, without its posterior.
    wear: WearEstimate,
}

impl SegmentRow {
    fn of(segment: Segment, spec: &AssetSpec) -> Self {
        Self {
            velocity_zone: spec.velocity_zone(&segment.indicators),
            id: segment.id,
            asset_id: segment.asset_id,
            channel: segment.channel,
            start_time: segment.start_time,
            received_at: segment.received_at,
            sample_rate_hz: segment.sample_rate_hz,
            samples: segment.samples,
            unit: segment.unit,
            operating_point: segment.operating_point,
            shaft_speed: segment.shaft_speed,
            reference_wear_um: segment.reference_wear_um,
            raw: segment.raw,
            excluded: segment.excluded,
            basis: segment.basis,
            indicators: segment.indicators,
            wear: WearEstimate { posterior: None, ..segment.wear },
        }
    }
}

/// List segments of an asset in order of time
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/segments",
    tag = "records",
    params(ListParameters),
    responses((status = 422, description = "A time out of range"), (status = 200, body = Page<SegmentRow>)),
)]
pub(super) async fn list(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<ListParameters>,
) -> Result<impl IntoResponse, Problem> {
    let limit = query::limit(params.limit)?;
    let filter = SegmentFilter {
        channel: params.channel,
        from: params.from,
        to: params.to,
        after: query::segment_cursor(params.cursor.as_deref())?,
        order: params.order,
        ..SegmentFilter::default()
    };
    let store = &app.service.store;
    let spec = store.asset(&asset).await?.spec;
    let choice = RecordChoice {
        bin: selection::requested_bin(&spec, params.operating_bin.as_deref())?,
        statuses: record_choice::parse_statuses(params.status.as_deref())?,
    };
    let segments = choice.segments(store, &asset, &filter, limit + 1).await?;
    let page = Page::new(segments, limit, |segment: &Segment| {
        query::cursor_of(&SegmentKey { start_time: segment.start_time, id: segment.id.clone() })
    });
    Ok(Json(page.map(|segment| SegmentRow::of(segment, &spec))))
}

/// A complete segment.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct SegmentView {
    #[serde(flatten)]
    segment: Segment,
    /// The ISO 20816 zone of `velocity_rms`, if the asset has zones.
    #[serde(skip_serializing_if = "Option::is_none")]
    velocity_zone: Option<VelocityZone>,
}

/// Get a complete segment
#[utoipa::path(
    get,
    path = "/v1/segments/{segment}",
    tag = "records",
    responses((status = 200, body = SegmentView)),
)]
pub(super) async fn show(
    State(app): State<App>,
    SegmentPath(id): SegmentPath,
) -> Result<Json<SegmentView>, Problem> {
    let segment = find(&app, &id).await?;
    let spec = app.service.store.asset(&segment.asset_id).await?.spec;
    let velocity_zone = spec.velocity_zone(&segment.indicators);
    Ok(Json(SegmentView { segment, velocity_zone }))
}

/// Delete one segment
///
/// Also for other assets with the same sensor: the affected histories are recomputed in the background as if
/// the record had never been received. Its raw recording is moved to quarantine. Uploading it again stores it
/// again.
#[utoipa::path(
    delete,
    path = "/v1/segments/{segment}",
    tag = "records",
    responses(
        (status = 204, description = "Deleted"),
        (status = 409, description = "The record belongs to another asset with the same sensor"),
    ),
)]
pub(super) async fn remove(
    State(app): State<App>,
    SegmentPath(id): SegmentPath,
    caller: Option<Extension<Caller>>,
) -> Result<StatusCode, Problem> {
    let segment = find(&app, &id).await?;
    tracing::info!(asset = %segment.asset_id, segment = %id, by = by(caller.as_deref()), "removing a record");
    app.service.removals.remove_one(&segment).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// The selected records; needs `ids`, or at least one of `from` and `to`.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct RangeParameters {
    /// Only those of this channel.
    channel: Option<String>,
    /// Only records that start at this time or later.
    from: Option<Timestamp>,
    /// Only records that start before this time.
    to: Option<Timestamp>,
    /// These records instead of a range: comma-separated ids, at most 200.
    ids: Option<String>,
}

impl RangeParameters {
    /// The range, or one range per named record; `all` tells how to select everything, for the error about a
    /// missing range.
    pub(super) async fn ranges(
        self,
        app: &App,
        asset: &AssetId,
        all: &'static str,
    ) -> Result<Vec<RecordRange>, Problem> {
        if let Some(ids) = &self.ids {
            if self.channel.is_some() || self.from.is_some() || self.to.is_some() {
                return Err(Problem::query("ids", "given", "no value together with channel, from or to"));
            }
            return record_choice::named(&app.service.store, asset, ids).await;
        }
        if self.from.is_none() && self.to.is_none() {
            return Err(Problem::query("from", "missing", all));
        }
        if let (Some(from), Some(to)) = (self.from, self.to)
            && to <= from
        {
            return Err(Problem::query("to", to, &format!("a time after {from}")));
        }
        Ok(vec![RecordRange { channel: self.channel, from: self.from, to: self.to, raw_sha256: None }])
    }
}

/// The number of deleted records.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Deleted {
    /// Deleted records of the asset.
    deleted: u64,
}

/// Delete segments by time range or id
///
/// Applies to each as `DELETE /v1/segments/{segment}`.
#[utoipa::path(
    delete,
    path = "/v1/assets/{asset}/segments",
    tag = "records",
    params(RangeParameters),
    responses(
        (status = 200, body = Deleted),
        (status = 422, description = "A time out of range"),
        (status = 409, description = "The records belong to another asset with the same sensor"),
    ),
)]
pub(super) async fn remove_range(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<RangeParameters>,
    caller: Option<Extension<Caller>>,
) -> Result<Json<Deleted>, Problem> {
    let all = "at least one of from, to and ids; to delete all records, delete the asset";
    let ranges = params.ranges(&app, &asset, all).await?;
    tracing::info!(%asset, by = by(caller.as_deref()), "removing records");
    let deleted = app.service.removals.remove_each(&asset, &ranges).await?;
    Ok(Json(Deleted { deleted }))
}

/// Returns the segment, or a problem if it does not exist.
pub(super) async fn find(app: &App, id: &SegmentId) -> Result<Segment, Problem> {
    let segment = app.service.store.segment(id).await?;
    segment.ok_or_else(|| Problem::not_found(format!("segment \"{id}\" not found")))
}
