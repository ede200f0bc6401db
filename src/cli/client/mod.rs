//! Commands that send requests to a server.

pub(super) mod export;
pub(super) mod records;
pub(super) mod replay;
pub(super) mod server;
pub(super) mod stream;
