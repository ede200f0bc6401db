//! What handlers read from a request: bodies, queries, conditions and selections of records.

pub(super) mod body;
mod content_encoding;
pub(super) mod etag;
mod json_error;
pub(super) mod query;
pub(super) mod selection;
