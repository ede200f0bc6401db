//! One stream in memory: its sender, its viewers, and its pending records.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::watch;

use super::feed::LiveFeed;
use super::frame::{LatestSamples, frames_of};
use super::state::PendingCut;
use super::stored::StoredStream;
use crate::asset::AssetId;
use crate::recording::RecordingError;
use crate::service::error::ServiceError;
use crate::store::Disk;

/// A stream of an asset.
#[derive(Debug)]
pub(crate) struct LiveStream {
    pub(crate) asset: AssetId,
    pub(crate) name: String,
    pub(crate) folder: PathBuf,
    pub(super) disk: Arc<dyn Disk>,
    /// `None` until it is read, and after a failed write: it is then read again.
    stored: Mutex<Option<StoredStream>>,
    /// The number of the connection that sends it; 0 before the first one.
    owner: watch::Sender<u64>,
    /// Number of pending records.
    pending: watch::Sender<usize>,
    /// Index after the last sample; `None` if the stream is not read yet or has no sample.
    next: watch::Sender<Option<u64>>,
    pub(super) feed: LiveFeed,
    is_cutting: AtomicBool,
    /// Whether writing has stopped, because another process may take over.
    is_closed: AtomicBool,
}

impl LiveStream {
    pub(super) fn new(asset: AssetId, name: String, folder: PathBuf, disk: Arc<dyn Disk>) -> Self {
        Self {
            asset,
            name,
            folder,
            disk,
            stored: Mutex::default(),
            owner: watch::Sender::new(0),
            pending: watch::Sender::new(0),
            next: watch::Sender::new(None),
            feed: LiveFeed::default(),
            is_cutting: AtomicBool::default(),
            is_closed: AtomicBool::default(),
        }
    }

    /// Makes another connection the sender; returns its number.
    pub(super) fn take_over(&self) -> u64 {
        self.owner.send_modify(|owner| *owner += 1);
        *self.owner.borrow()
    }

    /// Follows the number of the sending connection.
    pub(super) fn follow_owner(&self) -> watch::Receiver<u64> {
        self.owner.subscribe()
    }

    pub(super) fn is_owner(&self, owner: u64) -> bool {
        *self.owner.borrow() == owner
    }

    pub(super) fn follow_pending(&self) -> watch::Receiver<usize> {
        self.pending.subscribe()
    }

    /// Follows the index after the last sample.
    pub(super) fn follow_next(&self) -> watch::Receiver<Option<u64>> {
        self.next.subscribe()
    }

    /// The latest samples, which stay in memory from now on.
    pub(super) fn latest(&self) -> Result<LatestSamples, ServiceError> {
        self.with_stored(|stored| {
            let (first, bytes) = stored.recent(frames_of(&stored.state().format))?;
            let state = stored.state();
            let end = first + (bytes.len() / state.format.frame_bytes()) as u64;
            Ok(LatestSamples {
                format: state.format.clone(),
                first,
                bytes,
                time: end.checked_sub(1).and_then(|last| state.time(last)),
                operating_point: state.operating_point(),
            })
        })
    }

    /// Releases the samples in memory.
    pub(super) fn forget_latest(&self) {
        let mut stored = self.stored.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(stored) = stored.as_mut() {
            stored.forget_recent();
        }
    }

    /// Runs `work` on the stored stream, which is read first if necessary. Blocks. After a failed write the
    /// stream is read again the next time, so that memory is never ahead of the disk.
    pub(super) fn with<T>(
        &self,
        work: impl FnOnce(&mut Option<StoredStream>) -> Result<T, ServiceError>,
    ) -> Result<T, ServiceError> {
        let mut stored = self.stored.lock().unwrap_or_else(PoisonError::into_inner);
        if self.is_closed.load(Ordering::SeqCst) {
            return Err(ServiceError::StreamTaken);
        }
        if stored.is_none() {
            *stored = StoredStream::open(Arc::clone(&self.disk), &self.folder)?;
        }
        let done = work(&mut stored);
        if matches!(done, Err(ServiceError::Store(_) | ServiceError::File { .. })) {
            *stored = None;
        }
        let pending = stored.as_ref().map_or(0, |stored| stored.state().pending.len());
        self.pending.send_replace(pending);
        let next = stored.as_ref().and_then(|stored| stored.state().next);
        self.next.send_if_modified(|known| std::mem::replace(known, next) != next);
        done
    }

    /// Runs `work` on the stored stream; returns an error if it does not exist.
    pub(super) fn with_stored<T>(
        &self,
        work: impl FnOnce(&mut StoredStream) -> Result<T, ServiceError>,
    ) -> Result<T, ServiceError> {
        self.with(|stored| match stored {
            Some(stored) => work(stored),
            None => Err(self.unknown()),
        })
    }

    pub(super) fn unknown(&self) -> ServiceError {
        ServiceError::StreamUnknown { asset: self.asset.clone(), name: self.name.clone() }
    }

    /// Waits for a running write, and allows no further one.
    pub(super) fn close(&self) {
        let mut stored = self.stored.lock().unwrap_or_else(PoisonError::into_inner);
        self.is_closed.store(true, Ordering::SeqCst);
        *stored = None;
    }

    /// Removes the stream from memory and disk.
    pub(super) fn remove(&self) -> Result<(), ServiceError> {
        self.take_over();
        self.feed.end();
        let mut stored = self.stored.lock().unwrap_or_else(PoisonError::into_inner);
        *stored = None;
        self.pending.send_replace(0);
        match self.disk.remove_folder(&self.folder) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(ServiceError::File { action: "remove", path: self.folder.clone(), source: error })
            }
            _ => Ok(()),
        }
    }

    /// Whether there are pending records and the caller becomes the one to store them.
    pub(super) fn begin_cutting(&self) -> bool {
        *self.pending.borrow() > 0 && !self.is_cutting.swap(true, Ordering::SeqCst)
    }

    pub(super) fn end_cutting(&self) {
        self.is_cutting.store(false, Ordering::SeqCst);
    }

    /// The next pending record with its bytes; `None` if there is none.
    pub(super) fn next_cut(&self) -> Result<Option<CutRecord>, ServiceError> {
        self.with_stored(|stored| {
            let state = stored.state();
            let Some(pending) = state.pending.front().cloned() else { return Ok(None) };
            let Some(bytes) = stored.bytes_of(pending.cut)? else {
                let (first, frames) = (pending.cut.first, pending.cut.frames);
                tracing::error!(
                    first,
                    frames,
                    "skipped a record of a stream: its samples are missing in the journal"
                );
                stored.finish_record(first, true)?;
                return Err(RecordingError::NoBytes.into());
            };
            let tachometer = stored.state().tachometer_of(pending.cut);
            let (format, asset_created_at) = (stored.state().format.clone(), stored.state().asset_created_at);
            Ok(Some(CutRecord { pending, format, asset_created_at, bytes, tachometer }))
        })
    }
}

/// A record to be sent through the pipeline.
pub(super) struct CutRecord {
    pub(super) pending: PendingCut,
    pub(super) format: crate::recording::stream::StreamFormat,
    pub(super) asset_created_at: jiff::Timestamp,
    pub(super) bytes: bytes::Bytes,
    pub(super) tachometer: Option<crate::signal::Tachometer>,
}
