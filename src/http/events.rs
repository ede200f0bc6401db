//! `GET /v1/events`: what happens, as server-sent events.
//!
//! The latest events are kept in a ring, so that a client that lost its connection gets what it missed; one that missed more than
//! is kept is told so.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::sse::{Event, KeepAlive, Sse};
use futures_util::Stream;
use futures_util::stream::unfold;
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{mpsc, watch};

use super::alarms::AlarmView;
use super::maintenance::EventView;
use super::problem::Problem;
use super::query::Parameters;
use super::router::App;
use crate::asset::AssetId;
use crate::estimate::WearEstimate;
use crate::ingest::{Announcement, Ingest, LiveEvent, NumberedEvent};
use crate::store::{AlarmNotice, StoredEvent};

/// The kind of events about recomputations.
const RECOMPUTATION: &str = "recomputation";

/// Events that another node may have shown before they came here.
const AHEAD: u64 = 1000;

/// How often a quiet connection is kept from being taken for dead.
const KEEP_ALIVE: Duration = Duration::from_secs(15);

/// The events of all nodes of a cluster, in one order.
#[derive(Debug)]
pub struct SharedEvents {
    /// Tells this order from others in identifiers.
    pub run: String,
    /// What happened before.
    pub backlog: Vec<NumberedEvent>,
    /// What happens from then on.
    pub receiver: mpsc::Receiver<NumberedEvent>,
}

/// The latest events.
#[derive(Debug)]
pub(super) struct Events {
    /// Tells this run of the service from others in identifiers.
    run: String,
    most: usize,
    /// Events that a client may have seen at another node before they came here.
    ahead: u64,
    held: Mutex<Held>,
    /// The number of the latest event; closed at the end of the service.
    latest: watch::Sender<u64>,
    is_over: watch::Sender<bool>,
}

#[derive(Debug, Default)]
struct Held {
    given_out: u64,
    kept: VecDeque<Arc<NumberedEvent>>,
}

impl Events {
    /// Follows announcements; `run` must differ between runs of the service.
    pub(super) fn follow(mut announcements: Receiver<Announcement>, run: String, most: usize) -> Arc<Self> {
        let events = Arc::new(Self {
            run,
            most: most.max(1),
            ahead: 0,
            held: Mutex::default(),
            latest: watch::Sender::new(0),
            is_over: watch::Sender::new(false),
        });
        let followed = Arc::clone(&events);
        tokio::spawn(async move {
            loop {
                match announcements.recv().await {
                    Ok(announcement) => live_events(&announcement).into_iter().for_each(|event| followed.add(event)),
                    Err(RecvError::Lagged(count)) => followed.add(lost_events(count)),
                    Err(RecvError::Closed) => break,
                }
            }
        });
        events
    }

    /// Shows what all nodes show; `ingest` is told of what other processes do.
    pub(super) fn share(shared: SharedEvents, ingest: Ingest, most: usize) -> Arc<Self> {
        let SharedEvents {
            run,
            backlog,
            mut receiver,
        } = shared;
        let events = Arc::new(Self {
            run,
            most: most.max(1),
            ahead: AHEAD,
            held: Mutex::default(),
            latest: watch::Sender::new(0),
            is_over: watch::Sender::new(false),
        });
        for event in backlog {
            note(&ingest, &event.event);
            events.keep(event);
        }
        let followed = Arc::clone(&events);
        tokio::spawn(async move {
            while let Some(event) = receiver.recv().await {
                note(&ingest, &event.event);
                followed.keep(event);
            }
        });
        events
    }

    /// Ends all streams.
    pub(super) fn end(&self) {
        self.is_over.send_replace(true);
    }

