//! Progress, cancellation and resumption of a build.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use super::LibraryError;
use super::part::PartStore;

/// Progress callback, cancellation and checkpoint of a build.
#[derive(Clone, Copy)]
pub struct BuildControl<'a> {
    progress: &'a (dyn Fn(usize, usize) + Sync),
    cancel: Option<&'a AtomicBool>,
    checkpoint: Option<&'a dyn PartStore>,
}

impl<'a> BuildControl<'a> {
    /// Neither reports progress nor can be cancelled.
    pub fn silent() -> Self {
        Self::with_progress(&|_, _| ())
    }

    /// Calls `progress` with the number of records simulated so far and the total.
    pub fn with_progress(progress: &'a (dyn Fn(usize, usize) + Sync)) -> Self {
        Self { progress, cancel: None, checkpoint: None }
    }

    /// Ends the build with [`LibraryError::Cancelled`] soon after `cancel` becomes true.
    #[must_use]
    pub fn cancelled_by(self, cancel: &'a AtomicBool) -> Self {
        Self { cancel: Some(cancel), ..self }
    }

    /// Stores finished parts in a checkpoint until the build succeeds, and resumes from those of an earlier
    /// build of the same library.
    #[cfg(feature = "files")]
    pub(super) fn resumed_from(self, checkpoint: &'a dyn PartStore) -> Self {
        Self { checkpoint: Some(checkpoint), ..self }
    }

    pub(super) fn checkpoint(&self) -> Option<&'a dyn PartStore> {
        self.checkpoint
    }

    pub(super) fn check(&self) -> Result<(), LibraryError> {
        match self.cancel {
            Some(cancel) if cancel.load(Ordering::Relaxed) => Err(LibraryError::Cancelled),
            _ => Ok(()),
        }
    }

    pub(super) fn cancel(&self) -> Option<&'a AtomicBool> {
        self.cancel
    }

    pub(super) fn report(&self, done: usize, total: usize) {
        (self.progress)(done, total);
    }
}

/// Counts finished records and reports progress.
pub(super) struct Counter<'a> {
    control: &'a BuildControl<'a>,
    done: AtomicUsize,
    total: usize,
}

impl<'a> Counter<'a> {
    pub(super) fn new(control: &'a BuildControl<'a>, total: usize) -> Self {
        Self { control, done: AtomicUsize::new(0), total }
    }

    pub(super) fn add(&self, count: usize) {
        let done = self.done.fetch_add(count, Ordering::Relaxed) + count;
        self.control.report(done, self.total);
    }
}
