//! The tokens of a service: who may do what. They are kept hashed, and are made and revoked while the service
//! runs, by itself or by `flankwatch token`.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use jiff::Timestamp;
use thiserror::Error;

use super::token::{Scope, Token, mint};
use crate::store::{Store, StoreError, TokenStore, TokensVersion};

/// How old what a node knows may be: so long after it was made or revoked a token is taken or refused
/// everywhere.
const KNOWN_FOR: Duration = Duration::from_secs(2);

/// How long what was known goes on to count while the database is away, when nobody can revoke anything
/// either.
const KNOWN_WITHOUT_DATABASE: Duration = Duration::from_secs(300);

/// How long the database has to answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(3);

/// Why tokens cannot be read or kept.
#[derive(Debug, Error)]
pub enum TokenError {
    /// The system gives no random numbers.
    #[error("no random numbers are to be had: {0}")]
    Random(String),
    /// There is no such token.
    #[error("there is no token {0:?}")]
    Unknown(String),
    /// Where they are kept refused or failed.
    #[error("tokens: {0}")]
    Store(#[from] StoreError),
    /// The database does not answer.
    #[error("tokens: the database does not answer")]
    Silent,
    /// What is stored of one is not understood.
    #[error("token {id}: {reason}")]
    Stored {
        /// Which token.
        id: String,
        /// What is wrong with it.
        reason: String,
    },
}

impl TokenError {
    /// Whether the store is away, so that asking again can succeed later.
    pub(super) fn is_unavailable(&self) -> bool {
        match self {
            Self::Silent => true,
            Self::Store(error) => error.is_unavailable(),
            _ => false,
        }
    }
}

/// The tokens of a service.
#[derive(Debug)]
pub struct Tokens {
    store: TokenStore,
    known: Mutex<Option<Known>>,
    /// Held while the database is asked, so that it is asked once.
    asking: tokio::sync::Mutex<()>,
}

/// What was read, and when.
#[derive(Debug, Clone)]
struct Known {
    tokens: Option<Arc<Vec<Token>>>,
    /// The state that they were read in, where states are told.
    version: Option<TokensVersion>,
    read_at: Instant,
    tried_at: Instant,
}

impl Tokens {
    /// The tokens of a data folder; there need not be any.
    pub fn of(data_dir: &Path) -> Self {
        Self::kept_in(TokenStore::in_folder(data_dir))
    }

    /// The tokens of a store that processes share; there need not be any.
    pub fn shared(store: Store) -> Self {
        Self::kept_in(TokenStore::shared(store))
    }

    fn kept_in(store: TokenStore) -> Self {
        Self { store, known: Mutex::default(), asking: tokio::sync::Mutex::default() }
    }

    /// All tokens; where processes share them, as they were a moment ago. None where there never were any.
    pub async fn list(&self) -> Result<Option<Arc<Vec<Token>>>, TokenError> {
        if let Some(tokens) = self.known_now()? {
            return Ok(tokens);
        }
        let _turn = self.asking.lock().await;
        // Another request may have asked meanwhile.
        if let Some(tokens) = self.known_now()? {
            return Ok(tokens);
        }
        let version = self.store.version()?;
        let asked = tokio::time::timeout(ANSWER_TIMEOUT, self.read()).await;
        let asked = asked.unwrap_or(Err(TokenError::Silent));
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        match asked {
            Ok(tokens) => {
                let now = Instant::now();
                let read = Known { tokens: tokens.clone(), version, read_at: now, tried_at: now };
                // What changed meanwhile is read by the next request.
                *known = (self.store.version()? == version).then_some(read);
                Ok(tokens)
            }
            Err(error) => match known.as_mut() {
                Some(known) if error.is_unavailable() && known.read_at.elapsed() < KNOWN_WITHOUT_DATABASE => {
                    tracing::warn!(%error, "failed to read tokens: going on with those known");
                    known.tried_at = Instant::now();
                    Ok(known.tokens.clone())
                }
                _ => Err(error),
            },
        }
    }

    /// What is known, where it need not be asked for now.
    fn known_now(&self) -> Result<Option<Option<Arc<Vec<Token>>>>, TokenError> {
        let version = self.store.version()?;
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let counts = |known: &&Known| match version {
            Some(_) => known.version == version,
            None => known.tried_at.elapsed() < KNOWN_FOR && known.read_at.elapsed() < KNOWN_WITHOUT_DATABASE,
        };
        Ok(known.as_ref().filter(counts).map(|known| known.tokens.clone()))
    }

