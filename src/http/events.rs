//! `GET /v1/events`: what happens, as server-sent events.
//!
//! A client that lost its connection gets what it missed; one that missed more than is kept gets an event
//! `lost`.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::sse::{Event, KeepAlive, Sse};
use futures_util::Stream;
use futures_util::stream::unfold;
use serde::Deserialize;
use serde_json::{Value, json};

use super::alarms::AlarmView;
use super::app::App;
use super::event_ring::{EventRing, Next};
use super::maintenance::EventView;
use super::problem::Problem;
use super::query::Parameters;
use crate::asset::AssetId;
use crate::service::{LiveEvent, NumberedEvent, SegmentPlace};
use crate::store::AlarmNotice;

/// How often a quiet connection is kept from being taken for dead.
const KEEP_ALIVE: Duration = Duration::from_secs(15);

/// The name of an event, and its data.
fn named(event: &LiveEvent) -> (&'static str, Value) {
    let of_segment = |place: &SegmentPlace, name: &str, value: Value| {
        let mut data = json!(place);
        data[name] = value;
        data
    };
    match event {
        LiveEvent::AssetChanged(id) => ("asset", json!({ "asset_id": id, "change": "changed" })),
        LiveEvent::AssetRemoved(id) => ("asset", json!({ "asset_id": id, "change": "removed" })),
        LiveEvent::Indicators(place, indicators) => ("indicators", of_segment(place, "indicators", json!(indicators.values))),
        LiveEvent::Wear(place, wear) => ("wear", of_segment(place, "wear", json!(wear))),
        LiveEvent::HistoryFolded { asset, channel } => ("history", json!({ "asset_id": asset, "channel": channel })),
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

fn server_event(events: &EventRing, NumberedEvent { number, event }: &NumberedEvent) -> Event {
    let (name, data) = named(event);
    Event::default().event(name).id(events.id(*number)).data(data.to_string())
}

/// One event as it comes over the stream.
#[derive(utoipa::ToSchema)]
#[expect(dead_code, reason = "describes what axum writes")]
struct ServerEvent {
    /// What kind of event it is.
    event: String,
    /// What `Last-Event-ID` begins after.
    id: String,
    /// JSON: `asset_id` and what happened to it.
    data: String,
}

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct EventParameters {
    /// Only what concerns this asset.
    #[param(value_type = Option<String>)]
    asset: Option<AssetId>,
}

/// What happens, live
///
/// Events `indicators`, `wear`, `history`, `asset`, `recomputation`, `replay`, `alarm` and `maintenance` with
/// JSON data; after `Last-Event-ID` first what was missed. An event `lost` says that some are not kept any
/// more: then the lists have to be read again.
#[utoipa::path(
    get,
    path = "/v1/events",
    tag = "service",
    params(
        EventParameters,
        ("last-event-id" = Option<String>, Header, description = "The id of the last event seen"),
    ),
    responses((status = 200, body = ServerEvent, content_type = "text/event-stream")),
)]
pub(super) async fn stream(
    State(app): State<App>,
    Parameters(asked): Parameters<EventParameters>,
    headers: HeaderMap,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Problem> {
    if let Some(asset) = &asked.asset {
        app.service.store.asset(asset).await?;
    }
    let events = Arc::clone(&app.events);
    let (latest, over) = events.subscribe();
    let last = headers.get("last-event-id").and_then(|last| last.to_str().ok());
    let known = last.map(|last| events.position(last));
    // Without a position of this run it begins with what happens now; a client that had one is told that it
    // missed something.
    let position = known.flatten().unwrap_or_else(|| events.end_position());
    let restarted = matches!(known, Some(None));
    let from = (events, latest, over, position, restarted);
    let stream = unfold(from, move |(events, mut latest, mut over, mut position, restarted)| {
        let asset = asked.asset.clone();
        async move {
            if restarted {
                let event = Event::default().event("lost").id(events.id(position)).data("{\"events\":null}");
                return Some((Ok(event), (events, latest, over, position, false)));
            }
            loop {
                // Seen before it is looked for, so that nothing slips in between.
                latest.mark_unchanged();
                let event = match events.next(&mut position, asset.as_ref()) {
                    Next::Event(event) => server_event(&events, &event),
                    Next::Lost(count) => Event::default()
                        .event("lost")
                        .id(events.id(position))
                        .data(json!({ "events": count }).to_string()),
                    Next::Nothing => {
                        tokio::select! {
                            _ = over.wait_for(|over| *over) => return None,
                            changed = latest.changed() => changed.ok()?,
                        }
                        continue;
                    }
                };
                return Some((Ok(event), (events, latest, over, position, false)));
            }
        }
    });
    Ok(Sse::new(stream).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)))
}
