//! Raw bytes: stored before anything references them, removed once nothing does.

mod objects;
mod retention;
mod upload_pieces;

pub(crate) use objects::{RawObjects, UncommittedObjects};
pub(crate) use retention::Retention;
pub use upload_pieces::UploadPieces;
