//! `/v1/assets/{asset}/segments` and `/v1/segments/{segment}`.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::IntoResponse;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::app::App;
use super::chosen;
use super::problem::{Details, Problem};
use super::query::{self, AssetInPath, Page, Parameters, SegmentInPath};
use super::record_choice::{self, RecordChoice};
use crate::asset::{AssetId, AssetSpec, RawReference, Segment, SegmentId, VelocityZone};
use crate::estimate::WearEstimate;
use crate::signal::{Basis, Indicators, OperatingPoint, ShaftSpeed};
use crate::store::{Order, RecordRange, SegmentFilter, SegmentKey};

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
    /// Only records in this one of the asset's operating bins.
    operating_bin: Option<String>,
    /// Only records whose estimate has one of these statuses, with commas between them.
    #[param(example = "estimated,excluded")]
    status: Option<String>,
    /// Entries of the page: 1 to 1000, 100 where not given.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the page before.
    cursor: Option<String>,
    /// `asc`: the earliest first; `desc`: the latest first.
    #[serde(default)]
    #[param(inline, required = false)]
    order: Order,
}

/// A segment as lists show it: without features and posterior.
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
    /// When the service took it.
    received_at: Timestamp,
    /// Sampling rate in hertz.
    sample_rate_hz: f64,
    /// Number of samples.
    samples: u64,
    /// Unit of the samples.
    unit: String,
    /// Operating point as given with the record.
    operating_point: OperatingPoint,
    /// Shaft speed that was used, and where it came from.
    shaft_speed: Option<ShaftSpeed>,
    /// Wear depth in µm known from elsewhere.
    #[serde(skip_serializing_if = "Option::is_none")]
    reference_wear_um: Option<f64>,
    /// Where the raw bytes are.
    raw: RawReference,
    /// People excluded it: it takes no part in the baseline, the estimate and the alarms.
    excluded: bool,
    #[serde(flatten)]
    basis: Basis,
    #[serde(flatten)]
    indicators: Indicators,
    /// The zone of ISO 20816 that `velocity_rms` lies in, where the asset has zones.
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

/// Segments of an asset in the order of time
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/segments",
    tag = "records",
    params(("asset" = AssetId, Path, description = "The asset"), ListParameters),
    responses((status = 422, description = "A time out of range", body = Details, content_type = "application/problem+json"), (status = 200, body = Page<SegmentRow>)),
)]
pub(super) async fn list(
    State(app): State<App>,
    AssetInPath(asset): AssetInPath,
    Parameters(asked): Parameters<ListParameters>,
) -> Result<impl IntoResponse, Problem> {
    let limit = query::limit(asked.limit)?;
    let filter = SegmentFilter {
        channel: asked.channel,
        from: asked.from,
        to: asked.to,
        after: query::segment_cursor(asked.cursor.as_deref())?,
        order: asked.order,
    };
    let store = &app.service.store;
    let spec = store.asset(&asset).await?.spec;
    let choice = RecordChoice {
        bin: chosen::asked_bin(&spec, asked.operating_bin.as_deref())?,
        statuses: record_choice::asked_statuses(asked.status.as_deref())?,
    };
    let segments = match choice.is_all() {
        true => store.segments(&asset, &filter, limit + 1).await?,
        false => choice.segments(store, &asset, &filter, limit as usize + 1).await?,
    };
    let page = Page::new(segments, limit, |segment: &Segment| {
        query::cursor_of(&SegmentKey { start_time: segment.start_time, id: segment.id.clone() })
    });
    Ok(Json(page.map(|segment| SegmentRow::of(segment, &spec))))
}

/// A segment, whole, and what the asset's description says of it.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct SegmentView {
    #[serde(flatten)]
    segment: Segment,
    /// The zone of ISO 20816 that `velocity_rms` lies in, where the asset has zones.
    #[serde(skip_serializing_if = "Option::is_none")]
    velocity_zone: Option<VelocityZone>,
}

/// One segment, whole
#[utoipa::path(
    get,
    path = "/v1/segments/{segment}",
    tag = "records",
    params(("segment" = String, Path, description = "The segment")),
    responses((status = 200, body = SegmentView)),
)]
pub(super) async fn show(
    State(app): State<App>,
    SegmentInPath(id): SegmentInPath,
) -> Result<Json<SegmentView>, Problem> {
    let segment = find(&app, &id).await?;
    let spec = app.service.store.asset(&segment.asset_id).await?.spec;
    let velocity_zone = spec.velocity_zone(&segment.indicators);
    Ok(Json(SegmentView { segment, velocity_zone }))
}

/// Delete one segment
///
/// It is as if its record had never come, also for the other assets of its sensor: the histories that it was
/// part of are estimated anew in the background. Its raw recording goes into quarantine. Sent again it is
/// stored again.
#[utoipa::path(
    delete,
    path = "/v1/segments/{segment}",
    tag = "records",
    params(("segment" = String, Path, description = "The segment")),
    responses((status = 204, description = "Gone"), (status = 409, body = Details, content_type = "application/problem+json", description = "It came for another asset, whose sensor this one shares")),
)]
pub(super) async fn remove(
    State(app): State<App>,
    SegmentInPath(id): SegmentInPath,
) -> Result<StatusCode, Problem> {
    let segment = find(&app, &id).await?;
    app.service.removals.remove_one(&segment).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Which records; `ids`, or at least one of `from` and `to`, is needed.
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
    /// These records in place of a range: identifiers with commas between them, at most 200.
    ids: Option<String>,
}

impl RangeParameters {
    /// The range, or one for each of the records that are named; `all` says what to do in place of a range
    /// without bounds.
    pub(super) async fn ranges(
        self,
        app: &App,
        asset: &AssetId,
        all: &'static str,
    ) -> Result<Vec<RecordRange>, Problem> {
        if let Some(ids) = &self.ids {
            if self.channel.is_some() || self.from.is_some() || self.to.is_some() {
                return Err(Problem::query("ids", "given", "either ids, or channel, from and to"));
            }
            return record_choice::named(&app.service.store, asset, ids).await;
        }
        if self.from.is_none() && self.to.is_none() {
            return Err(Problem::query("from", "missing", all));
        }
        Ok(vec![RecordRange { channel: self.channel, from: self.from, to: self.to, raw_sha256: None }])
    }
}

/// How many records were deleted.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Deleted {
    /// Records of the asset.
    deleted: u64,
}

/// Delete the segments of a range of time, or those that are named
///
/// As each of them by itself.
#[utoipa::path(
    delete,
    path = "/v1/assets/{asset}/segments",
    tag = "records",
    params(("asset" = AssetId, Path, description = "The asset"), RangeParameters),
    responses((status = 200, body = Deleted), (status = 422, description = "A time out of range", body = Details, content_type = "application/problem+json"), (status = 409, body = Details, content_type = "application/problem+json", description = "They come for another asset, whose sensor this one shares")),
)]
pub(super) async fn remove_range(
    State(app): State<App>,
    AssetInPath(asset): AssetInPath,
    Parameters(asked): Parameters<RangeParameters>,
) -> Result<Json<Deleted>, Problem> {
    let all = "a time here or in to, or ids: delete the asset to delete all";
    let ranges = asked.ranges(&app, &asset, all).await?;
    let deleted = app.service.removals.remove_each(&asset, &ranges).await?;
    Ok(Json(Deleted { deleted }))
}

/// The segment, or the problem that there is none.
pub(super) async fn find(app: &App, id: &SegmentId) -> Result<Segment, Problem> {
    let segment = app.service.store.segment(id).await?;
    segment.ok_or_else(|| Problem::not_found(format!("there is no segment {id}")))
}
