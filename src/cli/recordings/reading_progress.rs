//! Progress of a command that reads recordings: bytes of all files, with the time left.

use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};

use crate::cli::output::print_stderr;

/// A progress bar on standard error, drawn only on a terminal; removed on drop.
pub(in crate::cli) struct ReadingProgress {
    bar: ProgressBar,
    files: usize,
    begun: usize,
    /// Bytes of the files before the current one, and with it.
    before: u64,
    after: u64,
}

impl ReadingProgress {
    pub(in crate::cli) fn new(files: &[PathBuf]) -> Self {
        let bytes = files.iter().map(|path| length(path)).sum();
        let style =
            ProgressStyle::with_template("{bar:32} {bytes}/{total_bytes} {elapsed}, {eta} left, {msg}");
        let bar = ProgressBar::new(bytes).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        Self { bar, files: files.len(), begun: 0, before: 0, after: 0 }
    }

    /// Begins the next file.
    pub(in crate::cli) fn begin(&mut self, path: &Path) {
        self.begun += 1;
        self.before = self.after;
        self.after += length(path);
        self.bar.set_position(self.before);
        self.bar.set_message(format!("file {} of {}", self.begun, self.files));
    }

    /// Sets the bytes read of the current file.
    pub(in crate::cli) fn set_read(&self, bytes: u64) {
        self.bar.set_position(self.after.min(self.before + bytes));
    }

    /// Prints a line on standard error above the bar.
    pub(in crate::cli) fn print(&self, line: &str) {
        self.bar.suspend(|| print_stderr(line));
    }
}

impl Drop for ReadingProgress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// The length of a file; an unreadable one has its own error later.
fn length(path: &Path) -> u64 {
    path.metadata().map_or(0, |metadata| metadata.len())
}
