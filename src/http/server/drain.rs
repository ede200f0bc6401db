//! Drains the rest of a rejected body in the background, so that the connection can be reused: hyper closes a
//! connection whose request was not fully read. A client that reuses connections would send its next request
//! into the closed one, and a client that is still sending would not read the error.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, HttpBody};
use axum::extract::Request;
use axum::http::{HeaderValue, header};
use axum::middleware::Next;
use axum::response::Response;
use bytes::{Buf, Bytes};
use hyper::body::{Frame, SizeHint};

/// Maximum number of drained bytes and maximum time; beyond, the connection is closed.
const MAX_DRAINED: usize = 64 << 20;
const MAX_TIME: Duration = Duration::from_secs(5);

/// A request body whose rest is drained when it is dropped early.
struct WholeBody {
    body: Body,
    is_begun: Arc<AtomicBool>,
    /// The client sends the body only after a `100 Continue`.
    waits: bool,
}

impl HttpBody for WholeBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        self.is_begun.store(true, Ordering::Relaxed);
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

impl Drop for WholeBody {
    fn drop(&mut self) {
        let is_coming = self.is_begun.load(Ordering::Relaxed) || !self.waits;
        if self.body.is_end_stream() || !is_coming {
            return;
        }
        if let Ok(runtime) = tokio::runtime::Handle::try_current() {
            let rest = std::mem::take(&mut self.body);
            runtime.spawn(tokio::time::timeout(MAX_TIME, drain(rest)));
        }
    }
}

async fn drain(mut rest: Body) {
    let mut remaining = MAX_DRAINED;
    while remaining > 0
        && let Some(Ok(frame)) = std::future::poll_fn(|context| Pin::new(&mut rest).poll_frame(context)).await
    {
        remaining = remaining.saturating_sub(frame.data_ref().map_or(0, Buf::remaining));
    }
}

/// Drains what handlers leave of a body. If the client was not told to continue, the response closes the
/// connection.
pub(crate) async fn layer(request: Request, next: Next) -> Response {
    if request.body().is_end_stream() {
        return next.run(request).await;
    }
    let is_begun = Arc::new(AtomicBool::new(false));
    let waits = request.headers().contains_key(header::EXPECT);
    let request = request.map(|body| Body::new(WholeBody { body, is_begun: Arc::clone(&is_begun), waits }));
    let mut response = next.run(request).await;
    if waits && !is_begun.load(Ordering::Relaxed) {
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    response
}
