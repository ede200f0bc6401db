//! `/v1/assets/{asset}/maintenance`: maintenance events of a machine.

use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::asset::AssetId;
use crate::estimate::{Inspection, MaintenanceEvent, MaintenanceKind};
use crate::http::alarms::check_signature;
use crate::http::app::App;
use crate::http::baseline;
use crate::http::problem::Problem;
use crate::http::request::body::JsonBody;
use crate::http::request::query::{self, AssetPath, Page, PageParameters, Parameters};
use crate::store::StoredEvent;

/// A maintenance event to add.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct MaintenanceRequest {
    /// Time; default now.
    #[serde(default)]
    #[schema(example = "2026-03-01T08:00:00Z")]
    time: Option<Timestamp>,
    /// Kind of maintenance.
    #[schema(example = "gear_replaced")]
    kind: MaintenanceKind,
    /// Name of the person: 1 to 200 characters.
    #[schema(example = "Ada")]
    by: String,
    /// Comment: at most 2000 characters.
    #[serde(default)]
    #[schema(example = "new pair, same drawing")]
    comment: String,
    /// The measurement, for the kind `inspected`.
    #[serde(default)]
    inspection: Option<Inspection>,
    /// The end of the baseline (exclusive), for the kind `baseline_chosen`.
    #[serde(default)]
    until: Option<Timestamp>,
}

/// A maintenance event.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = StoredMaintenanceEvent)]
pub(crate) struct EventView {
    /// Identifier in its asset.
    id: String,
    /// The asset.
    asset_id: AssetId,
    #[serde(flatten)]
    event: MaintenanceEvent,
    /// Number of records in a chosen baseline, of the channel with the most; only when it is added.
    #[serde(skip_serializing_if = "Option::is_none")]
    records: Option<usize>,
}

impl EventView {
    /// An event of an asset.
    pub(crate) fn new(asset_id: AssetId, stored: StoredEvent) -> Self {
        let StoredEvent { id, event } = stored;
        Self { id, asset_id, event, records: None }
    }
}

/// Add a maintenance event
///
/// It takes effect from the first record at or after its time. If there are such records, the history is
/// recomputed in the background. Sending the same event again returns the first response.
#[utoipa::path(
    post,
    path = "/v1/assets/{asset}/maintenance",
    tag = "assets",
    request_body(content = MaintenanceRequest),
    responses((status = 201, body = EventView, headers(("location" = String, description = "Its address")))),
)]
pub(crate) async fn add(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    JsonBody(request): JsonBody<MaintenanceRequest>,
) -> Result<impl IntoResponse, Problem> {
    let MaintenanceRequest { time, kind, by, comment, inspection, until } = request;
    check_signature(&by, &comment)?;
    let time = time.unwrap_or_else(|| app.service.now());
    check_inspection(kind, inspection.as_ref())?;
    check_until(kind, time, until)?;
    let event = MaintenanceEvent { time, kind, by, comment, inspection, until };
    let stored = app.service.maintenance.add(&asset, event).await?;
    let location = format!("/v1/assets/{asset}/maintenance/{}", stored.id);
    let records = match stored.event.until {
        Some(until) => Some(baseline::records_between(&app.service.store, &asset, time, until).await?),
        None => None,
    };
    let view = EventView { records, ..EventView::new(asset, stored) };
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], Json(view)))
}

/// List maintenance events of an asset
///
/// Newest first.
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/maintenance",
    tag = "assets",
    params(PageParameters),
    responses((status = 200, body = Page<EventView>)),
)]
pub(crate) async fn list(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<PageParameters>,
) -> Result<Json<Page<EventView>>, Problem> {
    let limit = query::limit(params.limit)?;
    let after = query::place_cursor(params.cursor.as_deref())?;
    let store = &app.service.store;
    store.asset(&asset).await?;
    let events = store.latest_maintenance(&asset, after.as_ref(), limit + 1).await?;
    let page =
        Page::new(events, limit, |stored: &StoredEvent| query::cursor_at(stored.event.time, &stored.id));
    Ok(Json(page.map(|stored| EventView::new(asset.clone(), stored))))
}

/// Delete a maintenance event
///
/// The history is recomputed without it.
#[utoipa::path(
    delete,
    path = "/v1/assets/{asset}/maintenance/{event}",
    tag = "assets",
    responses((status = 204, description = "Deleted")),
)]
pub(crate) async fn remove(
    State(app): State<App>,
    path: Result<Path<(String, String)>, PathRejection>,
) -> Result<StatusCode, Problem> {
    let Path((asset, event)) = path.map_err(|rejection| Problem::not_found(rejection.body_text()))?;
    app.service.maintenance.remove(&query::asset_id(asset)?, &event).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Rejects a chosen baseline without an end, and an end for any other kind.
fn check_until(kind: MaintenanceKind, time: Timestamp, until: Option<Timestamp>) -> Result<(), Problem> {
    match (kind, until) {
        (MaintenanceKind::BaselineChosen, None) => {
            let expected = "the end of the baseline for the kind baseline_chosen";
            Err(Problem::content("until", "missing", expected))
        }
        (MaintenanceKind::BaselineChosen, Some(until)) if until <= time => {
            Err(Problem::content("until", until, &format!("a time after {time}")))
        }
        (MaintenanceKind::BaselineChosen, Some(_)) | (_, None) => Ok(()),
        (_, Some(until)) => {
            Err(Problem::content("until", until, "no value unless the kind is baseline_chosen"))
        }
    }
}

/// Rejects an inspection without a measurement, and a measurement for any other kind.
fn check_inspection(kind: MaintenanceKind, inspection: Option<&Inspection>) -> Result<(), Problem> {
    let (field, value, expected) = match (kind, inspection) {
        (MaintenanceKind::Inspected, Some(inspection)) => match inspection.fault() {
            Some(fault) => fault,
            None => return Ok(()),
        },
        (MaintenanceKind::Inspected, None) => {
            ("inspection", "missing".to_owned(), "its depth_um for the kind inspected")
        }
        (_, Some(_)) => ("inspection", "given".to_owned(), "no value unless the kind is inspected"),
        (_, None) => return Ok(()),
    };
    Err(Problem::content(field, value, expected))
}
