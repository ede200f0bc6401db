//! One stream in memory: who sends it, and its records on their way into the pipeline.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use tokio::sync::watch;

use super::feed::LiveFeed;
use super::frame::{Latest, frames_of};
use super::state::PendingCut;
use super::stored::StoredStream;
use crate::asset::AssetId;
use crate::recording::RecordingError;
use crate::service::error::ServiceError;

/// A stream of an asset.
#[derive(Debug)]
pub(crate) struct LiveStream {
    pub(crate) asset: AssetId,
    pub(crate) name: String,
    pub(crate) folder: PathBuf,
    /// None until it is read, and after its files could not be written: then it is read again.
    stored: Mutex<Option<StoredStream>>,
    /// The number of the connection that sends it; 0 where none has or its asset is gone.
    owner: watch::Sender<u64>,
    /// Records that are still to be made.
    pending: watch::Sender<usize>,
    /// Index after the last sample; None where it was not read yet or there is none.
    next: watch::Sender<Option<u64>>,
    pub(super) feed: LiveFeed,
    is_cutting: AtomicBool,
    /// Nothing is written any more: another process may go on with it.
    is_closed: AtomicBool,
}

impl LiveStream {
    pub(super) fn new(asset: AssetId, name: String, folder: PathBuf) -> Self {
        Self {
            asset,
            name,
            folder,
            stored: Mutex::default(),
            owner: watch::Sender::new(0),
            pending: watch::Sender::new(0),
            next: watch::Sender::new(None),
            feed: LiveFeed::default(),
            is_cutting: AtomicBool::default(),
            is_closed: AtomicBool::default(),
        }
    }

    /// The stream is sent by another connection from now on; returns its number.
    pub(super) fn take_over(&self) -> u64 {
        self.owner.send_modify(|owner| *owner += 1);
        *self.owner.borrow()
    }

    /// Tells when another connection has taken over.
    pub(super) fn follow_owner(&self) -> watch::Receiver<u64> {
        self.owner.subscribe()
    }

    pub(super) fn is_owner(&self, owner: u64) -> bool {
        *self.owner.borrow() == owner
    }

    pub(super) fn follow_pending(&self) -> watch::Receiver<usize> {
        self.pending.subscribe()
    }

    /// Tells how far the samples are.
    pub(super) fn follow_next(&self) -> watch::Receiver<Option<u64>> {
        self.next.subscribe()
    }

    /// The latest samples, which are held in memory from now on.
    pub(super) fn latest(&self) -> Result<Latest, ServiceError> {
        self.with_stored(|stored| {
            let (first, bytes) = stored.recent(frames_of(&stored.state().format))?;
            let state = stored.state();
            let end = first + (bytes.len() / state.format.frame_bytes()) as u64;
            Ok(Latest {
                format: state.format.clone(),
                first,
                bytes,
                time: end.checked_sub(1).and_then(|last| state.time(last)),
                operating_point: state.operating_point(),
            })
        })
    }

    /// Nobody watches any more.
    pub(super) fn forget_latest(&self) {
        let mut stored = self.stored.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(stored) = stored.as_mut() {
            stored.forget_recent();
        }
    }

    /// Works on what is stored, which is read where it is not yet, on the thread that asks. Where files
    /// cannot be written it is read again the next time: nothing in memory is ahead of the disk.
    pub(super) fn with<T>(
        &self,
        work: impl FnOnce(&mut Option<StoredStream>) -> Result<T, ServiceError>,
    ) -> Result<T, ServiceError> {
        let mut stored = self.stored.lock().unwrap_or_else(PoisonError::into_inner);
        if self.is_closed.load(Ordering::SeqCst) {
            return Err(ServiceError::StreamTaken);
        }
        if stored.is_none() {
            *stored = StoredStream::open(&self.folder)?;
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

    /// The same of a stream that is there.
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

    /// Waits for what is being written, and writes nothing after it.
    pub(super) fn close(&self) {
        let mut stored = self.stored.lock().unwrap_or_else(PoisonError::into_inner);
        self.is_closed.store(true, Ordering::SeqCst);
        *stored = None;
    }

    /// Removes everything that is kept of it.
    pub(super) fn remove(&self) -> Result<(), ServiceError> {
        self.take_over();
        self.feed.end();
        let mut stored = self.stored.lock().unwrap_or_else(PoisonError::into_inner);
        *stored = None;
        self.pending.send_replace(0);
        match std::fs::remove_dir_all(&self.folder) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(ServiceError::File { action: "remove", path: self.folder.clone(), source: error })
            }
            _ => Ok(()),
        }
    }

    /// Whether the caller is the one to make its records now.
    pub(super) fn begin_cutting(&self) -> bool {
        *self.pending.borrow() > 0 && !self.is_cutting.swap(true, Ordering::SeqCst)
    }

    pub(super) fn end_cutting(&self) {
        self.is_cutting.store(false, Ordering::SeqCst);
    }

    /// The next record that is to be made, with its bytes; none where there is none.
    pub(super) fn next_cut(&self) -> Result<Option<CutRecord>, ServiceError> {
        self.with_stored(|stored| {
            let state = stored.state();
            let Some(pending) = state.pending.front().cloned() else { return Ok(None) };
            let Some(bytes) = stored.bytes_of(pending.cut)? else {
                let (first, frames) = (pending.cut.first, pending.cut.frames);
                tracing::error!(first, frames, "samples of a stream that were to become a record are gone");
                stored.done(first, true)?;
                return Err(RecordingError::NoBytes.into());
            };
            let tachometer = stored.state().tachometer_of(pending.cut);
            let (format, asset_created_at) = (stored.state().format.clone(), stored.state().asset_created_at);
            Ok(Some(CutRecord { pending, format, asset_created_at, bytes, tachometer }))
        })
    }
}

/// A record on its way into the pipeline.
pub(super) struct CutRecord {
    pub(super) pending: PendingCut,
    pub(super) format: crate::recording::stream::StreamFormat,
    pub(super) asset_created_at: jiff::Timestamp,
    pub(super) bytes: bytes::Bytes,
    pub(super) tachometer: Option<crate::signal::Tachometer>,
}
