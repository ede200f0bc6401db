//! What one request brings of an upload.

use std::sync::Arc;

use axum::body::Body;
use axum::http::StatusCode;
use bytes::Bytes;
use tokio::time::{Instant, timeout_at};

use super::ResumableUpload;
use crate::http::app::App;
use crate::http::body::{Arrival, Pieces};
use crate::http::limits::HttpLimits;
use crate::http::problem::Problem;

/// The bytes of a request as they come: no more than are missing, and none after the time that a body may take.
pub(super) struct Incoming {
    pieces: Pieces<'static>,
    arrival: Arrival,
    limits: Arc<HttpLimits>,
    deadline: Instant,
    missing: u64,
    taken: u64,
}

impl Incoming {
    pub(super) fn new(app: &App, upload: &ResumableUpload, body: Body) -> Self {
        Self {
            pieces: Pieces::Body(body),
            arrival: Arrival::begin(),
            limits: Arc::clone(&app.limits),
            deadline: Instant::now() + app.limits.body_timeout,
            missing: upload.length - upload.offset,
            taken: 0,
        }
    }

    /// The next bytes; none at the end.
    pub(super) async fn next(&mut self) -> Result<Option<Bytes>, Problem> {
        let next = timeout_at(self.deadline, self.arrival.next(&mut self.pieces, &self.limits)).await;
        let next = next.map_err(|_| Problem::new(StatusCode::REQUEST_TIMEOUT, "the body took too long"))??;
        self.taken += next.as_ref().map_or(0, |bytes| bytes.len() as u64);
        if self.taken > self.missing {
            return Err(Problem::too_large(self.missing));
        }
        Ok(next)
    }
}
