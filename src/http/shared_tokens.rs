//! The tokens of a service whose store is shared: rows that every node reads again after a moment.

use std::path::Path;
use std::str::FromStr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use jiff::Timestamp;

use super::tokens::{Scope, Token, TokenError, Tokens, mint};
use crate::store::{Store, StoredToken};

/// How old what a node knows may be: so long after it was made or revoked a token is taken or refused
/// everywhere.
const KNOWN_FOR: Duration = Duration::from_secs(2);

/// How long what was known goes on to count while the database is away, when nobody can revoke anything
/// either.
const KNOWN_WITHOUT_DATABASE: Duration = Duration::from_secs(300);

/// How long the database has to answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(3);

/// The tokens in a shared store.
#[derive(Debug)]
pub struct SharedTokens {
    store: Store,
    known: Mutex<Option<Known>>,
    /// Held while the database is asked, so that it is asked once.
    asking: tokio::sync::Mutex<()>,
}

/// What was read, and when.
#[derive(Debug, Clone)]
struct Known {
    tokens: Option<Arc<Vec<Token>>>,
    read_at: Instant,
    tried_at: Instant,
}

impl SharedTokens {
    /// The tokens of a store; there need not be any.
    pub fn of(store: Store) -> Self {
        Self { store, known: Mutex::default(), asking: tokio::sync::Mutex::default() }
    }

    /// All tokens, as they were a moment ago; none where there never were any.
    pub async fn list(&self) -> Result<Option<Arc<Vec<Token>>>, TokenError> {
        if let Some(tokens) = self.known_now() {
            return Ok(tokens);
        }
        let _turn = self.asking.lock().await;
        // Another request may have asked meanwhile.
        if let Some(tokens) = self.known_now() {
            return Ok(tokens);
        }
        let asked = tokio::time::timeout(ANSWER_TIMEOUT, self.read()).await;
        let asked = asked.unwrap_or(Err(TokenError::Silent));
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        match asked {
            Ok(tokens) => {
                let now = Instant::now();
                *known = Some(Known { tokens: tokens.clone(), read_at: now, tried_at: now });
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
    fn known_now(&self) -> Option<Option<Arc<Vec<Token>>>> {
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let known = known.as_ref()?;
        let counts = known.tried_at.elapsed() < KNOWN_FOR && known.read_at.elapsed() < KNOWN_WITHOUT_DATABASE;
        counts.then(|| known.tokens.clone())
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
            if self.store.insert_token(&kept.clone().into()).await? {
                self.forget();
                return Ok((token, kept));
            }
        }
    }

    /// Takes a token back: a moment later it opens nothing on any node.
    pub async fn revoke(&self, id: &str, now: Timestamp) -> Result<(), TokenError> {
        if self.store.revoke_token(id, now).await? {
            self.forget();
            Ok(())
        } else {
            Err(TokenError::Unknown(id.to_owned()))
        }
    }

    /// Imports the tokens in the file of a data folder. What was revoked since stays so.
    pub async fn import(&self, data_dir: &Path) -> Result<(), TokenError> {
        for token in Tokens::of(data_dir).list()?.unwrap_or_default().iter() {
            if self.store.insert_token(&token.clone().into()).await? {
                tracing::info!(token = token.id, "imported a token from the data folder");
            }
        }
        Ok(())
    }
}

impl From<Token> for StoredToken {
    fn from(token: Token) -> Self {
        Self {
            id: token.id,
            name: token.name,
            scope: token.scope.name().to_owned(),
            created_at: token.created_at,
            sha256: token.sha256,
        }
    }
}

impl TryFrom<StoredToken> for Token {
    type Error = TokenError;

    fn try_from(stored: StoredToken) -> Result<Self, TokenError> {
        let scope = Scope::from_str(&stored.scope)
            .map_err(|reason| TokenError::Stored { id: stored.id.clone(), reason })?;
        Ok(Self {
            id: stored.id,
            name: stored.name,
            scope,
            created_at: stored.created_at,
            sha256: stored.sha256,
        })
    }
}
