//! How a build is watched, stopped, and taken up again.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use super::LibraryError;
use super::part::PartStore;

/// How a build is watched, stopped, and taken up again where it was stopped.
#[derive(Clone, Copy)]
pub struct BuildControl<'a> {
    progress: &'a (dyn Fn(usize, usize) + Sync),
    cancel: Option<&'a AtomicBool>,
    checkpoint: Option<&'a dyn PartStore>,
}

impl<'a> BuildControl<'a> {
    /// A build that nobody watches or stops.
    pub fn silent() -> Self {
        Self::with_progress(&|_, _| ())
    }

    /// Calls `progress` with the simulated records done and their number in all.
    pub fn with_progress(progress: &'a (dyn Fn(usize, usize) + Sync)) -> Self {
        Self { progress, cancel: None, checkpoint: None }
    }

    /// Ends the build with [`LibraryError::Cancelled`] soon after `cancel` becomes true.
    #[must_use]
    pub fn cancelled_by(self, cancel: &'a AtomicBool) -> Self {
        Self { cancel: Some(cancel), ..self }
    }

    /// Keeps finished parts here until the build ends well, and takes up those of an earlier build of the
    /// same library.
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

/// Counts what is done and reports it.
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
