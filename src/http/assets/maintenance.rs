//! `/v1/assets/{asset}/maintenance`: maintenance events of a machine.

use axum::Json;
use axum::extract::{FromRequestParts, Path, State};
use axum::http::request::Parts;
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::asset::AssetId;
use crate::estimate::{Inspection, MaintenanceEvent, MaintenanceKind};
use crate::http::alarms::check_signature;
use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::request::body::Described;
use crate::http::request::query::{self, AssetInPath, Page, PageParameters, Parameters};
use crate::store::StoredEvent;

/// A maintenance event to add.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Done {
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
}

impl EventView {
    /// An event of an asset.
    pub(crate) fn new(asset_id: AssetId, stored: StoredEvent) -> Self {
        let StoredEvent { id, event } = stored;
        Self { id, asset_id, event }
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
    request_body(content = Done),
    responses((status = 201, body = EventView, headers(("location" = String, description = "Its address")))),
)]
pub(crate) async fn add(
    State(app): State<App>,
    AssetInPath(asset): AssetInPath,
    Described(done): Described<Done>,
) -> Result<impl IntoResponse, Problem> {
    let Done { time, kind, by, comment, inspection, until } = done;
    check_signature(&by, &comment)?;
    let time = time.unwrap_or_else(|| app.service.now());
    check_inspection(kind, inspection.as_ref())?;
    check_until(kind, time, until)?;
    let event = MaintenanceEvent { time, kind, by, comment, inspection, until };
    let stored = app.service.maintenance.add(&asset, event).await?;
    let location = format!("/v1/assets/{asset}/maintenance/{}", stored.id);
    let view = EventView::new(asset, stored);
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
    AssetInPath(asset): AssetInPath,
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
    responses((status = 204, description = "Gone")),
)]
pub(crate) async fn remove(
    State(app): State<App>,
    EventInPath { asset, event }: EventInPath,
) -> Result<StatusCode, Problem> {
    app.service.maintenance.remove(&asset, &event).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// An asset and one of its events in the path.
pub(crate) struct EventInPath {
    asset: AssetId,
    event: String,
}

impl<S: Send + Sync> FromRequestParts<S> for EventInPath {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let parsed = Path::<(String, String)>::from_request_parts(parts, state).await;
        let Path((asset, event)) = parsed.map_err(|rejection| Problem::not_found(rejection.body_text()))?;
        Ok(Self { asset: query::asset_id(asset)?, event })
    }
}

/// Rejects a chosen baseline without an end, and an end for any other kind.
fn check_until(kind: MaintenanceKind, time: Timestamp, until: Option<Timestamp>) -> Result<(), Problem> {
    let refused = |detail: String| Err(Problem::new(StatusCode::BAD_REQUEST, detail));
    match (kind, until) {
        (MaintenanceKind::BaselineChosen, None) => {
            refused("until is missing, expected the end of the baseline for the kind baseline_chosen".into())
        }
        (MaintenanceKind::BaselineChosen, Some(until)) if until <= time => {
            refused(format!("until is {until}, expected a time after {time}"))
        }
        (MaintenanceKind::BaselineChosen, Some(_)) | (_, None) => Ok(()),
        (_, Some(until)) => {
            refused(format!("until is {until}, expected it only for the kind baseline_chosen"))
        }
    }
}

/// Rejects an inspection without a measurement, and a measurement for any other kind.
fn check_inspection(kind: MaintenanceKind, inspection: Option<&Inspection>) -> Result<(), Problem> {
    let refused = |detail: String| Err(Problem::new(StatusCode::BAD_REQUEST, detail));
    match (kind, inspection) {
        (MaintenanceKind::Inspected, None) => {
            refused("inspection is missing, expected its depth_um for the kind inspected".into())
        }
        (MaintenanceKind::Inspected, Some(inspection)) => match inspection.fault() {
            Some((field, value, expected)) => refused(format!("{field} is {value}, expected {expected}")),
            None => Ok(()),
        },
        (_, Some(_)) => refused("inspection is given, expected it only for the kind inspected".into()),
        (_, None) => Ok(()),
    }
}
