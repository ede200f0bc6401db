//! Raw bytes: stored before anything refers to them, removed when nothing does any more.

mod objects;
mod retention;
mod upload_pieces;

pub(crate) use objects::{RawObjects, UncommittedObjects};
pub(crate) use retention::Retention;
pub use upload_pieces::UploadPieces;