    fn lock(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn add(&self, event: LiveEvent) {
        let number = self.lock().given_out + 1;
        self.keep(NumberedEvent { number, event });
    }

    fn keep(&self, event: NumberedEvent) {
        let mut held = self.lock();
        if event.number <= held.given_out {
            // Told twice.
            return;
        }
        held.given_out = event.number;
        if held.kept.len() == self.most {
            held.kept.pop_front();
        }
        held.kept.push_back(Arc::new(event));
        self.latest.send_replace(held.given_out);
    }

    /// The next event after `position` of that asset, and whether some before it are gone; none where there is none yet.
    fn next(&self, position: &mut u64, asset: Option<&AssetId>) -> Next {
        let held = self.lock();
        let oldest = held.kept.front().map_or(held.given_out + 1, |event| event.number);
        if *position + 1 < oldest {
            let gone = oldest - 1 - *position;
            *position = oldest - 1;
            return Next::Lost(gone);
        }
        let from = held.kept.partition_point(|event| event.number <= *position);
        let is_wanted = |event: &&Arc<NumberedEvent>| {
            let of = event.event.asset.as_ref();
            asset.is_none() || of.is_none() || of == asset
        };
        let found = held.kept.iter().skip(from).find(is_wanted).cloned();
        // A client may have seen more at another node than has come here yet.
        *position = found.as_ref().map_or(held.given_out.max(*position), |event| event.number);
        found.map_or(Next::Nothing, Next::Event)
    }

    fn id(&self, number: u64) -> String {
        format!("{}-{number}", self.run)
    }

    /// Where a client goes on that saw `last` last: its position, or none where that was before this run.
    fn position(&self, last: &str) -> Option<u64> {
        let (run, number) = last.rsplit_once('-')?;
        let number = number.parse().ok()?;
        (run == self.run && number <= self.lock().given_out + self.ahead).then_some(number)
    }
}

/// What an announcement tells those who follow the service.
pub fn live_events(announcement: &Announcement) -> Vec<LiveEvent> {
    let one = |kind: &str, asset: &AssetId, data: Value| LiveEvent {
        kind: kind.to_owned(),
        asset: Some(asset.clone()),
        data: data.to_string(),
    };
    let event = match announcement {
        Announcement::AssetChanged(id) => one("asset", id, json!({ "asset_id": id, "change": "changed" })),
        Announcement::AssetRemoved(id) => one("asset", id, json!({ "asset_id": id, "change": "removed" })),
        Announcement::HistoryFolded { asset, channel } => one("history", asset, json!({ "asset_id": asset, "channel": channel })),
        Announcement::RecomputationChanged(recomputation) => one(RECOMPUTATION, &recomputation.asset, json!(**recomputation)),
        Announcement::AlarmChanged(notice) => {
            let AlarmNotice { alarm, change } = &**notice;
            let view = AlarmView::new(alarm.clone(), change.time);
            let data = json!({ "asset_id": alarm.asset_id, "alarm": view, "change": change });
            one("alarm", &alarm.asset_id, data)
        }
        Announcement::MaintenanceChanged { asset, event, is_removed } => {
            let change = if *is_removed { "removed" } else { "added" };
            let event = EventView::new(asset.clone(), StoredEvent::clone(event));
            one("maintenance", asset, json!({ "asset_id": asset, "event": event, "change": change }))
        }
        Announcement::ReplayChanged(replay) => one("replay", &replay.asset, json!(**replay)),
        Announcement::SegmentStored(segment) => {
            let of = json!({
                "asset_id": segment.asset_id,
                "channel": segment.channel,
                "segment_id": segment.id,
                "start_time": segment.start_time,
            });
            let mut indicators = of.clone();
            indicators["indicators"] = json!(segment.indicators.values);
            let mut wear = of;
            wear["wear"] = json!(WearEstimate {
                posterior: None,
                ..segment.wear.clone()
            });
            return vec![
                one("indicators", &segment.asset_id, indicators),
                one("wear", &segment.asset_id, wear),
            ];
        }
    };
    vec![event]
}

/// Says that so many events are not told.
pub fn lost_events(count: u64) -> LiveEvent {
    LiveEvent {
        kind: "lost".to_owned(),
        asset: None,
        data: json!({ "events": count }).to_string(),
    }
}

/// Tells a node of what another process of its cluster did.
fn note(ingest: &Ingest, event: &LiveEvent) {
    if event.kind == RECOMPUTATION {
        match serde_json::from_str(&event.data) {
            Ok(recomputation) => ingest.note_recomputation(recomputation),
            Err(error) => tracing::debug!(%error, "a recomputation elsewhere cannot be read"),
        }
    }
}

fn server_event(events: &Events, event: &NumberedEvent) -> Event {
    let NumberedEvent { number, event } = event;
    Event::default().event(&event.kind).id(events.id(*number)).data(&event.data)
}

enum Next {
    Event(Arc<NumberedEvent>),
    Lost(u64),
    Nothing,
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
/// Events `indicators`, `wear`, `history`, `asset`, `recomputation`, `replay`, `alarm` and `maintenance` with JSON data; after `Last-Event-ID` first what was missed. An
/// event `lost` says that some are not kept any more: then the lists have to be read again.
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
        app.ingest.store().asset(asset).await?;
    }
    let events = Arc::clone(&app.events);
    let latest = events.latest.subscribe();
    let over = events.is_over.subscribe();
    let last = headers.get("last-event-id").and_then(|last| last.to_str().ok());
    let known = last.map(|last| events.position(last));
    // Without a position of this run it begins with what happens now; a client that had one is told that it missed something.
    let position = known.flatten().unwrap_or_else(|| events.lock().given_out);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_ring_keeps_the_latest_and_counts_what_is_gone() {
        let (_sender, receiver) = tokio::sync::broadcast::channel(1);
        let events = Events::follow(receiver, "r".into(), 3);
        let (a, b) = (AssetId::new("a").unwrap(), AssetId::new("b").unwrap());
        for n in 0..5 {
            events.add(LiveEvent {
                kind: "asset".into(),
                asset: Some(if n % 2 == 0 { a.clone() } else { b.clone() }),
                data: n.to_string(),
            });
        }
        let mut position = 0;
        assert!(matches!(events.next(&mut position, None), Next::Lost(2)));
        for n in 2..5 {
            assert!(matches!(events.next(&mut position, None), Next::Event(event) if event.event.data == n.to_string()));
        }
        assert!(matches!(events.next(&mut position, None), Next::Nothing));
        let mut position = events.position("r-3").unwrap();
        assert!(matches!(events.next(&mut position, Some(&b)), Next::Event(event) if event.number == 4));
        assert!(matches!(events.next(&mut position, Some(&b)), Next::Nothing));
        assert_eq!(position, 5);
        for unknown in ["r-6", "s-1", "r", "", "r-x"] {
            assert!(events.position(unknown).is_none(), "{unknown}");
        }
    }
}
