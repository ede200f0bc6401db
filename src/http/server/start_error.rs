//! Why the service could not start or stopped.

use std::net::SocketAddr;
use std::path::PathBuf;

use thiserror::Error;

use crate::http::access::token_error::TokenError;
use crate::service::ServiceError;
use crate::settings::SettingError;
use crate::store::StoreError;

/// Why the service could not start or stopped.
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
    /// Cannot listen on the address.
    #[error("cannot listen on {address}: {source}{hint}", hint = if source.kind() == std::io::ErrorKind::AddrInUse { "; is another flankwatch running? --listen takes another address" } else { "" })]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The system's error.
        source: std::io::Error,
    },
    /// Anyone could access everything from other machines.
    #[error(
        "listening on {0} needs tokens, and there are none: create one with `flankwatch token create`, listen on 127.0.0.1, or pass \
         --insecure-no-tokens if everyone who can reach this address may do everything"
    )]
    NoTokens(SocketAddr),
    /// The tokens cannot be read.
    #[error(transparent)]
    Tokens(#[from] TokenError),
    /// Certificate or key is invalid.
    #[error("cannot use {path} for TLS: {reason}", path = path.display())]
    Tls {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
    /// A setting conflicts with another.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// The server stopped unexpectedly.
    #[error("the server stopped: {0}")]
    Stopped(String),
}
