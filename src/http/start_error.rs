//! Why the service does not run.

use std::net::SocketAddr;
use std::path::PathBuf;

use thiserror::Error;

use super::tokens::TokenError;
use crate::service::ServiceError;
use crate::store::StoreError;

/// Why the service does not run.
#[derive(Debug, Error)]
pub enum StartError {
    /// The data folder, or the store that it points to, cannot be used.
    #[error("cannot use the data folder {path}: {source}", path = path.display())]
    DataDir {
        /// The folder.
        path: PathBuf,
        /// Why not.
        source: StoreError,
    },
    /// A part could not be started.
    #[error(transparent)]
    Service(#[from] ServiceError),
    /// The address cannot be listened on.
    #[error("cannot listen on {address}: {source}{hint}", hint = if source.kind() == std::io::ErrorKind::AddrInUse { "; is another flankwatch running? --listen takes another address" } else { "" })]
    Listen {
        /// The address.
        address: SocketAddr,
        /// What the system said.
        source: std::io::Error,
    },
    /// Everyone could do everything from elsewhere.
    #[error(
        "listening on {0} needs tokens, and there are none: make one with `flankwatch token create`, listen on 127.0.0.1, or say \
         --insecure-no-tokens where everyone who reaches the address may do everything"
    )]
    NoTokens(SocketAddr),
    /// The tokens cannot be read.
    #[error(transparent)]
    Tokens(#[from] TokenError),
    /// Certificate or key cannot be used.
    #[error("cannot use {path} for TLS: {reason}", path = path.display())]
    Tls {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
    /// A setting does not go with another.
    #[error("{field} is {value}, expected {expected}")]
    Setting {
        /// Which setting.
        field: &'static str,
        /// Its value.
        value: String,
        /// What would have been right.
        expected: String,
    },
    /// The server ended by itself.
    #[error("the server stopped: {0}")]
    Stopped(String),
}
