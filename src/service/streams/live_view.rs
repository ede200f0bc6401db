//! The live view of a stream: several frames a second, computed once for all viewers and only while there are
//! any. Slow viewers get fewer frames.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use jiff::Timestamp;
use tokio::sync::watch;
use tokio::time::{Instant, MissedTickBehavior};

use super::Streams;
use super::live::LiveStream;
use crate::asset::{AssetId, AssetSpec};
use crate::service::error::ServiceError;
use crate::service::workers::blocking;
use crate::store::StoreError;

/// Time between two frames.
const INTERVAL: Duration = Duration::from_millis(125);

/// Interval at which the asset's description is read again.
const DESCRIPTION_INTERVAL: Duration = Duration::from_secs(2);

/// Time without samples after which viewers are notified, and then again each second.
const WAITING_AFTER: Duration = Duration::from_secs(2);

/// The latest update of a live view.
#[derive(Debug, Clone, Default)]
struct LatestUpdate {
    /// Counts frames.
    number: u64,
    frame: Option<Arc<str>>,
    /// Whole seconds without samples, once they are overdue.
    waiting_s: Option<u64>,
    is_over: bool,
}

/// Sends the updates of a live view to its viewers.
#[derive(Debug, Default)]
pub(super) struct LiveViewSender {
    latest: watch::Sender<LatestUpdate>,
    is_running: AtomicBool,
}

/// An update of a live view.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LiveUpdate {
    /// A [`LiveFrame`](super::LiveFrame) as JSON.
    Frame(Arc<str>),
    /// No samples have arrived for this number of seconds.
    Waiting(u64),
}

/// A viewer of a stream.
#[derive(Debug)]
pub struct StreamViewer {
    latest: watch::Receiver<LatestUpdate>,
    /// The last frame and waiting time returned.
    seen: u64,
    waiting_s: Option<u64>,
}

impl StreamViewer {
    /// Waits for the next update; updates in between are skipped. Returns `None` if the stream is removed or
    /// the service ends. Cancel-safe.
    pub async fn next(&mut self) -> Option<LiveUpdate> {
        loop {
            let latest = self.latest.borrow_and_update().clone();
            if latest.is_over {
                return None;
            }
            if latest.number != self.seen {
                (self.seen, self.waiting_s) = (latest.number, None);
                if let Some(frame) = latest.frame {
                    return Some(LiveUpdate::Frame(frame));
                }
            }
            if latest.waiting_s != self.waiting_s {
                self.waiting_s = latest.waiting_s;
                if let Some(seconds) = latest.waiting_s {
                    return Some(LiveUpdate::Waiting(seconds));
                }
            }
            self.latest.changed().await.ok()?;
        }
    }
}

impl LiveViewSender {
    /// Ends the live view: the stream is removed.
    pub(super) fn end(&self) {
        self.latest.send_if_modified(|latest| {
            let changes = !latest.is_over && self.is_running.load(Ordering::SeqCst);
            latest.is_over |= changes;
            changes
        });
    }

    fn update(&self, change: impl FnOnce(&mut LatestUpdate)) {
        self.latest.send_modify(change);
    }

    /// Whether the caller becomes the producer of frames.
    fn begin(&self) -> bool {
        !self.is_running.swap(true, Ordering::SeqCst)
    }

    /// Whether there are no viewers, in which case the caller must stop producing frames.
    fn is_ended_without_viewers(&self) -> bool {
        if self.latest.receiver_count() > 0 {
            return false;
        }
        self.is_running.store(false, Ordering::SeqCst);
        // One may have been added since the last check.
        self.latest.receiver_count() == 0 || !self.begin()
    }
}

impl Streams {
    /// Adds a viewer to a stream.
    ///
    /// # Errors
    /// The asset does not exist; [`ServiceError::StreamUnknown`].
    pub async fn watch(self: &Arc<Self>, asset: &AssetId, name: &str) -> Result<StreamViewer, ServiceError> {
        self.status(asset, name).await?;
        let stream = self.find(asset, name).await?;
        let latest = stream.live_view.latest.subscribe();
        if stream.live_view.begin() {
            stream.live_view.update(|latest| {
                *latest = LatestUpdate { number: latest.number + 1, ..LatestUpdate::default() }
            });
            tokio::spawn(FrameProducer::new(Arc::clone(self), stream).run());
        }
        Ok(StreamViewer { latest, seen: 0, waiting_s: None })
    }
}

/// Produces the frames of one stream.
struct FrameProducer {
    streams: Arc<Streams>,
    stream: Arc<LiveStream>,
    /// The asset's description, and when it was read.
    asset: Option<(Arc<AssetSpec>, Instant)>,
    /// When new samples were last seen.
    last_sample_at: Option<Instant>,
    /// The index for which the last frame was made, and the index and time of its end.
    seen_next: Option<u64>,
    shown_end: Option<u64>,
    shown_time: Option<Timestamp>,
}

