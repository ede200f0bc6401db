//! Reads the pieces of an upload as one file.

use std::collections::VecDeque;
use std::io::{self, Cursor, Read};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bytes::Bytes;

use crate::store::{Store, StoreError, UploadPiece};

/// Delay before retrying while the store is unavailable.
const RETRY_AFTER: Duration = Duration::from_secs(1);

/// Reads pieces one after the other. Blocks on disk or network.
pub(crate) struct PieceReader {
    store: Store,
    upload: String,
    pieces: VecDeque<UploadPiece>,
    current: Cursor<Bytes>,
    failure: Arc<Mutex<Option<StoreError>>>,
}

impl PieceReader {
    /// Reads these pieces of an upload.
    pub(crate) fn new(store: Store, upload: String, pieces: Vec<UploadPiece>) -> Self {
        let (current, failure) = (Cursor::default(), Arc::default());
        Self { store, upload, pieces: pieces.into(), current, failure }
    }

    /// Why a piece could not be read, once that has happened: a codec reports it as an invalid recording.
    pub(crate) fn failure(&self) -> Arc<Mutex<Option<StoreError>>> {
        Arc::clone(&self.failure)
    }

    fn piece(&self, name: &str) -> Result<Bytes, StoreError> {
        loop {
            match self.store.objects().piece(&self.upload, name) {
                Err(error) if error.is_unavailable() && !self.store.is_closed() => {
                    std::thread::sleep(RETRY_AFTER)
                }
                piece => return piece,
            }
        }
    }
}

impl Read for PieceReader {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let read = self.current.read(buffer)?;
            if read > 0 || buffer.is_empty() {
                return Ok(read);
            }
            let Some(piece) = self.pieces.pop_front() else {
                return Ok(0);
            };
            let bytes = self.piece(&piece.object).map_err(|error| {
                let text = error.to_string();
                *self.failure.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                io::Error::other(text)
            })?;
            self.current = Cursor::new(bytes);
        }
    }
}
