//! Uploads, `/v1/assets/{asset}/segments` and `/v1/segments/{segment}`.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::body::{self, SpooledBody};
use super::problem::Problem;
use super::query::{self, AssetInPath, Page, Parameters, SegmentInPath};
use super::router::App;
use crate::asset::{AssetId, RawReference, Segment, SegmentId};
use crate::estimate::WearEstimate;
use crate::ingest::{BatchSummary, Given, RecordFormat};
use crate::signal::{Indicators, OperatingPoint, ShaftSpeed};
use crate::store::{Order, SegmentFilter, SegmentKey};

const MCAP: &str = "application/mcap";

/// What an upload says of the record in its address.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct UploadParameters {
    start_time: Option<Timestamp>,
    shaft_speed_hz: Option<f64>,
    torque_nm: Option<f64>,
    channel: Option<String>,
    unit: Option<String>,
    reference_wear_um: Option<f64>,
}

pub(super) async fn upload(
    State(app): State<App>,
    AssetInPath(asset): AssetInPath,
    Parameters(asked): Parameters<UploadParameters>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    // Before the body is read: an upload to nowhere, or to a full queue, costs nothing.
    app.ingest.store().asset(&asset).await?;
    let media_type = body::media_type(&headers);
    if media_type.as_deref() == Some(MCAP) {
        return upload_mcap(&app, &asset, &asked, &headers, body).await;
    }
    let format = media_type.as_deref().and_then(RecordFormat::from_media_type).ok_or_else(|| {
        let expected = "audio/wav, application/x-protobuf, application/json or application/mcap";
        body::unsupported(media_type.as_deref(), expected)
    })?;
    let mut ticket = app.ingest.workers().admit()?;
    let bytes = body::read(&headers, body, app.limits.record_bytes, &app.limits, |bytes| {
        ticket.grow(bytes).map_err(Problem::from)
    })
    .await?;
    let mut segments = app.ingest.accept(&asset, format, bytes, asked.given(), ticket).await?;
    if segments.len() == 1
        && let Some(segment) = segments.pop()
    {
        return Ok((StatusCode::CREATED, Json(segment)).into_response());
    }
    Ok((StatusCode::CREATED, Json(serde_json::json!({ "segments": segments }))).into_response())
}

impl UploadParameters {
    fn given(self) -> Given {
        Given {
            start_time: self.start_time,
            channel: self.channel,
            unit: self.unit,
            operating_point: OperatingPoint {
                shaft_speed_hz: self.shaft_speed_hz,
                torque_nm: self.torque_nm,
            },
            reference_wear_um: self.reference_wear_um,
        }
    }

    fn any(&self) -> Option<&'static str> {
        [
            ("start_time", self.start_time.is_some()),
            ("shaft_speed_hz", self.shaft_speed_hz.is_some()),
            ("torque_nm", self.torque_nm.is_some()),
            ("channel", self.channel.is_some()),
            ("unit", self.unit.is_some()),
            ("reference_wear_um", self.reference_wear_um.is_some()),
        ]
        .into_iter()
        .find_map(|(name, is_given)| is_given.then_some(name))
    }
}

/// The answer to a recording of many records.
#[derive(Debug, Serialize)]
struct McapAnswer {
    #[serde(flatten)]
    summary: BatchSummary,
    wear: Option<WearEstimate>,
}

async fn upload_mcap(app: &App, asset: &AssetId, asked: &UploadParameters, headers: &HeaderMap, body: Body) -> Result<Response, Problem> {
    if let Some(name) = asked.any() {
        return Err(Problem::query(
            name,
            "given",
            "nothing: an MCAP file says it for each of its records",
        ));
    }
    let ticket = app.ingest.workers().admit()?;
    let spooled = SpooledBody::receive(headers, body, &app.uploads, &app.limits).await?;
    let (ingest, of) = (app.ingest.clone(), asset.clone());
    // A client that hangs up must not leave half of the work: it goes on by itself.
    let task = tokio::spawn(async move {
        let _ticket = ticket;
        let summary = ingest.accept_mcap(&of, spooled.path()).await;
        drop(spooled);
        summary
    });
    let summary = task
        .await
        .map_err(|_| crate::ingest::IngestError::WorkerLost("read a recording"))??;
    let (_, channel) = super::assets::asset_and_channel(app, asset, None).await?;
    let wear = match channel.and_then(|channel| channel.last_segment) {
        Some(id) => app.ingest.store().segment(&id).await?.map(|segment| segment.wear),
        None => None,
    };
    Ok((StatusCode::CREATED, Json(McapAnswer { summary, wear })).into_response())
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ListParameters {
    channel: Option<String>,
    from: Option<Timestamp>,
    to: Option<Timestamp>,
    limit: Option<u32>,
    cursor: Option<String>,
    #[serde(default)]
    order: Order,
}

/// A segment as lists show it: without features and posterior.
#[derive(Debug, Serialize)]
struct SegmentRow {
    id: SegmentId,
    asset_id: AssetId,
    channel: String,
    start_time: Timestamp,
    received_at: Timestamp,
    sample_rate_hz: f64,
    samples: u64,
    unit: String,
    operating_point: OperatingPoint,
    shaft_speed: Option<ShaftSpeed>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reference_wear_um: Option<f64>,
    raw: RawReference,
    #[serde(flatten)]
    indicators: Indicators,
    wear: WearEstimate,
}

impl From<Segment> for SegmentRow {
    fn from(segment: Segment) -> Self {
        Self {
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
            indicators: segment.indicators,
            wear: WearEstimate {
                posterior: None,
                ..segment.wear
            },
        }
    }
}

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
    app.ingest.store().asset(&asset).await?;
    let segments = app.ingest.store().segments(&asset, &filter, limit + 1).await?;
    let page = Page::new(segments, limit, |segment: &Segment| {
        query::cursor_of(&SegmentKey {
            start_time: segment.start_time,
            id: segment.id.clone(),
        })
    });
    Ok(Json(page.map(SegmentRow::from)))
}

pub(super) async fn show(State(app): State<App>, SegmentInPath(id): SegmentInPath) -> Result<Json<Segment>, Problem> {
    Ok(Json(find(&app, &id).await?))
}

/// The segment, or the problem that there is none.
pub(super) async fn find(app: &App, id: &SegmentId) -> Result<Segment, Problem> {
    let segment = app.ingest.store().segment(id).await?;
    segment.ok_or_else(|| Problem::not_found(format!("there is no segment {id}")))
}
