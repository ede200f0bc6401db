//! Errors of tokens.

use thiserror::Error;

use crate::store::StoreError;

/// Why tokens cannot be read or stored.
#[derive(Debug, Error)]
pub enum TokenError {
    /// The system provides no random numbers.
    #[error("failed to generate random bytes: {0}")]
    Random(#[source] getrandom::Error),
    /// The token does not exist.
    #[error("token {0:?} not found")]
    Unknown(String),
    /// The store failed.
    #[error("tokens: {0}")]
    Store(#[from] StoreError),
    /// The database does not answer.
    #[error("tokens: the database does not answer")]
    Timeout,
}

impl TokenError {
    /// Whether the store is unavailable, so that a retry can succeed.
    pub(crate) fn is_unavailable(&self) -> bool {
        match self {
            Self::Timeout => true,
            Self::Store(error) => error.is_unavailable(),
            _ => false,
        }
    }
}
