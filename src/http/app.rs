//! Shared state of the handlers.

use std::path::Path;
use std::sync::Arc;

use tokio::sync::RwLock;

use super::access::Access;
use super::access::client::ClientLimiter;
use super::events::ring::EventRing;
use super::health::write_probe::WriteProbe;
use super::metrics::queue::QueueWatch;
use super::metrics::requests::Measurements;
use super::preview::model::PreviewModels;
use super::server::limits::HttpLimits;
use super::spectra::line_cache::LineCache;
use super::uploads::upload_waits::UploadWaits;
use crate::service::Service;

/// The service and the API's own state; a clone is another handle.
#[derive(Clone)]
pub(super) struct App {
    pub(super) service: Arc<Service>,
    pub(super) limits: Arc<HttpLimits>,
    pub(super) measurements: Arc<Measurements>,
    pub(super) events: Arc<EventRing>,
    pub(super) access: Arc<Access>,
    pub(super) upload_waits: Arc<UploadWaits>,
    pub(super) uploads: Arc<Path>,
    pub(super) lines: Arc<LineCache>,
    pub(super) previews: Arc<PreviewModels>,
    pub(super) event_stream_limiter: ClientLimiter,
    pub(super) write_probe: Arc<WriteProbe>,
    pub(super) queue_watch: Arc<QueueWatch>,
    /// Read-locked by each request that may change something, until it is handled.
    pub(super) changes: Arc<RwLock<()>>,
}
