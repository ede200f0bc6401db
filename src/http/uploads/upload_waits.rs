//! What the processing of resumable uploads in this process is waiting for. Kept in memory, because the
//! reason may be a full disk.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Uploads being processed, with what each waits for.
#[derive(Debug, Default)]
pub(crate) struct UploadWaits {
    by_upload: Mutex<HashMap<String, Option<String>>>,
}

impl UploadWaits {
    fn lock(&self) -> MutexGuard<'_, HashMap<String, Option<String>>> {
        self.by_upload.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Registers an upload that is being processed.
    pub(crate) fn begin(&self, upload: &str) {
        self.lock().insert(upload.to_owned(), None);
    }

    /// Sets what the processing of an upload waits for, or clears it; false if the upload was cancelled.
    pub(crate) fn set(&self, upload: &str, what: Option<&str>) -> bool {
        let mut by_upload = self.lock();
        let Some(waits_for) = by_upload.get_mut(upload) else {
            return false;
        };
        *waits_for = what.map(str::to_owned);
        true
    }

    /// What the processing of an upload waits for.
    pub(crate) fn get(&self, upload: &str) -> Option<String> {
        self.lock().get(upload).cloned().flatten()
    }

    /// Cancels an upload whose processing waits; false if it does not wait.
    pub(crate) fn cancel(&self, upload: &str) -> bool {
        let mut by_upload = self.lock();
        let waits = by_upload.get(upload).is_some_and(Option::is_some);
        waits && by_upload.remove(upload).is_some()
    }

    /// Removes an upload whose processing has ended.
    pub(crate) fn end(&self, upload: &str) {
        self.lock().remove(upload);
    }
}
