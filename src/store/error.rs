//! What can go wrong in the store.

use std::path::PathBuf;

use thiserror::Error;

use crate::asset::AssetId;

/// Why the store could not do what it was asked.
#[derive(Debug, Error)]
pub enum StoreError {
    /// The operating system refused a file operation.
    #[error("cannot {action} {path}: {source}", path = path.display())]
    File {
        /// What was tried, for example `"create the data folder"`.
        action: &'static str,
        /// On which file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Another process works on the data folder.
    #[error("the data folder {path} is in use by another process", path = .0.display())]
    InUse(PathBuf),
    /// The database was written by a later version of the program.
    #[error("the database is of version {found}, this program knows versions up to {known}: it was written by a later flankwatch")]
    Newer {
        /// The database's version.
        found: i64,
        /// The latest version known here.
        known: i64,
    },
    /// The database refused or failed.
    #[error("database: {0}")]
    Database(#[from] sqlx::Error),
    /// A stored text cannot be read as what it should be.
    #[error("stored {what} of {of} is damaged: {source}")]
    Damaged {
        /// Which part.
        what: &'static str,
        /// Of which row.
        of: String,
        /// Why it cannot be read.
        source: serde_json::Error,
    },
    /// A stored number or name is not one the program writes.
    #[error("stored {what} is {value}, expected {expected}")]
    Unexpected {
        /// Which column.
        what: &'static str,
        /// What it holds.
        value: String,
        /// What would have been right.
        expected: &'static str,
    },
    /// A number that must not be stored.
    #[error("{field} is {value}, expected a finite number")]
    NotFinite {
        /// Which number.
        field: String,
        /// Its value.
        value: f64,
    },
    /// A time outside what the store can hold.
    #[error("time {0} is outside 1677-09-21 to 2262-04-11")]
    Time(jiff::Timestamp),
    /// There is an asset of that name already.
    #[error("asset {0} exists already")]
    AssetExists(AssetId),
    /// There is no asset of that name.
    #[error("there is no asset {0}")]
    AssetUnknown(AssetId),
    /// A raw object is not there.
    #[error("raw object {0} is missing")]
    ObjectMissing(String),
    /// A raw object's bytes are not those that were stored.
    #[error("raw object {expected} is damaged: its bytes hash to {found}")]
    ObjectDamaged {
        /// The hash that it is named by.
        expected: String,
        /// The hash of what is there.
        found: String,
    },
}

impl StoreError {
    /// Whether the disk is full, so that the same request can succeed once there is room.
    pub fn is_full(&self) -> bool {
        match self {
            Self::File { source, .. } => source.kind() == std::io::ErrorKind::StorageFull,
            // SQLITE_FULL
            Self::Database(sqlx::Error::Database(error)) => error.code().is_some_and(|code| code == "13"),
            Self::Database(sqlx::Error::Io(error)) => error.kind() == std::io::ErrorKind::StorageFull,
            _ => false,
        }
    }

    /// Whether the database or the object store is away, so that the same request can succeed once it is back.
    pub fn is_unavailable(&self) -> bool {
        use sqlx::Error;
        match self {
            Self::Database(Error::Io(_) | Error::PoolTimedOut | Error::Protocol(_) | Error::Tls(_) | Error::WorkerCrashed) => true,
            // Classes of SQLSTATE: connection, transaction rollback, resources, operator's intervention.
            Self::Database(Error::Database(error)) => error
                .code()
                .is_some_and(|code| code.len() == 5 && ["08", "40", "53", "57"].contains(&&code[..2])),
            _ => false,
        }
    }
}
