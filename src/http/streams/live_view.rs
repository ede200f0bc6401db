//! `GET /v1/assets/{asset}/stream/live`: a live stream as server-sent events.

use std::convert::Infallible;
use std::time::Duration;

use axum::Extension;
use axum::extract::State;
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures_util::stream::unfold;
use serde::Serialize;
use tokio::sync::watch;

use super::StreamName;
use crate::asset::DEFAULT_STREAM;
use crate::http::access::TokenWatch;
use crate::http::access::client::{Client, ClientPermit};
use crate::http::access::session::Caller;
use crate::http::app::App;
use crate::http::events;
use crate::http::problem::Problem;
use crate::http::request::query::{AssetPath, Parameters};
use crate::service::{LiveFrame, LiveUpdate, StreamViewer};

/// Interval of keep-alive comments on a quiet connection.
const KEEP_ALIVE: Duration = Duration::from_secs(15);

/// One server-sent event of a live view.
#[derive(utoipa::ToSchema)]
#[expect(dead_code, reason = "describes what axum writes")]
struct LiveViewEvent {
    /// `frame` or `waiting`.
    event: String,
    /// JSON: the frame, or for how long no samples arrived.
    data: LiveViewData,
}

/// The data of a live view event.
#[derive(Serialize, utoipa::ToSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "describes what axum writes")]
enum LiveViewData {
    Frame(LiveFrame),
    Waiting(LiveWaiting),
}

/// No samples arrive.
#[derive(Debug, Serialize, utoipa::ToSchema)]
struct LiveWaiting {
    /// Seconds without samples.
    seconds: u64,
}

/// Watch a live stream
///
/// Events `frame`, up to eight per second while samples arrive: scope, spectrum and level of each channel
/// over the last second, with speed and mesh frequency. Events `waiting`, once per second while no samples
/// arrive. A frame is computed once for all viewers, and only if there are any; slow clients receive fewer
/// frames. The events end when the asset is removed, the token is revoked or the service stops.
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/stream/live",
    tag = "streams",
    params(StreamName),
    responses(
        (status = 200, body = LiveViewEvent, content_type = "text/event-stream"),
        (status = 503, description = "Too many streams are open"),
    ),
)]
pub(crate) async fn watch(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<StreamName>,
    client: Client,
    caller: Option<Extension<Caller>>,
) -> Result<Response, Problem> {
    let name = params.name.as_deref().unwrap_or(DEFAULT_STREAM);
    let Some(permit) = app.event_stream_limiter.try_acquire(client) else {
        return Ok(events::too_many());
    };
    let viewer = app.service.streams.watch(&asset, name).await?;
    let token = TokenWatch::new(app.access, caller.map(|Extension(caller)| caller));
    let view = View { viewer, token, over: app.service.streams.watch_end(), _permit: permit };
    let events = unfold(view, async |mut view| {
        let event = view.next().await?;
        Some((Ok::<_, Infallible>(event), view))
    });
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response())
}

/// A connection that watches a stream.
struct View {
    viewer: StreamViewer,
    token: TokenWatch,
    over: watch::Receiver<bool>,
    _permit: ClientPermit,
}

impl View {
    /// Returns the next event; `None` at the end.
    async fn next(&mut self) -> Option<Event> {
        loop {
            if self.token.is_revoked().await {
                return None;
            }
            tokio::select! {
                _ = self.over.wait_for(|over| *over) => return None,
                update = self.viewer.next() => return Some(event(&update?)),
                () = self.token.due() => {}
            }
        }
    }
}

fn event(update: &LiveUpdate) -> Event {
    match update {
        LiveUpdate::Frame(frame) => Event::default().event("frame").data(frame),
        LiveUpdate::Waiting(seconds) => {
            // A structure of numbers and strings always serialises
            let waiting = serde_json::to_string(&LiveWaiting { seconds: *seconds }).unwrap_or_default();
            Event::default().event("waiting").data(waiting)
        }
    }
}
