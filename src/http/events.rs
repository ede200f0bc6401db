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
use tokio::sync::watch;

use super::alarms::AlarmView;
use super::maintenance::EventView;
use super::problem::Problem;
use super::query::Parameters;
use super::router::App;
use crate::asset::AssetId;
use crate::estimate::WearEstimate;
use crate::ingest::Announcement;
use crate::store::{AlarmNotice, StoredEvent};

/// How often a quiet connection is kept from being taken for dead.
const KEEP_ALIVE: Duration = Duration::from_secs(15);

/// One thing that happened.
#[derive(Debug)]
struct Happened {
    number: u64,
    kind: &'static str,
    asset: Option<AssetId>,
    data: String,
}

/// The latest events.
#[derive(Debug)]
pub(super) struct Events {
    /// Tells this run of the service from others in identifiers.
    run: String,
    most: usize,
    held: Mutex<Held>,
    /// The number of the latest event; closed at the end of the service.
    latest: watch::Sender<u64>,
    is_over: watch::Sender<bool>,
}

#[derive(Debug, Default)]
struct Held {
    given_out: u64,
    kept: VecDeque<Arc<Happened>>,
}

impl Events {
    /// Follows announcements; `run` must differ between runs of the service.
    pub(super) fn follow(mut announcements: Receiver<Announcement>, run: String, most: usize) -> Arc<Self> {
        let events = Arc::new(Self {
            run,
            most: most.max(1),
            held: Mutex::default(),
            latest: watch::Sender::new(0),
            is_over: watch::Sender::new(false),
        });
        let followed = Arc::clone(&events);
        tokio::spawn(async move {
            loop {
                match announcements.recv().await {
                    Ok(announcement) => followed.add_all(&announcement),
                    Err(RecvError::Lagged(count)) => followed.add("lost", None, &json!({ "events": count })),
                    Err(RecvError::Closed) => break,
                }
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

    fn add(&self, kind: &'static str, asset: Option<&AssetId>, data: &Value) {
        let mut held = self.lock();
        held.given_out += 1;
        let number = held.given_out;
        if held.kept.len() == self.most {
            held.kept.pop_front();
        }
        held.kept.push_back(Arc::new(Happened {
            number,
            kind,
            asset: asset.cloned(),
            data: data.to_string(),
        }));
        self.latest.send_replace(number);
    }

    fn add_all(&self, announcement: &Announcement) {
        match announcement {
            Announcement::AssetChanged(id) => self.add("asset", Some(id), &json!({ "asset_id": id, "change": "changed" })),
            Announcement::AssetRemoved(id) => self.add("asset", Some(id), &json!({ "asset_id": id, "change": "removed" })),
            Announcement::HistoryFolded { asset, channel } => {
                self.add("history", Some(asset), &json!({ "asset_id": asset, "channel": channel }));
            }
            Announcement::RecomputationChanged(recomputation) => {
                self.add("recomputation", Some(&recomputation.asset), &json!(**recomputation));
            }
            Announcement::AlarmChanged(notice) => {
                let AlarmNotice { alarm, change } = &**notice;
                let view = AlarmView::new(alarm.clone(), change.time);
                let data = json!({ "asset_id": alarm.asset_id, "alarm": view, "change": change });
                self.add("alarm", Some(&alarm.asset_id), &data);
            }
            Announcement::MaintenanceChanged { asset, event, is_removed } => {
                let change = if *is_removed { "removed" } else { "added" };
                let event = EventView::new(asset.clone(), StoredEvent::clone(event));
                self.add(
                    "maintenance",
                    Some(asset),
                    &json!({ "asset_id": asset, "event": event, "change": change }),
                );
            }
            Announcement::ReplayChanged(replay) => self.add("replay", Some(&replay.asset), &json!(**replay)),
            Announcement::SegmentStored(segment) => {
                let of = json!({
                    "asset_id": segment.asset_id,
                    "channel": segment.channel,
                    "segment_id": segment.id,
                    "start_time": segment.start_time,
                });
                let mut indicators = of.clone();
                indicators["indicators"] = json!(segment.indicators.values);
                self.add("indicators", Some(&segment.asset_id), &indicators);
                let mut wear = of;
                wear["wear"] = json!(WearEstimate {
                    posterior: None,
                    ..segment.wear.clone()
                });
                self.add("wear", Some(&segment.asset_id), &wear);
            }
        }
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
        let from = usize::try_from(*position + 1 - oldest).unwrap_or(usize::MAX);
        let is_wanted = |event: &&Arc<Happened>| asset.is_none() || event.asset.is_none() || event.asset.as_ref() == asset;
        let found = held.kept.iter().skip(from).find(is_wanted).cloned();
        *position = found.as_ref().map_or(held.given_out, |event| event.number);
        found.map_or(Next::Nothing, Next::Event)
    }

    fn id(&self, number: u64) -> String {
        format!("{}-{number}", self.run)
    }

    /// Where a client goes on that saw `last` last: its position, or none where that was before this run.
    fn position(&self, last: &str) -> Option<u64> {
        let (run, number) = last.rsplit_once('-')?;
        let number = number.parse().ok()?;
        (run == self.run && number <= self.lock().given_out).then_some(number)
    }
}

enum Next {
    Event(Arc<Happened>),
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
                    Next::Event(event) => Event::default().event(event.kind).id(events.id(event.number)).data(&event.data),
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
            events.add("asset", Some(if n % 2 == 0 { &a } else { &b }), &json!(n));
        }
        let mut position = 0;
        assert!(matches!(events.next(&mut position, None), Next::Lost(2)));
        for n in 2..5 {
            assert!(matches!(events.next(&mut position, None), Next::Event(event) if event.data == n.to_string()));
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
