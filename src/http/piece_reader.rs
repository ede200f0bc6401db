//! Reads the pieces of an upload as one file.

use std::collections::VecDeque;
use std::io::{self, Cursor, Read};
use std::time::Duration;

use bytes::Bytes;

use crate::store::{Store, StoreError, UploadPiece};

/// Delay before retrying while the store is unavailable.
const RETRY_AFTER: Duration = Duration::from_secs(1);

/// Reads pieces one after the other. Blocks on disk or network.
pub(super) struct PieceReader {
    store: Store,
    upload: String,
    pieces: VecDeque<UploadPiece>,
    current: Cursor<Bytes>,
}

impl PieceReader {
    /// Reads these pieces of an upload.
    pub(super) fn new(store: Store, upload: String, pieces: Vec<UploadPiece>) -> Self {
        Self { store, upload, pieces: pieces.into(), current: Cursor::default() }
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
            self.current = Cursor::new(self.piece(&piece.object).map_err(io::Error::other)?);
        }
    }
}
