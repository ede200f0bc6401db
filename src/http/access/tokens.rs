//! The tokens of a service. They are stored hashed, and can be created and revoked while the service runs, by
//! the service or by `flankwatch token`.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use jiff::Timestamp;

use super::token::mint;
use super::token_error::TokenError;
use crate::store::{Scope, Store, Token, TokenStore, TokensVersion};

/// Maximum age of a node's cached tokens: after this time a created or revoked token is accepted or refused
/// everywhere.
const MAX_AGE: Duration = Duration::from_secs(2);

/// How long cached tokens stay valid while the database is unavailable; during that time nobody can revoke
/// tokens either.
const MAX_AGE_WITHOUT_DATABASE: Duration = Duration::from_secs(300);

/// Timeout of the database.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(3);

/// The tokens of a service.
#[derive(Debug)]
pub struct Tokens {
    store: TokenStore,
    known: Mutex<Option<CachedTokens>>,
    /// Held while reading the database, so that it is read once.
    asking: tokio::sync::Mutex<()>,
}

/// Cached tokens and when they were read.
#[derive(Debug, Clone)]
struct CachedTokens {
    tokens: Option<Arc<Vec<Token>>>,
    /// The store's state at that time, where available.
    version: Option<TokensVersion>,
    read_at: Instant,
    tried_at: Instant,
}

impl Tokens {
    /// The tokens of a data folder; there may be none.
    pub fn of(data_dir: &Path) -> Self {
        Self::kept_in(TokenStore::in_folder(data_dir))
    }

    /// The tokens of a store shared by processes; there may be none.
    pub fn shared(store: Store) -> Self {
        Self::kept_in(TokenStore::shared(store))
    }

    fn kept_in(store: TokenStore) -> Self {
        Self { store, known: Mutex::default(), asking: tokio::sync::Mutex::default() }
    }

    /// Returns all tokens; in a shared store, possibly slightly outdated. `None` if there never were any.
    pub async fn list(&self) -> Result<Option<Arc<Vec<Token>>>, TokenError> {
        if let Some(tokens) = self.cached()? {
            return Ok(tokens);
        }
        let _guard = self.asking.lock().await;
        // Another request may have read them in the meantime
        if let Some(tokens) = self.cached()? {
            return Ok(tokens);
        }
        let version = self.store.version()?;
        let result = tokio::time::timeout(RESPONSE_TIMEOUT, self.read()).await;
        let result = result.unwrap_or(Err(TokenError::Timeout));
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        match result {
            Ok(tokens) => {
                let now = Instant::now();
                let read = CachedTokens { tokens: tokens.clone(), version, read_at: now, tried_at: now };
                // Changes made in the meantime are read by the next request
                *known = (self.store.version()? == version).then_some(read);
                Ok(tokens)
            }
            Err(error) => match known.as_mut() {
                Some(known)
                    if error.is_unavailable() && known.read_at.elapsed() < MAX_AGE_WITHOUT_DATABASE =>
                {
                    tracing::warn!(%error, "failed to read tokens; using cached ones");
                    known.tried_at = Instant::now();
                    Ok(known.tokens.clone())
                }
                _ => Err(error),
            },
        }
    }

    /// Cached tokens, if they are recent enough.
    fn cached(&self) -> Result<Option<Option<Arc<Vec<Token>>>>, TokenError> {
        let version = self.store.version()?;
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let counts = |known: &&CachedTokens| match version {
            Some(_) => known.version == version,
            None => known.tried_at.elapsed() < MAX_AGE && known.read_at.elapsed() < MAX_AGE_WITHOUT_DATABASE,
        };
        Ok(known.as_ref().filter(counts).map(|known| known.tokens.clone()))
    }

