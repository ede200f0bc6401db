//! `GET /v1/events`: events as they happen, as server-sent events.
//!
//! A client that lost its connection receives what it missed, or an event `lost` if that is no longer kept.

pub(super) mod ring;

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::Extension;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures_util::stream::unfold;
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::sync::watch;

use super::access::TokenWatch;
use super::access::client::{Client, ClientPermit};
use super::access::session::Caller;
use super::alarms::AlarmView;
use super::app::App;
use super::assets::maintenance::EventView;
use super::problem::Problem;
use super::request::query::Parameters;
use super::server::connections::closing;
use crate::asset::AssetId;
use crate::service::{LiveEvent, SegmentRef};
use crate::store::AlarmNotice;
use ring::{EventRing, Next, Position};

/// Interval of keep-alive comments on a quiet connection.
const KEEP_ALIVE: Duration = Duration::from_secs(15);

/// The name of an event, and its data.
fn name_and_data(event: &LiveEvent) -> (&'static str, Value) {
    let of_segment = |segment: &SegmentRef, name: &str, value: Value| {
        let mut data = json!(segment);
        data[name] = value;
        data
    };
    match event {
        LiveEvent::AssetChanged(id) => ("asset", json!({ "asset_id": id, "change": "changed" })),
        LiveEvent::AssetRemoved(id) => ("asset", json!({ "asset_id": id, "change": "removed" })),
        LiveEvent::Indicators(segment, indicators) => {
            ("indicators", of_segment(segment, "indicators", json!(indicators.values)))
        }
        LiveEvent::Wear(segment, wear) => ("wear", of_segment(segment, "wear", json!(wear))),
        LiveEvent::HistoryFolded { asset, channel } => {
            ("history", json!({ "asset_id": asset, "channel": channel }))
        }
        LiveEvent::RecomputationChanged(recomputation) => ("recomputation", json!(recomputation)),
        LiveEvent::AlarmChanged(notice) => {
            let AlarmNotice { alarm, change } = &**notice;
            let view = AlarmView::new(alarm.clone(), change.time);
            ("alarm", json!({ "asset_id": alarm.asset_id, "alarm": view, "change": change }))
        }
        LiveEvent::MaintenanceChanged { asset, event, is_removed } => {
            let change = if *is_removed { "removed" } else { "added" };
            let event = EventView::new(asset.clone(), event.clone());
            ("maintenance", json!({ "asset_id": asset, "event": event, "change": change }))
        }
        LiveEvent::ReplayChanged(replay) => ("replay", json!(replay)),
        LiveEvent::Lost(count) => ("lost", json!({ "events": count })),
    }
}

fn server_event(id: String, event: &LiveEvent) -> Event {
    let (name, data) = name_and_data(event);
    Event::default().event(name).id(id).data(data.to_string())
}

/// One server-sent event.
#[derive(utoipa::ToSchema)]
#[expect(dead_code, reason = "describes what axum writes")]
struct ServerEvent {
    /// The kind of event.
    event: String,
    /// The value for `Last-Event-ID`.
    id: String,
    /// JSON: `asset_id` and the details.
    data: String,
}

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct EventParameters {
    /// Only events of this asset.
    #[param(value_type = Option<String>)]
    asset: Option<AssetId>,
}

/// Live events
///
/// Events `indicators`, `wear`, `history`, `asset`, `recomputation`, `replay`, `alarm` and `maintenance` with
/// JSON data. With `Last-Event-ID`, missed events come first. An event `lost` means that some were dropped:
/// reload the lists.
#[utoipa::path(
    get,
    path = "/v1/events",
    tag = "service",
    params(
        EventParameters,
        ("last-event-id" = Option<String>, Header, description = "The id of the last event received"),
    ),
    responses(
        (status = 200, body = ServerEvent, content_type = "text/event-stream"),
        (status = 404, description = "The asset does not exist"),
        (status = 503, description = "Too many streams are open"),
    ),
)]
pub(super) async fn stream(
    State(app): State<App>,
    Parameters(params): Parameters<EventParameters>,
    client: Client,
    caller: Option<Extension<Caller>>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    if let Some(asset) = &params.asset {
        app.service.store.asset(asset).await?;
    }
    let Some(permit) = app.event_stream_limiter.try_acquire(client) else {
        return Ok(too_many());
    };
    let last = headers.get("last-event-id").and_then(|last| last.to_str().ok());
    let token = TokenWatch::new(Arc::clone(&app.access), caller.map(|Extension(caller)| caller));
    let subscriber = EventSubscriber::new(app.events, params.asset, token, last, permit);
    let stream = unfold(subscriber, async |mut subscriber| {
        let event = subscriber.next().await?;
        Some((Ok::<_, Infallible>(event), subscriber))
    });
    Ok(Sse::new(stream).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response())
}

/// The response when no further event stream is accepted: the connection would stay idle while others need
/// its place.
pub(super) fn too_many() -> Response {
    let busy = Problem::busy("too many event streams of this client or in total", 30);
    closing(busy.into_response())
}

/// A client of the event stream.
struct EventSubscriber {
    events: Arc<EventRing>,
    asset: Option<AssetId>,
    token: TokenWatch,
    position: Position,
    latest: watch::Receiver<u64>,
    over: watch::Receiver<bool>,
    _permit: ClientPermit,
}

impl EventSubscriber {
    fn new(
        events: Arc<EventRing>,
        asset: Option<AssetId>,
        token: TokenWatch,
        last: Option<&str>,
        permit: ClientPermit,
    ) -> Self {
        let (latest, over) = events.subscribe();
        Self {
            // Without a position, the stream starts now
            position: last.map_or_else(|| events.end_position(), |last| events.position(last)),
            events,
            asset,
            token,
            latest,
            over,
            _permit: permit,
        }
    }

    /// Returns the next event; `None` at the end of the service or when the token was revoked.
    async fn next(&mut self) -> Option<Event> {
        loop {
            if self.token.is_revoked().await {
                return None;
            }
            // Subscribed before reading the ring, so that no event is missed in between.
            self.latest.mark_unchanged();
            match self.events.next(&mut self.position, self.asset.as_ref()) {
                Next::Event(event) => return Some(server_event(self.position.id(), &event.event)),
                Next::Lost(count) => {
                    let lost = Event::default().event("lost").id(self.position.id());
                    return Some(lost.data(json!({ "events": count }).to_string()));
                }
                Next::Nothing => {}
            }
            tokio::select! {
                _ = self.over.wait_for(|over| *over) => return None,
                changed = self.latest.changed() => changed.ok()?,
                () = self.token.due() => {}
            }
        }
    }
}