impl FrameProducer {
    fn new(streams: Arc<Streams>, stream: Arc<LiveStream>) -> Self {
        Self {
            streams,
            stream,
            asset: None,
            last_sample_at: None,
            seen_next: None,
            shown_end: None,
            shown_time: None,
        }
    }

    async fn run(mut self) {
        let (mut over, mut next) = (self.streams.watch_end(), self.stream.watch_next());
        let mut ticks = tokio::time::interval(INTERVAL);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                _ = over.wait_for(|over| *over) => break,
                _ = ticks.tick() => {}
            }
            if self.stream.live_view.is_ended_without_viewers() {
                self.forget().await;
                return;
            }
            if self.stream.live_view.latest.borrow().is_over {
                break;
            }
            let mut now = *next.borrow_and_update();
            // Another process may have received samples.
            if now == self.seen_next && self.stream.location.is_shared() {
                let stream = Arc::clone(&self.stream);
                // An error is found again by the next frame.
                let _ = blocking("read a stream", move || stream.with_stored(|_| Ok(()))).await;
                now = *next.borrow_and_update();
            }
            if now.is_some() && now == self.seen_next {
                self.wait();
                continue;
            }
            match self.show().await {
                Ok(()) => self.seen_next = now,
                Err(
                    ServiceError::StreamUnknown { .. } | ServiceError::Store(StoreError::AssetUnknown(_)),
                ) => {
                    break;
                }
                // It may succeed the next time.
                Err(error) => {
                    let (asset, name) = (&self.stream.asset, &self.stream.name);
                    tracing::debug!(%asset, name, %error, "failed to produce a frame of a live view; retrying");
                    self.wait();
                }
            }
        }
        self.stream.live_view.update(|latest| latest.is_over = true);
        self.stream.live_view.is_running.store(false, Ordering::SeqCst);
        self.forget().await;
    }

    /// Produces a frame of the latest samples.
    async fn show(&mut self) -> Result<(), ServiceError> {
        let asset = self.asset().await?;
        let stream = Arc::clone(&self.stream);
        let latest = blocking("read a stream", move || stream.latest()).await??;
        let end = Some(latest.end());
        if latest.bytes.is_empty() || end == self.shown_end {
            self.wait();
            return Ok(());
        }
        // The first frame shows earlier samples.
        if self.shown_end.is_some() {
            self.last_sample_at = Some(Instant::now());
        }
        (self.shown_end, self.shown_time) = (end, latest.time);
        let make = move || serde_json::to_string(&latest.frame(&asset));
        // Numbers and names always serialise.
        let frame = self.streams.workers.run_first("produce a live view", make).await?.unwrap_or_default();
        self.stream.live_view.update(|latest| {
            latest.number += 1;
            latest.frame = Some(frame.into());
            latest.waiting_s = None;
        });
        Ok(())
    }

    async fn asset(&mut self) -> Result<Arc<AssetSpec>, ServiceError> {
        if let Some((asset, read_at)) = &self.asset
            && read_at.elapsed() < DESCRIPTION_INTERVAL
        {
            return Ok(Arc::clone(asset));
        }
        let asset = match (self.streams.store.asset(&self.stream.asset).await, &self.asset) {
            (Ok(asset), _) => Arc::new(asset.spec.clone()),
            // If the database is unavailable, the view continues with the last description.
            (Err(error), Some((asset, _))) if error.is_unavailable() => Arc::clone(asset),
            (Err(error), _) => return Err(error.into()),
        };
        self.asset = Some((Arc::clone(&asset), Instant::now()));
        Ok(asset)
    }

    /// Updates the time without samples.
    fn wait(&self) {
        let waited = match self.last_sample_at {
            Some(last_sample_at) => last_sample_at.elapsed(),
            // None since the first viewer: by the time of the last sample.
            None => self.since_last_sample().unwrap_or_default(),
        };
        let waiting_s = (waited >= WAITING_AFTER).then_some(waited.as_secs());
        self.stream
            .live_view
            .latest
            .send_if_modified(|latest| std::mem::replace(&mut latest.waiting_s, waiting_s) != waiting_s);
    }

    fn since_last_sample(&self) -> Option<Duration> {
        Duration::try_from(self.streams.clock.now().duration_since(self.shown_time?)).ok()
    }

    /// Releases the samples in memory.
    async fn forget(self) {
        let stream = self.stream;
        let _ = blocking("release the samples of a stream", move || stream.forget_latest()).await;
    }
}
