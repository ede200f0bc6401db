//! What the reading of resumable uploads waits for in this process. It is kept in memory, as it may be room
//! on the disk.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Uploads that are being read, with what each waits for.
#[derive(Debug, Default)]
pub(super) struct ReadingWaits {
    by_upload: Mutex<HashMap<String, Option<String>>>,
}

impl ReadingWaits {
    fn lock(&self) -> MutexGuard<'_, HashMap<String, Option<String>>> {
        self.by_upload.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// An upload is being read from now on.
    pub(super) fn begin(&self, upload: &str) {
        self.lock().insert(upload.to_owned(), None);
    }

    /// Says what the reading of an upload waits for, or that it does not; false where the upload was given
    /// up.
    pub(super) fn set(&self, upload: &str, what: Option<&str>) -> bool {
        let mut by_upload = self.lock();
        let Some(waits_for) = by_upload.get_mut(upload) else {
            return false;
        };
        *waits_for = what.map(str::to_owned);
        true
    }

    /// What the reading of an upload waits for.
    pub(super) fn get(&self, upload: &str) -> Option<String> {
        self.lock().get(upload).cloned().flatten()
    }

    /// Takes an upload out whose reading waits; false where it does not.
    pub(super) fn give_up(&self, upload: &str) -> bool {
        let mut by_upload = self.lock();
        let waits = by_upload.get(upload).is_some_and(Option::is_some);
        waits && by_upload.remove(upload).is_some()
    }

    /// An upload is not being read any more.
    pub(super) fn end(&self, upload: &str) {
        self.lock().remove(upload);
    }
}
