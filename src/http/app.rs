//! Shared state of the handlers.

use std::path::Path;
use std::sync::Arc;

use super::access::Access;
use super::event_ring::EventRing;
use super::limits::HttpLimits;
use super::line_cache::LineCache;
use super::measurements::Measurements;
use super::preview_model::PreviewModels;
use super::queue_metrics::QueueWatch;
use super::reading_waits::ReadingWaits;
use super::shares::Shares;
use super::write_probe::WriteProbe;
use crate::service::Service;

/// The service and the API's own state; a clone is another handle.
#[derive(Clone)]
pub(super) struct App {
    pub(super) service: Arc<Service>,
    pub(super) limits: Arc<HttpLimits>,
    pub(super) measurements: Arc<Measurements>,
    pub(super) events: Arc<EventRing>,
    pub(super) access: Arc<Access>,
    pub(super) reading_waits: Arc<ReadingWaits>,
    pub(super) uploads: Arc<Path>,
    pub(super) lines: Arc<LineCache>,
    pub(super) previews: Arc<PreviewModels>,
    pub(super) event_streams: Shares,
    pub(super) write_probe: Arc<WriteProbe>,
    pub(super) queue_watch: Arc<QueueWatch>,
}
