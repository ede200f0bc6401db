//! Errors of the store.

use std::fmt;
use std::path::PathBuf;

use thiserror::Error;

use super::database::integrity::{FoundDamage, damage_in};
use crate::asset::AssetId;

/// Why a store operation failed.
#[derive(Debug, Error)]
pub enum StoreError {
    /// A file operation failed.
    #[error("failed to {action} {path}: {source}", path = path.display())]
    File {
        /// The operation, for example `"create the data folder"`.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A folder is not usable for the operation.
    #[error("{path} {what}", path = path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// Why it is not usable, and what was expected.
        what: &'static str,
    },
    /// Another process uses the data folder.
    #[error("the data folder {path} is in use by another process", path = .0.display())]
    InUse(PathBuf),
    /// The database was written by a later version of the program.
    #[error(
        "the database has schema version {found}, expected at most {known}: it was written by a newer version of flankwatch"
    )]
    Newer {
        /// The database's version.
        found: i64,
        /// The latest version that this program supports.
        known: i64,
    },
    /// The database is damaged.
    #[error(
        "the database {path} is damaged: {what}; restore a backup with `flankwatch restore`, or rebuild it from the raw recordings with `flankwatch rebuild`"
    )]
    DatabaseDamaged {
        /// The database file.
        path: String,
        /// The damage that was found.
        what: String,
    },
    /// The raw objects belong to another store than the database.
    #[error(
        "the raw objects belong to store {objects}, the database belongs to store {database}: two clusters must not share a bucket \
                 and prefix, or a folder; if the database was lost, rebuild it with `flankwatch rebuild`"
    )]
    OtherStore {
        /// The identity of the store that the objects belong to.
        objects: String,
        /// The identity of the store that the database belongs to.
        database: String,
    },
    /// A database operation failed.
    #[error("database: {}", match .0 {
        sqlx::Error::PoolTimedOut => &"it does not respond" as &dyn std::fmt::Display,
        other => other,
    })]
    Database(#[from] sqlx::Error),
    /// An object store operation failed.
    #[error("failed to {action} {name} in the object store: {source}")]
    Bucket {
        /// The operation, for example `"store"`.
        action: &'static str,
        /// The name of the object.
        name: String,
        /// The error of the object store or of the connection to it.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// Another transaction changed what this one is based on: it has to be prepared again.
    #[error("{0} has changed in the meantime: try again")]
    Outdated(&'static str),
    /// A thread stopped before its work on the raw objects was done: a bug.
    #[error("a thread stopped before its work on the raw recordings was done")]
    ThreadLost,
    /// A stored JSON text cannot be decoded.
    #[error("stored {what} of {of} is damaged: {source}")]
    Damaged {
        /// The column or field.
        what: &'static str,
        /// The row that it belongs to.
        of: String,
        /// Why it cannot be decoded.
        source: serde_json::Error,
    },
    /// A stored number or name has a value that the program never writes.
    #[error("stored {what} is {value}, expected {expected}")]
    Unexpected {
        /// The column.
        what: &'static str,
        /// Its value.
        value: String,
        /// What was expected.
        expected: &'static str,
    },
    /// A number is NaN or infinite and must not be stored.
    #[error("{field} is {value}, expected a finite number")]
    NotFinite {
        /// The name of the number.
        field: String,
        /// Its value.
        value: f64,
    },
    /// A time is outside the range that the store can hold.
    #[error("time is {0}, expected a time from 1677-09-21 to 2262-04-11")]
    Time(jiff::Timestamp),
    /// An asset of that name already exists.
    #[error("asset {0} already exists")]
    AssetExists(AssetId),
    /// There is no asset of that name.
    #[error("asset \"{0}\" not found")]
    AssetUnknown(AssetId),
    /// A raw object does not exist.
    #[error("raw object {0} is missing")]
    ObjectMissing(String),
    /// A raw object's bytes are not those that were stored.
    #[error("raw object {expected} is damaged: its bytes hash to {found}")]
    ObjectDamaged {
        /// The hash by which it is named.
        expected: String,
        /// The hash of its bytes.
        found: String,
    },
}

impl StoreError {
    /// Returns a closure for `map_err` on the JSON text of `what`, which belongs to `of`.
    pub(crate) fn damaged(
        what: &'static str,
        of: impl fmt::Display,
    ) -> impl FnOnce(serde_json::Error) -> Self {
        move |source| Self::Damaged { what, of: of.to_string(), source }
    }

    /// Whether the database or the object store is unavailable or overloaded: the same request can succeed
    /// later.
    pub fn is_unavailable(&self) -> bool {
        match self {
            Self::Database(error) => match error {
                sqlx::Error::Io(_) | sqlx::Error::Tls(_) => !self.is_full(),
                sqlx::Error::PoolTimedOut | sqlx::Error::PoolClosed | sqlx::Error::WorkerCrashed => true,
                // The connection ended in the middle of a response.
                sqlx::Error::Protocol(_) => true,
                sqlx::Error::Database(error) => {
                    error.code().is_some_and(|code| is_unavailability_code(&code))
                }
                _ => false,
            },
            Self::Bucket { .. } => true,
            _ => false,
        }
    }

    /// Whether the cause may be the record itself: its values, or its raw object. Errors of disks,
    /// connections, locks, permissions and tables are not.
    pub fn may_be_caused_by_record(&self) -> bool {
        match self {
            Self::Database(error) => match error {
                sqlx::Error::Database(error) => error.code().is_some_and(|code| is_value_code(&code)),
                sqlx::Error::Encode(_) | sqlx::Error::Decode(_) | sqlx::Error::ColumnDecode { .. } => true,
                _ => false,
            },
            Self::File { .. }
            | Self::Bucket { .. }
            | Self::Outdated(_)
            | Self::ThreadLost
            | Self::DatabaseDamaged { .. } => false,
            _ => true,
        }
    }

    /// Whether the database is damaged: its file is corrupt (SQLITE_CORRUPT, SQLITE_NOTADB), a table or a
    /// column is missing, or a value cannot be decoded.
    pub fn is_damage(&self) -> bool {
        self.found_damage().is_some()
    }

    /// The damage that the error reports; `None` for other errors.
    pub fn found_damage(&self) -> Option<FoundDamage> {
        match self {
            Self::DatabaseDamaged { .. } => Some(FoundDamage { what: self.to_string(), is_of_pages: false }),
            Self::Database(error) => damage_in(error),
            _ => None,
        }
    }

    /// Whether a raw object is lost or damaged.
    pub fn is_object_error(&self) -> bool {
        matches!(self, Self::ObjectMissing(_) | Self::ObjectDamaged { .. })
    }

    /// Whether the transaction conflicted with another one: prepared again, it can succeed at once.
    pub fn is_conflict(&self) -> bool {
        match self {
            Self::Outdated(_) => true,
            Self::Database(sqlx::Error::Database(error)) => {
                error.code().is_some_and(|code| is_conflict_code(&code))
            }
            _ => false,
        }
    }

    /// Whether the disk is full: the same request can succeed once there is free space.
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

/// Whether a PostgreSQL SQLSTATE says that the server is unavailable: the connection was lost (08), disk,
/// memory or connections are exhausted (53), the server starts, stops or cancelled a statement after its
/// timeout (57), its disk fails (58), it ended an idle transaction (25P03), or it is read-only (25006).
fn is_unavailability_code(code: &str) -> bool {
    let is_of_class = |class| code.starts_with(class);
    code.len() == 5
        && (["08", "53", "57", "58"].into_iter().any(is_of_class) || ["25P03", "25006"].contains(&code))
}

/// Whether a code is about the values of a statement. PostgreSQL SQLSTATEs: values out of range (22),
/// violated constraints (23), values too large for a row or an index (54). SQLite: SQLITE_TOOBIG,
/// SQLITE_CONSTRAINT, SQLITE_MISMATCH.
fn is_value_code(code: &str) -> bool {
    if code.len() == 5 {
        return ["22", "23", "54"].into_iter().any(|class| code.starts_with(class))
            && !is_conflict_code(code);
    }
    code.parse::<u32>().is_ok_and(|code| [18, 19, 20].contains(&(code & 0xff)))
}

/// Whether a PostgreSQL SQLSTATE says that transactions conflicted, for example by inserting the same key at
/// the same time.
fn is_conflict_code(code: &str) -> bool {
    code.len() == 5 && (code.starts_with("40") || ["55P03", "23505"].contains(&code))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn database_error_codes_are_classified() {
        for code in [
            "08006", "53000", "53100", "53200", "53300", "57014", "57P01", "57P03", "58000", "58030",
            "25006", "25P03",
        ] {
            assert!(is_unavailability_code(code), "{code}");
            assert!(!is_value_code(code) && !is_conflict_code(code), "{code}");
        }
        for code in ["40001", "40003", "40P01", "55P03", "23505"] {
            assert!(is_conflict_code(code), "{code}");
            assert!(!is_value_code(code) && !is_unavailability_code(code), "{code}");
        }
        // Values, a constraint, a row that is too large; SQLITE_TOOBIG and an extended SQLITE_CONSTRAINT
        // code.
        for code in ["22003", "22021", "23502", "23503", "54000", "18", "1299"] {
            assert!(is_value_code(code), "{code}");
            assert!(!is_conflict_code(code) && !is_unavailability_code(code), "{code}");
        }
        // A permission, a table, an extension's error; SQLite: busy, read-only, I/O error, full.
        for code in ["42501", "42P01", "XX000", "P0001", "5", "8", "10", "13"] {
            assert!(!is_value_code(code), "{code}");
        }
    }
}
