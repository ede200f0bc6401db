//! One stream in memory: its sender, its viewers, and its pending records.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::watch;

use super::frame::{LatestSamples, frames_of};
use super::live_view::LiveViewSender;
use super::location::{StreamLocation, random, too_many};
use super::new_stream::NewStream;
use super::state::PendingCut;
use super::stored::StoredStream;
use crate::asset::AssetId;
use crate::recording::RecordingError;
use crate::recording::stream::Assembler;
use crate::service::error::ServiceError;

/// A stream of an asset.
#[derive(Debug)]
pub(crate) struct LiveStream {
    pub(crate) asset: AssetId,
    pub(crate) name: String,
    pub(super) location: StreamLocation,
    /// `None` until it is read, and after a failed write: it is then read again.
    stored: Mutex<Option<StoredStream>>,
    /// The chunks that wait for earlier ones while the stream is to be read again.
    waiting: Mutex<Option<Assembler>>,
    /// The number of the connection that sends it, also one of another process; 0 before the first one.
    owner: watch::Sender<u64>,
    /// Number of pending records.
    pending: watch::Sender<usize>,
    /// Index after the last sample; `None` if the stream is not read yet or has no sample.
    next: watch::Sender<Option<u64>>,
    pub(super) live_view: LiveViewSender,
    is_cutting: AtomicBool,
    /// Whether writing has stopped, because another process may take over.
    is_closed: AtomicBool,
    /// Whether the stream was removed: its folder may be that of a later asset of the same name by now.
    is_removed: AtomicBool,
}

impl LiveStream {
    pub(super) fn new(asset: AssetId, name: String, location: StreamLocation) -> Self {
        Self {
            asset,
            name,
            location,
            stored: Mutex::default(),
            waiting: Mutex::default(),
            owner: watch::Sender::new(0),
            pending: watch::Sender::new(0),
            next: watch::Sender::new(None),
            live_view: LiveViewSender::default(),
            is_cutting: AtomicBool::default(),
            is_closed: AtomicBool::default(),
            is_removed: AtomicBool::default(),
        }
    }

    /// Makes another connection the sender; returns its number.
    pub(super) fn take_over(&self) -> u64 {
        // Other processes number theirs too.
        let is_shared = self.location.is_shared();
        self.owner.send_modify(|owner| *owner = if is_shared { random() as u64 } else { *owner + 1 });
        *self.owner.borrow()
    }

    /// Follows the number of the sending connection.
    pub(super) fn watch_owner(&self) -> watch::Receiver<u64> {
        self.owner.subscribe()
    }

    /// Whether a connection is still the sender.
    pub(super) fn is_owner(&self, owner: u64) -> bool {
        *self.owner.borrow() == owner
    }

    pub(super) fn watch_pending(&self) -> watch::Receiver<usize> {
        self.pending.subscribe()
    }

    /// Follows the index after the last sample.
    pub(super) fn watch_next(&self) -> watch::Receiver<Option<u64>> {
        self.next.subscribe()
    }