    /// Has the next request ask the database: this node sees its own changes at once.
    fn forget(&self) {
        *self.known.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    async fn read(&self) -> Result<Option<Arc<Vec<Token>>>, TokenError> {
        let Some(stored) = self.store.tokens().await? else {
            return Ok(None);
        };
        let tokens: Vec<Token> = stored.into_iter().map(Token::try_from).collect::<Result<_, _>>()?;
        Ok(Some(Arc::new(tokens)))
    }

    /// Makes a token and returns it; it cannot be had again.
    pub async fn create(&self, name: &str, scope: Scope, now: Timestamp) -> Result<String, TokenError> {
        Ok(self.issue(name, scope, now).await?.0)
    }

    /// Makes a token; returns it and what is kept of it.
    pub(super) async fn issue(
        &self,
        name: &str,
        scope: Scope,
        now: Timestamp,
    ) -> Result<(String, Token), TokenError> {
        loop {
            let (token, kept) = mint(name, scope, now)?;
            if self.store.insert(&kept.clone().into()).await? {
                self.forget();
                return Ok((token, kept));
            }
        }
    }

    /// Takes a token back: it opens nothing from now on, on another node a moment later.
    pub async fn revoke(&self, id: &str, now: Timestamp) -> Result<(), TokenError> {
        if self.store.revoke(id, now).await? {
            self.forget();
            Ok(())
        } else {
            Err(TokenError::Unknown(id.to_owned()))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::token::find;
    use super::*;

    #[tokio::test]
    async fn a_token_is_found_until_it_is_revoked_and_never_kept() {
        let folder = tempfile::tempdir().unwrap();
        let tokens = Tokens::of(folder.path());
        assert!(tokens.list().await.unwrap().is_none());
        let now = Timestamp::UNIX_EPOCH;
        let first = tokens.create("press line", Scope::Write, now).await.unwrap();
        let second = tokens.create("display", Scope::Read, now).await.unwrap();
        let kept = tokens.list().await.unwrap().unwrap();
        assert_eq!(find(&kept, &first).unwrap().scope, Scope::Write);
        assert_eq!(find(&kept, &second).unwrap().name, "display");
        let bytes = std::fs::read(folder.path().join("tokens.db")).unwrap();
        let text = String::from_utf8_lossy(&bytes);
        assert!(text.contains("press line") && !text.contains(first.rsplit('_').next().unwrap()));
        let mut wrong = first.clone();
        wrong.replace_range(first.len() - 1.., if first.ends_with('0') { "1" } else { "0" });
        for presented in [wrong.as_str(), "", "fwt", "fwt__", &first[4..], &first[..20]] {
            assert!(find(&kept, presented).is_none(), "{presented}");
        }
        let id = find(&kept, &first).unwrap().id.clone();
        tokens.revoke(&id, now).await.unwrap();
        let kept = tokens.list().await.unwrap().unwrap();
        assert!(find(&kept, &first).is_none() && find(&kept, &second).is_some());
        for unknown in [id.as_str(), "none"] {
            assert!(matches!(tokens.revoke(unknown, now).await, Err(TokenError::Unknown(_))));
        }
    }

    #[tokio::test]
    async fn what_another_process_changes_counts_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let (here, elsewhere) = (Tokens::of(folder.path()), Tokens::of(folder.path()));
        assert!(here.list().await.unwrap().is_none());
        for count in 1..=5 {
            elsewhere.create("a", Scope::Read, Timestamp::UNIX_EPOCH).await.unwrap();
            assert_eq!(here.list().await.unwrap().unwrap().len(), count);
        }
        let kept = here.list().await.unwrap().unwrap();
        for (count, token) in kept.iter().enumerate() {
            elsewhere.revoke(&token.id, Timestamp::UNIX_EPOCH).await.unwrap();
            assert_eq!(here.list().await.unwrap().unwrap().len(), kept.len() - count - 1);
        }
    }

    #[tokio::test]
    async fn a_file_that_is_no_database_is_named() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("tokens.db"), [7_u8; 4096]).unwrap();
        let error = Tokens::of(folder.path()).list().await.unwrap_err().to_string();
        assert!(error.contains("tokens.db"), "{error}");
    }

    #[cfg(unix)]
    #[tokio::test]
    async fn only_the_owner_reads_the_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        Tokens::of(folder.path()).create("a", Scope::Read, Timestamp::UNIX_EPOCH).await.unwrap();
        let mode = std::fs::metadata(folder.path().join("tokens.db")).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }
}
