//! Storage of access tokens: in the shared database, or in a small database of their own.
//!
//! On one machine that is `tokens.db` in the data folder, because the service locks its own database, while
//! tokens are created and revoked by another process at the same time; tokens also outlive that database. It
//! has no write-ahead log, so that any number of processes may open it at any time.

use std::fs;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::pool::PoolConnection;
use sqlx::{Any, AnyConnection, Connection};

use super::database::rows::{get, get_named, get_time, to_ns};
use super::database::sqlite_url;
use super::database::{integrity, schema};
use super::objects::file_error;
use super::{Store, StoreError};
use crate::asset::json_name;

/// File name of the token database in a data folder.
pub(super) const FILE: &str = "tokens.db";

/// Offset of the change counter in the header of an SQLite file.
const CHANGE_COUNTER: usize = 24;

/// The scope of a token; each scope includes the previous ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Scope {
    /// Read everything.
    Read,
    /// Send records, start replays, acknowledge alarms.
    Write,
    /// Create, change and delete assets.
    Admin,
}

/// A token without its secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct Token {
    /// Identifier, the public part of the token.
    pub id: String,
    /// Name.
    pub name: String,
    /// Scope.
    pub scope: Scope,
    /// Creation time.
    pub created_at: Timestamp,
    /// SHA-256 of its secret in hexadecimal. The secret is 256 random bits, so a slow hash would add nothing.
    #[serde(skip)]
    pub sha256: String,
}

/// The tokens of a service.
#[derive(Debug, Clone)]
pub struct TokenStore {
    backend: Backend,
}

#[derive(Debug, Clone)]
enum Backend {
    File(PathBuf),
    Shared(Store),
}

/// A version of the token file, which differs after every change of the tokens.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TokensVersion(Option<u32>);

/// A connection for one operation.
enum TokenConnection {
    Own(Box<AnyConnection>),
    Pooled(PoolConnection<Any>),
}

impl TokenConnection {
    fn get(&mut self) -> &mut AnyConnection {
        match self {
            Self::Own(connection) => connection,
            Self::Pooled(connection) => connection,
        }
    }

    async fn close(self) {
        if let Self::Own(connection) = self
            && let Err(error) = connection.close().await
        {
            tracing::warn!(%error, "failed to close the token database");
        }
    }
}

impl TokenStore {
    /// The tokens of a data folder, which may have none.
    pub fn in_folder(folder: &Path) -> Self {
        Self { backend: Backend::File(folder.join(FILE)) }
    }

    /// The tokens of a shared store.
    pub fn shared(store: Store) -> Self {
        Self { backend: Backend::Shared(store) }
    }

    /// The version of the tokens; `None` for a shared store, where it is not known without a query.
    pub fn version(&self) -> Result<Option<TokensVersion>, StoreError> {
        let Backend::File(path) = &self.backend else {
            return Ok(None);
        };
        let mut head = [0; CHANGE_COUNTER + 4];
        let read = fs::File::open(path).and_then(|mut file| file.read_exact(&mut head));
        match read {
            Ok(()) => {
                let counter = [head[24], head[25], head[26], head[27]];
                Ok(Some(TokensVersion(Some(u32::from_be_bytes(counter)))))
            }
            // Not created yet, or being created.
            Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::UnexpectedEof) => {
                Ok(Some(TokensVersion(None)))
            }
            Err(error) => Err(file_error("read", path, error)),
        }
    }

    /// The valid tokens, the oldest first; `None` if there never were any.
    pub async fn tokens(&self) -> Result<Option<Vec<Token>>, StoreError> {
        if let Backend::File(path) = &self.backend
            && !path.exists()
        {
            return Ok(None);
        }
        let mut opened = self.open(false).await?;
        let selected = sqlx::query("SELECT * FROM tokens ORDER BY created_at_ns, id")
            .fetch_all(opened.get())
            .await
            .map_err(|error| self.named(error));
        opened.close().await;
        let rows = selected?;
        if rows.is_empty() {
            return Ok(None);
        }
        let mut tokens = Vec::new();
        for row in &rows {
            if get::<Option<i64>>(row, "revoked_at_ns")?.is_none() {
                let id: String = get(row, "id")?;
                tokens.push(Token {
                    scope: get_named(row, "scope", &id)?,
                    id,
                    name: get(row, "name")?,
                    created_at: get_time(row, "created_at_ns")?,
                    sha256: get(row, "sha256")?,
                });
            }
        }
        Ok(Some(tokens))
    }

    /// Stores a token; returns false if its identifier is or was in use.
    pub async fn insert(&self, token: &Token) -> Result<bool, StoreError> {
        let mut opened = self.open(true).await?;
        let inserted = sqlx::query(
            "INSERT INTO tokens (id, name, scope, created_at_ns, sha256) VALUES ($1, $2, $3, $4, $5) ON CONFLICT (id) DO NOTHING",
        )
        .bind(token.id.as_str())
        .bind(token.name.as_str())
        .bind(json_name(&token.scope))
        .bind(to_ns(token.created_at)?)
        .bind(token.sha256.as_str())
        .execute(opened.get())
        .await
        .map_err(|error| self.named(error));
        opened.close().await;
        Ok(inserted?.rows_affected() > 0)
    }

    /// Revokes a token; returns false if there is no valid one with that identifier.
    pub async fn revoke(&self, id: &str, now: Timestamp) -> Result<bool, StoreError> {
        let mut opened = self.open(true).await?;
        let revoked =
            sqlx::query("UPDATE tokens SET revoked_at_ns = $2 WHERE id = $1 AND revoked_at_ns IS NULL")
                .bind(id)
                .bind(to_ns(now)?)
                .execute(opened.get())
                .await
                .map_err(|error| self.named(error));
        opened.close().await;
        Ok(revoked?.rows_affected() > 0)
    }

    async fn open(&self, to_write: bool) -> Result<TokenConnection, StoreError> {
        match &self.backend {
            Backend::File(path) => {
                let opened = connect(path).await.map_err(|error| integrity::named(path, error))?;
                Ok(TokenConnection::Own(Box::new(opened)))
            }
            Backend::Shared(store) => {
                let pool = if to_write { store.write()? } else { store.read() };
                Ok(TokenConnection::Pooled(pool.acquire().await?))
            }
        }
    }

    fn named(&self, error: sqlx::Error) -> StoreError {
        match &self.backend {
            Backend::File(path) => integrity::named(path, error),
            Backend::Shared(_) => error.into(),
        }
    }
}

/// Opens the token database; creates it if missing, accessible only to its owner.
async fn connect(path: &Path) -> Result<AnyConnection, StoreError> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(|source| file_error("create the folder", folder, source))?;
    }
    let mut options = fs::OpenOptions::new();
    options.append(true).create(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.open(path).map_err(|source| file_error("write", path, source))?;
    sqlx::any::install_default_drivers();
    let mut connection = AnyConnection::connect(&sqlite_url(path, "rw")).await?;
    // A revoked token stays revoked, even if the power fails right after.
    for statement in ["PRAGMA busy_timeout = 10000", "PRAGMA synchronous = EXTRA", schema::TOKENS] {
        sqlx::query(statement).execute(&mut connection).await?;
    }
    Ok(connection)
}