    /// The latest samples, which stay in memory from now on.
    pub(super) fn latest(&self) -> Result<LatestSamples, ServiceError> {
        self.with_known(|stored| {
            let stored = stored.as_mut().ok_or_else(|| self.unknown())?;
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

    /// Runs `work` on the stored stream, which is read first if necessary, also what other processes
    /// appended. Blocks. After a failed write the stream is read again the next time, so that memory is never
    /// ahead of the disk; the sender's waiting chunks are kept, as it does not know of the failure.
    pub(super) fn with<T>(
        &self,
        work: impl FnOnce(&mut Option<StoredStream>) -> Result<T, ServiceError>,
    ) -> Result<T, ServiceError> {
        self.access(true, work)
    }

    /// As [`with`](Self::with), but without a look at what other processes appended: an append finds out.
    fn with_known<T>(
        &self,
        work: impl FnOnce(&mut Option<StoredStream>) -> Result<T, ServiceError>,
    ) -> Result<T, ServiceError> {
        self.access(false, work)
    }

    fn access<T>(
        &self,
        refreshes: bool,
        work: impl FnOnce(&mut Option<StoredStream>) -> Result<T, ServiceError>,
    ) -> Result<T, ServiceError> {
        let mut stored = self.stored.lock().unwrap_or_else(PoisonError::into_inner);
        if self.is_closed.load(Ordering::SeqCst) {
            return Err(ServiceError::StreamTaken);
        }
        if self.is_removed() {
            return Err(self.unknown());
        }
        let done = self.opened(&mut stored, refreshes).and_then(|()| work(&mut stored));
        if matches!(done, Err(ServiceError::Store(_) | ServiceError::File { .. }))
            && let Some(stored) = stored.take()
        {
            *self.waiting() = Some(stored.into_assembler());
        }
        let state = stored.as_ref().map(StoredStream::state);
        self.pending.send_replace(state.map_or(0, |state| state.pending.len()));
        let next = state.and_then(|state| state.next);
        self.next.send_if_modified(|known| std::mem::replace(known, next) != next);
        if let Some(sender) = state.and_then(|state| state.sender) {
            self.owner.send_if_modified(|owner| std::mem::replace(owner, sender) != sender);
        }
        done
    }

    fn opened(&self, stored: &mut Option<StoredStream>, refreshes: bool) -> Result<(), ServiceError> {
        if refreshes
            && let Some(known) = stored
            && !known.refresh()?
        {
            *stored = None;
        }
        if stored.is_none() {
            *stored = StoredStream::open(&self.location)?;
            if let Some(stored) = stored
                && let Some(assembler) = self.waiting().take()
            {
                stored.continue_with(assembler);
            }
        }
        Ok(())
    }

    fn waiting(&self) -> MutexGuard<'_, Option<Assembler>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Runs `work` on the stored stream; returns an error if it does not exist.
    pub(super) fn with_stored<T>(
        &self,
        work: impl FnOnce(&mut StoredStream) -> Result<T, ServiceError>,
    ) -> Result<T, ServiceError> {
        self.with(|stored| work(stored.as_mut().ok_or_else(|| self.unknown())?))
    }

    /// Runs `work` for a sender, who knows the stream unless another one has replaced it. The stream is
    /// created first from `new_stream` if there is none yet.
    pub(super) fn with_sent<T>(
        &self,
        owner: u64,
        new_stream: Option<NewStream>,
        work: impl FnOnce(&mut StoredStream) -> Result<T, ServiceError>,
    ) -> Result<T, ServiceError> {
        self.with_known(|stored| {
            // Checked under the lock: a new sender starts with the samples stored at that time.
            if *self.owner.borrow() != owner {
                return Err(ServiceError::StreamTaken);
            }
            if let Some(new_stream) = new_stream.filter(|_| stored.is_none()) {
                *stored = Some(self.create(new_stream, owner)?);
            }
            let stored = stored.as_mut().ok_or_else(|| self.unknown())?;
            if stored.state().sender.is_some_and(|sender| sender != owner) {
                return Err(ServiceError::StreamTaken);
            }
            work(stored)
        })
    }

    /// Creates the stream.
    ///
    /// # Errors
    /// Another process has created it in the meantime, or the asset has too many streams.
    fn create(&self, new_stream: NewStream, owner: u64) -> Result<StoredStream, ServiceError> {
        // Others may have begun since this one was opened.
        if !self.location.has_room() {
            return Err(too_many(&self.name));
        }
        let NewStream { asset_created_at, format, first } = new_stream;
        let mut stored = StoredStream::create(&self.location, asset_created_at, format, first)?;
        if self.location.is_shared() {
            if stored.state().sender.is_some() {
                return Err(ServiceError::StreamTaken);
            }
            stored.begin_sending(owner)?;
        }
        Ok(stored)
    }

    /// Whether the stream is in memory or in use.
    pub(super) fn is_used(&self) -> bool {
        self.stored.try_lock().map_or(true, |stored| stored.is_some())
    }

    pub(super) fn unknown(&self) -> ServiceError {
        ServiceError::StreamUnknown { asset: self.asset.clone(), name: self.name.clone() }
    }

    pub(super) fn held(&self) -> ServiceError {
        ServiceError::StreamHeld { asset: self.asset.clone(), name: self.name.clone() }
    }

    /// Waits for a running write, and allows no further one.
    pub(super) fn close(&self) {
        let mut stored = self.stored.lock().unwrap_or_else(PoisonError::into_inner);
        self.is_closed.store(true, Ordering::SeqCst);
        *stored = None;
    }

    /// Removes the stream from memory, and unless `keeps_folder` from its folder. Nothing uses it from then
    /// on.
    pub(super) fn remove(&self, keeps_folder: bool) -> Result<(), ServiceError> {
        self.take_over();
        self.live_view.end();
        let mut stored = self.stored.lock().unwrap_or_else(PoisonError::into_inner);
        (*stored, *self.waiting()) = (None, None);
        self.pending.send_replace(0);
        if !keeps_folder && !self.is_removed() {
            self.location.remove()?;
        }
        self.is_removed.store(true, Ordering::SeqCst);
        Ok(())
    }

    pub(super) fn is_removed(&self) -> bool {
        self.is_removed.load(Ordering::SeqCst)
    }

    /// Whether there are pending records and the caller becomes the one to store them.
    pub(super) fn begin_cutting(&self) -> bool {
        *self.pending.borrow() > 0 && !self.is_cutting.swap(true, Ordering::SeqCst)
    }

    pub(super) fn end_cutting(&self) {
        self.is_cutting.store(false, Ordering::SeqCst);
    }

    /// The next pending record with its bytes.
    pub(super) fn next_cut(&self) -> Result<NextCut, ServiceError> {
        self.with_stored(|stored| {
            let Some(pending) = stored.state().pending.front().cloned() else {
                stored.end_cutting()?;
                return Ok(NextCut::None);
            };
            if !stored.begin_cutting()? {
                return Ok(NextCut::Elsewhere);
            }
            let Some(bytes) = stored.bytes_of(pending.cut, pending.lead)? else {
                let (first, frames) = (pending.cut.first, pending.cut.frames);
                let refusal = "its samples are missing in the journal";
                tracing::error!(first, frames, "skipped a record of a stream: {refusal}");
                stored.finish_record(&pending, Some(refusal.to_owned()))?;
                return Err(RecordingError::NoBytes.into());
            };
            let tachometer = stored.state().tachometer_of(pending.cut);
            let (format, asset_created_at) = (stored.state().format.clone(), stored.state().asset_created_at);
            let record = CutRecord { pending, format, asset_created_at, bytes, tachometer };
            Ok(NextCut::Record(Box::new(record)))
        })
    }
}

/// The next record of a stream to be stored.
pub(super) enum NextCut {
    Record(Box<CutRecord>),
    /// Another process stores the records.
    Elsewhere,
    None,
}

/// A record to be sent through the pipeline.
pub(super) struct CutRecord {
    pub(super) pending: PendingCut,
    pub(super) format: crate::recording::stream::StreamFormat,
    pub(super) asset_created_at: jiff::Timestamp,
    /// Its frames, after those of its lead.
    pub(super) bytes: bytes::Bytes,
    /// The pulses that the sender gave.
    pub(super) tachometer: Option<crate::signal::Tachometer>,
}

impl CutRecord {
    /// Replaces the channel that is a tachometer by the pulses in it.
    pub(super) fn with_pulses_of_channel(mut self) -> Self {
        if self.format.tachometer().is_some() {
            self.tachometer = self.format.pulses(&self.bytes, self.pending.lead);
            let lead_bytes = self.pending.lead as usize * self.format.frame_bytes();
            (self.format, self.bytes) = self.format.without_tachometer(self.bytes.slice(lead_bytes..));
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use jiff::Timestamp;

    use super::*;
    use crate::recording::RawSample;
    use crate::recording::stream::{Chunk, CutPolicy, StreamFormat};

    fn chunk(first: u64) -> Chunk {
        Chunk { first, time_ns: None, bytes: vec![7; 200].into() }
    }

    #[test]
    fn early_chunks_survive_a_failure_of_another_task() {
        let folder = tempfile::tempdir().unwrap();
        let location = StreamLocation::in_folder(folder.path());
        let format = StreamFormat::new(RawSample::I16, 100.0, 1, None).unwrap();
        StoredStream::create(&location, Timestamp::UNIX_EPOCH, format, Some(0)).unwrap();
        let stream = LiveStream::new(AssetId::new("pump").unwrap(), "main".to_owned(), location);
        let policy = CutPolicy::new(2.0, 10.0, 100.0).unwrap().into();
        let take = |first| {
            let taken = stream.with_sent(0, None, |stored| stored.take(vec![chunk(first)], &policy)).unwrap();
            (taken.next, taken.gaps.len())
        };
        assert_eq!(take(100), (Some(0), 0));
        let failed = stream.with_stored(|_| -> Result<(), _> {
            let (path, source) = (folder.path().to_path_buf(), std::io::ErrorKind::StorageFull.into());
            Err(ServiceError::File { action: "write", path, source })
        });
        assert!(failed.is_err());
        assert_eq!(take(0), (Some(200), 0));
    }

    #[test]
    fn a_removed_stream_leaves_the_folder_to_a_later_one() {
        let folder = tempfile::tempdir().unwrap();
        let location = StreamLocation::in_folder(&folder.path().join("main"));
        let format = StreamFormat::new(RawSample::I16, 100.0, 1, None).unwrap();
        let create = || StoredStream::create(&location, Timestamp::UNIX_EPOCH, format.clone(), Some(0));
        let old = LiveStream::new(AssetId::new("pump").unwrap(), "main".to_owned(), location.clone());
        drop(create().unwrap());
        old.remove(false).unwrap();
        assert!(StoredStream::open(&location).unwrap().is_none());
        drop(create().unwrap());
        // What still holds the old one neither removes nor reads the new one.
        old.remove(false).unwrap();
        assert!(matches!(old.with_stored(|_| Ok(())), Err(ServiceError::StreamUnknown { .. })));
        assert!(StoredStream::open(&location).unwrap().is_some());
    }
}
