//! Commands that read recordings without a server, and how recordings are named on a command line.

pub(super) mod analyze;
pub(super) mod convert;
pub(super) mod reading_progress;
pub(super) mod recording_files;
pub(super) mod recording_values;
