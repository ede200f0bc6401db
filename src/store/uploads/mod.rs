//! Uploads that are repeated or continued.

pub(super) mod keyed;
pub(super) mod resumable;
