//! Who may use a service whose store is shared: what every node has to know.

use jiff::Timestamp;

use super::rows::{get, get_time, to_ns};
use super::{Store, StoreError};

/// What is kept of a token: not the token.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredToken {
    /// The part of the token that is no secret.
    pub id: String,
    /// What it is for.
    pub name: String,
    /// How far it reaches, in the word of the API.
    pub scope: String,
    /// When it was made.
    pub created_at: Timestamp,
    /// SHA-256 of its secret in hexadecimal.
    pub sha256: String,
}

impl Store {
    /// The tokens that stand, the oldest first; none where there never were any.
    pub async fn tokens(&self) -> Result<Option<Vec<StoredToken>>, StoreError> {
        let rows =
            sqlx::query("SELECT * FROM tokens ORDER BY created_at_ns, id").fetch_all(self.read()).await?;
        if rows.is_empty() {
            return Ok(None);
        }
        let mut tokens = Vec::new();
        for row in &rows {
            if get::<Option<i64>>(row, "revoked_at_ns")?.is_none() {
                tokens.push(StoredToken {
                    id: get(row, "id")?,
                    name: get(row, "name")?,
                    scope: get(row, "scope")?,
                    created_at: get_time(row, "created_at_ns")?,
                    sha256: get(row, "sha256")?,
                });
            }
        }
        Ok(Some(tokens))
    }

    /// Keeps a token; false where one of that identifier is there, or was.
    pub async fn insert_token(&self, token: &StoredToken) -> Result<bool, StoreError> {
        let inserted = sqlx::query(
            "INSERT INTO tokens (id, name, scope, created_at_ns, sha256) VALUES ($1, $2, $3, $4, $5) ON CONFLICT (id) DO NOTHING",
        )
        .bind(token.id.as_str())
        .bind(token.name.as_str())
        .bind(token.scope.as_str())
        .bind(to_ns(token.created_at)?)
        .bind(token.sha256.as_str())
        .execute(self.write())
        .await?;
        Ok(inserted.rows_affected() > 0)
    }

    /// Takes a token back; false where there is none that stands.
    pub async fn revoke_token(&self, id: &str, now: Timestamp) -> Result<bool, StoreError> {
        let revoked =
            sqlx::query("UPDATE tokens SET revoked_at_ns = $2 WHERE id = $1 AND revoked_at_ns IS NULL")
                .bind(id)
                .bind(to_ns(now)?)
                .execute(self.write())
                .await?;
        Ok(revoked.rows_affected() > 0)
    }
}