    /// Makes the next request read the database: this node sees its own changes at once.
    fn invalidate(&self) {
        *self.known.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    async fn read(&self) -> Result<Option<Arc<Vec<Token>>>, TokenError> {
        Ok(self.store.tokens().await?.map(Arc::new))
    }

    /// Creates a token and returns it; it cannot be retrieved later.
    pub async fn create(&self, name: &str, scope: Scope, now: Timestamp) -> Result<String, TokenError> {
        Ok(self.issue(name, scope, now).await?.0)
    }

    /// Creates a token; returns it and its stored part.
    pub(crate) async fn issue(
        &self,
        name: &str,
        scope: Scope,
        now: Timestamp,
    ) -> Result<(String, Token), TokenError> {
        loop {
            let (token, stored) = mint(name, scope, now)?;
            if self.store.insert(&stored).await? {
                self.invalidate();
                return Ok((token, stored));
            }
        }
    }

    /// Revokes a token: at once on this node, a moment later on others.
    pub async fn revoke(&self, id: &str, now: Timestamp) -> Result<(), TokenError> {
        if self.store.revoke(id, now).await? {
            self.invalidate();
            Ok(())
        } else {
            Err(TokenError::Unknown(id.to_owned()))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::access::token::find;

    #[tokio::test]
    async fn a_token_is_valid_until_revoked_and_its_secret_is_not_stored() {
        let folder = tempfile::tempdir().unwrap();
        let tokens = Tokens::of(folder.path());
        assert!(tokens.list().await.unwrap().is_none());
        let now = Timestamp::UNIX_EPOCH;
        let first = tokens.create("press line", Scope::Write, now).await.unwrap();
        let second = tokens.create("display", Scope::Read, now).await.unwrap();
        let stored = tokens.list().await.unwrap().unwrap();
        assert_eq!(find(&stored, &first).unwrap().scope, Scope::Write);
        assert_eq!(find(&stored, &second).unwrap().name, "display");
        let bytes = std::fs::read(folder.path().join("tokens.db")).unwrap();
        let text = String::from_utf8_lossy(&bytes);
        assert!(text.contains("press line") && !text.contains(first.rsplit('_').next().unwrap()));
        let mut wrong = first.clone();
        wrong.replace_range(first.len() - 1.., if first.ends_with('0') { "1" } else { "0" });
        for presented in [wrong.as_str(), "", "fwt", "fwt__", &first[4..], &first[..20]] {
            assert!(find(&stored, presented).is_none(), "{presented}");
        }
        let id = find(&stored, &first).unwrap().id.clone();
        tokens.revoke(&id, now).await.unwrap();
        let stored = tokens.list().await.unwrap().unwrap();
        assert!(find(&stored, &first).is_none() && find(&stored, &second).is_some());
        for unknown in [id.as_str(), "none"] {
            assert!(matches!(tokens.revoke(unknown, now).await, Err(TokenError::Unknown(_))));
        }
    }

    #[tokio::test]
    async fn changes_of_another_process_take_effect_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let (here, elsewhere) = (Tokens::of(folder.path()), Tokens::of(folder.path()));
        assert!(here.list().await.unwrap().is_none());
        for count in 1..=5 {
            elsewhere.create("a", Scope::Read, Timestamp::UNIX_EPOCH).await.unwrap();
            assert_eq!(here.list().await.unwrap().unwrap().len(), count);
        }
        let stored = here.list().await.unwrap().unwrap();
        for (count, token) in stored.iter().enumerate() {
            elsewhere.revoke(&token.id, Timestamp::UNIX_EPOCH).await.unwrap();
            assert_eq!(here.list().await.unwrap().unwrap().len(), stored.len() - count - 1);
        }
    }

    #[tokio::test]
    async fn a_file_that_is_not_a_database_is_named() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("tokens.db"), [7_u8; 4096]).unwrap();
        let error = Tokens::of(folder.path()).list().await.unwrap_err().to_string();
        assert!(error.contains("tokens.db"), "{error}");
    }

    #[cfg(unix)]
    #[tokio::test]
    async fn only_the_owner_can_read_the_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        Tokens::of(folder.path()).create("a", Scope::Read, Timestamp::UNIX_EPOCH).await.unwrap();
        let mode = std::fs::metadata(folder.path().join("tokens.db")).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }
}
