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
    /// A folder cannot be used for what was asked.
    #[error("{path} {what}", path = path.display())]
    Place {
        /// The folder.
        path: PathBuf,
        /// Why not, and what was expected.
        what: &'static str,
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
    /// The database is damaged.
    #[error(
        "the database {path} is damaged: {what}; `flankwatch restore` takes a backup, `flankwatch rebuild` makes it again from the raw recordings"
    )]
    DatabaseDamaged {
        /// Its file.
        path: String,
        /// What was found.
        what: String,
    },
    /// The raw objects are those of another store.
    #[error(
        "the object store is that of store {objects}, and the database is of store {database}: two clusters must not share a bucket and \
         prefix, or a folder; where the database was lost, `flankwatch rebuild` makes it again"
    )]
    OtherStore {
        /// The store that the objects are of.
        objects: String,
        /// The store that the database is of.
        database: String,
    },
    /// The database refused or failed.
    #[error("database: {0}")]
    Database(#[from] sqlx::Error),
    /// The object store refused or failed.
    #[error("cannot {action} {name} in the object store: {source}")]
    Bucket {
        /// What was tried, for example `"store"`.
        action: &'static str,
        /// On which object.
        name: String,
        /// What the object store or the way to it said.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// What a transaction rests on was changed by another one meanwhile: it is to be prepared again.
    #[error("{0} changed meanwhile: try again")]
    Outdated(&'static str),
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
    /// Whether the database or the object store is away, or too busy: the same request can succeed later.
    pub fn is_unavailable(&self) -> bool {
        match self {
            Self::Database(error) => match error {
                sqlx::Error::Io(_) | sqlx::Error::Tls(_) => !self.is_full(),
                sqlx::Error::PoolTimedOut | sqlx::Error::PoolClosed | sqlx::Error::WorkerCrashed => true,
                // A connection that ended in the middle of an answer.
                sqlx::Error::Protocol(_) => true,
                sqlx::Error::Database(error) => error.code().is_some_and(|code| says_unavailable(&code)),
                _ => false,
            },
            Self::Bucket { .. } => true,
            _ => false,
        }
    }

    /// Whether the database says that its file is not what it wrote (SQLITE_CORRUPT, SQLITE_NOTADB).
    pub fn is_damage(&self) -> bool {
        match self {
            Self::DatabaseDamaged { .. } => true,
            Self::Database(sqlx::Error::Database(error)) => error.code().is_some_and(|code| says_damaged(&code)),
            _ => false,
        }
    }

    /// Whether a raw object is lost or damaged.
    pub fn is_of_object(&self) -> bool {
        matches!(self, Self::ObjectMissing(_) | Self::ObjectDamaged { .. })
    }

    /// Whether another transaction was in the way: the same one prepared again can succeed at once.
    pub fn is_conflict(&self) -> bool {
        match self {
            Self::Outdated(_) => true,
            Self::Database(sqlx::Error::Database(error)) => error.code().is_some_and(|code| says_conflict(&code)),
            _ => false,
        }
    }

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
}

/// PostgreSQL's states of a connection that was lost, of a server that starts or stops, that has no more room
/// for connections, or that ended a statement that took too long.
fn says_unavailable(code: &str) -> bool {
    code.len() == 5 && (code.starts_with("08") || code.starts_with("57") || code == "53300" || code == "25P03" || code == "25006")
}

/// SQLite's codes, whose lower byte says which kind; PostgreSQL's states have five characters.
fn says_damaged(code: &str) -> bool {
    code.len() < 5 && code.parse::<u32>().is_ok_and(|code| [11, 26].contains(&(code & 0xff)))
}

/// PostgreSQL's states of transactions that stood in each other's way; the same key at the same time among
/// them.
fn says_conflict(code: &str) -> bool {
    ["40001", "40P01", "55P03", "23505"].contains(&code)
}
