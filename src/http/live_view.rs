//! `GET /v1/assets/{asset}/stream/live`: a live stream as it comes, as server-sent events.

use std::convert::Infallible;
use std::time::Duration;

use axum::Extension;
use axum::extract::State;
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures_util::stream::unfold;
use serde::{Deserialize, Serialize};
use tokio::sync::watch;
use tokio::time::Instant;

use super::app::App;
use super::events;
use super::problem::{Details, Problem};
use super::query::{AssetInPath, Parameters};
use super::session::Caller;
use super::shares::{Client, Share};
use super::streams::USUAL_NAME;
use crate::asset::AssetId;
use crate::service::{LiveFrame, LiveUpdate, StreamViewer};

/// How often a quiet connection is kept from being taken for dead.
const KEEP_ALIVE: Duration = Duration::from_secs(15);

/// How often is looked whether the token that opened a view is still taken.
const TOKEN_INTERVAL: Duration = Duration::from_secs(2);

/// Which stream is looked at.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct LiveParameters {
    /// The stream's name: `main` where not given.
    name: Option<String>,
}

/// One event of a live view as it comes over the connection.
#[derive(utoipa::ToSchema)]
#[expect(dead_code, reason = "describes what axum writes")]
struct LiveViewEvent {
    /// `frame` or `waiting`.
    event: String,
    /// As JSON: the frame, or for how long no samples came.
    data: LiveViewData,
}

/// What an event of a live view says.
#[derive(Serialize, utoipa::ToSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "describes what axum writes")]
enum LiveViewData {
    Frame(LiveFrame),
    Waiting(LiveWaiting),
}

/// No samples come.
#[derive(Debug, Serialize, utoipa::ToSchema)]
struct LiveWaiting {
    /// For so many seconds.
    seconds: u64,
}

/// Look at a live stream as it comes
///
/// Events `frame`, up to eight a second while samples come: a scope, a spectrum and the level of each channel
/// over the last second, with the speed and the mesh frequency. Events `waiting` say each second that no
/// samples come. A frame is made once however many look at it, and only while somebody does; who is slow gets
/// fewer of them. The events end when the asset is removed, the token revoked or the service stopped.
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/stream/live",
    tag = "streams",
    params(("asset" = AssetId, Path, description = "The asset"), LiveParameters),
    responses(
        (status = 200, body = LiveViewEvent, content_type = "text/event-stream"),
        (status = 501, body = Details, content_type = "application/problem+json", description = "A cluster takes no streams"),
        (status = 503, body = Details, content_type = "application/problem+json", description = "Too many are open"),
    ),
)]
pub(super) async fn watch(
    State(app): State<App>,
    AssetInPath(asset): AssetInPath,
    Parameters(asked): Parameters<LiveParameters>,
    client: Client,
    caller: Option<Extension<Caller>>,
) -> Result<Response, Problem> {
    let name = asked.name.as_deref().unwrap_or(USUAL_NAME);
    let Some(share) = app.event_streams.take(client) else {
        return Ok(events::too_many());
    };
    let viewer = app.service.streams.watch(&asset, name).await?;
    let caller = caller.map(|Extension(caller)| caller);
    let over = app.service.streams.follow_end();
    let view = View { app, viewer, caller, over, token_seen_at: Instant::now(), _share: share };
    let events = unfold(view, async |mut view| {
        let event = view.next().await?;
        Some((Ok::<_, Infallible>(event), view))
    });
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response())
}

/// A connection over which a stream is looked at.
struct View {
    app: App,
    viewer: StreamViewer,
    /// Whose token opened it; it ends when that is revoked.
    caller: Option<Caller>,
    over: watch::Receiver<bool>,
    token_seen_at: Instant,
    _share: Share,
}

impl View {
    /// What is to be sent next; none at its end.
    async fn next(&mut self) -> Option<Event> {
        loop {
            if self.token_seen_at.elapsed() >= TOKEN_INTERVAL {
                self.token_seen_at = Instant::now();
                if let Some(caller) = &self.caller
                    && !self.app.access.still_takes(caller).await
                {
                    return None;
                }
            }
            tokio::select! {
                _ = self.over.wait_for(|over| *over) => return None,
                update = self.viewer.next() => return Some(event(&update?)),
                () = tokio::time::sleep_until(self.token_seen_at + TOKEN_INTERVAL), if self.caller.is_some() => {}
            }
        }
    }
}

fn event(update: &LiveUpdate) -> Event {
    match update {
        LiveUpdate::Frame(frame) => Event::default().event("frame").data(frame),
        LiveUpdate::Waiting(seconds) => {
            // A number: it always serialises.
            let waiting = serde_json::to_string(&LiveWaiting { seconds: *seconds }).unwrap_or_default();
            Event::default().event("waiting").data(waiting)
        }
    }
}
