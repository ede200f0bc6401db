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
    #[error(
        "the database is of version {found}, this program knows versions up to {known}: it was written by a later flankwatch"
    )]
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

    /// Whether what failed may be a record's own fault: its values, or its raw object. What is said of disks,
    /// connections, locks, rights and tables is not.
    pub fn may_be_of_record(&self) -> bool {
        match self {
            Self::Database(error) => match error {
                sqlx::Error::Database(error) => error.code().is_some_and(|code| says_of_values(&code)),
                sqlx::Error::Encode(_) | sqlx::Error::Decode(_) | sqlx::Error::ColumnDecode { .. } => true,
                _ => false,
            },
            Self::File { .. } | Self::Bucket { .. } | Self::Outdated(_) | Self::DatabaseDamaged { .. } => {
                false
            }
            _ => true,
        }
    }

    /// Whether the database says that its file is not what it wrote (SQLITE_CORRUPT, SQLITE_NOTADB), lacks a
    /// table or a column, or has a value in it that cannot be one.
    pub fn is_damage(&self) -> bool {
        match self {
            Self::DatabaseDamaged { .. }
            | Self::Database(
                sqlx::Error::ColumnNotFound(_) | sqlx::Error::ColumnDecode { .. } | sqlx::Error::Decode(_),
            ) => true,
            Self::Database(sqlx::Error::Database(error)) => {
                error.code().is_some_and(|code| says_damaged(&code))
                    || error.message().starts_with("no such ")
            }
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
            Self::Database(sqlx::Error::Database(error)) => {
                error.code().is_some_and(|code| says_conflict(&code))
            }
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

/// PostgreSQL's states of a connection that was lost (08), of a server without disk, memory or connections
/// (53), that starts, stops or ended a statement that took too long (57), whose disk fails (58), or that only
/// reads.
fn says_unavailable(code: &str) -> bool {
    let is_of_class = |class| code.starts_with(class);
    code.len() == 5
        && (["08", "53", "57", "58"].into_iter().any(is_of_class) || ["25P03", "25006"].contains(&code))
}

/// PostgreSQL's states of values that do not fit (22), break a rule (23), or are too large for a row or an
/// index (54); SQLite's of the same kinds: SQLITE_TOOBIG, SQLITE_CONSTRAINT, SQLITE_MISMATCH.
fn says_of_values(code: &str) -> bool {
    if code.len() == 5 {
        return ["22", "23", "54"].into_iter().any(|class| code.starts_with(class)) && !says_conflict(code);
    }
    code.parse::<u32>().is_ok_and(|code| [18, 19, 20].contains(&(code & 0xff)))
}

/// SQLite's codes, whose lower byte says which kind; PostgreSQL's states have five characters.
fn says_damaged(code: &str) -> bool {
    code.len() < 5 && code.parse::<u32>().is_ok_and(|code| [11, 26].contains(&(code & 0xff)))
}

/// PostgreSQL's states of transactions that stood in each other's way; the same key at the same time among
/// them.
fn says_conflict(code: &str) -> bool {
    code.len() == 5 && (code.starts_with("40") || ["55P03", "23505"].contains(&code))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_of_databases_are_told_apart() {
        for code in [
            "08006", "53000", "53100", "53200", "53300", "57014", "57P01", "57P03", "58000", "58030",
            "25006", "25P03",
        ] {
            assert!(says_unavailable(code), "{code}");
            assert!(!says_of_values(code) && !says_conflict(code), "{code}");
        }
        for code in ["40001", "40003", "40P01", "55P03", "23505"] {
            assert!(says_conflict(code), "{code}");
            assert!(!says_of_values(code) && !says_unavailable(code), "{code}");
        }
        // Values, a rule, a row that is too large; SQLite's SQLITE_TOOBIG and a kind of SQLITE_CONSTRAINT.
        for code in ["22003", "22021", "23502", "23503", "54000", "18", "1299"] {
            assert!(says_of_values(code), "{code}");
            assert!(!says_conflict(code) && !says_unavailable(code), "{code}");
        }
        // A right, a table, an extension's error; SQLite: busy, read-only, I/O error, full.
        for code in ["42501", "42P01", "XX000", "P0001", "5", "8", "10", "13"] {
            assert!(!says_of_values(code), "{code}");
        }
    }
}
