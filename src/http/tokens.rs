//! Bearer tokens: who may do what. Of one machine they are kept hashed in a file of the data folder, so that
//! they are made and revoked while the service runs; where processes share a store they are rows of it
//! (`shared_tokens`).

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;
use thiserror::Error;

use crate::store::StoreError;

/// Begins every token, so that one is recognised where it should not be.
const PREFIX: &str = "fwt";

/// How far a token reaches; each scope holds those before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Scope {
    /// Look at everything.
    Read,
    /// Send records, start replays, acknowledge alarms.
    Write,
    /// Make, change and delete assets.
    Admin,
}

impl Scope {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Write => "write",
            Self::Admin => "admin",
        }
    }
}

impl FromStr for Scope {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        [Self::Read, Self::Write, Self::Admin]
            .into_iter()
            .find(|scope| scope.name() == name)
            .ok_or_else(|| format!("scope is {name:?}, expected read, write or admin"))
    }
}

/// What is kept of a token: not the token.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Token {
    /// Identifier, the part of the token that is no secret.
    pub id: String,
    /// What it is for.
    pub name: String,
    /// How far it reaches.
    pub scope: Scope,
    /// When it was made.
    pub created_at: Timestamp,
    /// SHA-256 of its secret in hexadecimal. The secret is 256 random bits, so that a slow hash would add
    /// nothing.
    pub(super) sha256: String,
}

/// Why tokens cannot be read or kept.
#[derive(Debug, Error)]
pub enum TokenError {
    /// The file cannot be read or written.
    #[error("cannot {action} the tokens {path}: {source}", path = path.display())]
    File {
        /// What was tried.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file does not say what it should.
    #[error("the tokens {path} cannot be used: {source}", path = path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: serde_json::Error,
    },
    /// The system gives no random numbers.
    #[error("no random numbers are to be had: {0}")]
    Random(String),
    /// There is no such token.
    #[error("there is no token {0:?}")]
    Unknown(String),
    /// The store that they are shared in refused or failed.
    #[error("tokens: {0}")]
    Store(#[from] StoreError),
    /// The store that they are shared in does not answer.
    #[error("tokens: the database does not answer")]
    Silent,
    /// The shared store says something that is not understood.
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

/// The tokens of a data folder.
#[derive(Debug)]
pub struct Tokens {
    path: PathBuf,
    read: Mutex<Option<Read>>,
    /// Held while the file is written: each writing begins with what the one before left.
    writing: Mutex<()>,
}

/// The file as it was last read.
#[derive(Debug, Clone)]
struct Read {
    changed: (Option<SystemTime>, u64),
    tokens: Arc<Vec<Token>>,
}

impl Tokens {
    /// The tokens of a data folder; there need not be any.
    pub fn of(data_dir: &Path) -> Self {
        Self { path: data_dir.join("tokens.json"), read: Mutex::new(None), writing: Mutex::new(()) }
    }

    /// All tokens; none where there never were any.
    pub fn list(&self) -> Result<Option<Arc<Vec<Token>>>, TokenError> {
        let file = |action| move |source| TokenError::File { action, path: self.path.clone(), source };
        let changed = match fs::metadata(&self.path) {
            Ok(metadata) => (metadata.modified().ok(), metadata.len()),
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(file("read")(error)),
        };
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(read) = read.as_ref()
            && read.changed == changed
        {
            return Ok(Some(Arc::clone(&read.tokens)));
        }
        let text = fs::read(&self.path).map_err(file("read"))?;
        let tokens: Vec<Token> = serde_json::from_slice(&text)
            .map_err(|source| TokenError::Content { path: self.path.clone(), source })?;
        let tokens = Arc::new(tokens);
        *read = Some(Read { changed, tokens: Arc::clone(&tokens) });
        Ok(Some(tokens))
    }

    /// Makes a token and returns it; it cannot be had again.
    pub fn create(&self, name: &str, scope: Scope, now: Timestamp) -> Result<String, TokenError> {
        Ok(self.issue(name, scope, now)?.0)
    }

    /// Makes a token; returns it and what is kept of it.
    pub(super) fn issue(
        &self,
        name: &str,
        scope: Scope,
        now: Timestamp,
    ) -> Result<(String, Token), TokenError> {
        let (token, kept) = mint(name, scope, now)?;
        let _turn = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        let mut tokens = self.list()?.map(|tokens| tokens.to_vec()).unwrap_or_default();
        tokens.push(kept.clone());
        self.keep(&tokens)?;
        Ok((token, kept))
    }

    /// Takes a token back: it opens nothing from now on.
    pub fn revoke(&self, id: &str) -> Result<(), TokenError> {
        let _turn = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        let mut tokens = self.list()?.map(|tokens| tokens.to_vec()).unwrap_or_default();
        let before = tokens.len();
        tokens.retain(|token| token.id != id);
        if tokens.len() == before {
            return Err(TokenError::Unknown(id.to_owned()));
        }
        self.keep(&tokens)
    }

    fn keep(&self, tokens: &[Token]) -> Result<(), TokenError> {
        let file = |source| TokenError::File { action: "write", path: self.path.clone(), source };
        if let Some(folder) = self.path.parent() {
            fs::create_dir_all(folder).map_err(file)?;
        }
        let next = self.path.with_extension("new");
        let text = serde_json::to_vec_pretty(tokens)
            .map_err(|source| TokenError::Content { path: self.path.clone(), source })?;
        let mut options = fs::OpenOptions::new();
        options.write(true).create(true).truncate(true);
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        let mut out = options.open(&next).map_err(file)?;
        out.write_all(&text).and_then(|()| out.sync_all()).map_err(file)?;
        fs::rename(&next, &self.path).map_err(file)
    }
}

/// A new token: what is given out, and what is kept of it.
pub(super) fn mint(name: &str, scope: Scope, now: Timestamp) -> Result<(String, Token), TokenError> {
    let mut random = [0; 36];
    getrandom::fill(&mut random).map_err(|error| TokenError::Random(error.to_string()))?;
    let (id, secret) = random.split_at(4);
    let (id, secret) = (hex::encode(id), hex::encode(secret));
    let kept = Token {
        id: id.clone(),
        name: name.to_owned(),
        scope,
        created_at: now,
        sha256: hex::encode(Sha256::digest(&secret)),
    };
    Ok((format!("{PREFIX}_{id}_{secret}"), kept))
}

/// The token among `tokens` that was presented; none where it is not one of them.
pub(super) fn find<'a>(tokens: &'a [Token], presented: &str) -> Option<&'a Token> {
    let mut parts = presented.splitn(3, '_');
    let (prefix, id, secret) = (parts.next()?, parts.next()?, parts.next()?);
    if prefix != PREFIX {
        return None;
    }
    let hash = hex::encode(Sha256::digest(secret));
    tokens
        .iter()
        .find(|token| token.id == id)
        .filter(|token| bool::from(token.sha256.as_bytes().ct_eq(hash.as_bytes())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_found_until_it_is_revoked_and_never_kept() {
        let folder = tempfile::tempdir().unwrap();
        let tokens = Tokens::of(folder.path());
        assert!(tokens.list().unwrap().is_none());
        let first = tokens.create("press line", Scope::Write, Timestamp::UNIX_EPOCH).unwrap();
        let second = tokens.create("display", Scope::Read, Timestamp::UNIX_EPOCH).unwrap();
        let kept = tokens.list().unwrap().unwrap();
        assert_eq!(find(&kept, &first).unwrap().scope, Scope::Write);
        assert_eq!(find(&kept, &second).unwrap().name, "display");
        let text = fs::read_to_string(folder.path().join("tokens.json")).unwrap();
        assert!(!text.contains(first.rsplit('_').next().unwrap()));
        let mut wrong = first.clone();
        wrong.replace_range(first.len() - 1.., if first.ends_with('0') { "1" } else { "0" });
        for presented in [wrong.as_str(), "", "fwt", "fwt__", &first[4..], &first[..20]] {
            assert!(find(&kept, presented).is_none(), "{presented}");
        }
        tokens.revoke(&kept[0].id).unwrap();
        let kept = tokens.list().unwrap().unwrap();
        assert!(find(&kept, &first).is_none() && find(&kept, &second).is_some());
        assert!(matches!(tokens.revoke("none"), Err(TokenError::Unknown(_))));
    }

    #[cfg(unix)]
    #[test]
    fn only_the_owner_reads_the_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        Tokens::of(folder.path()).create("a", Scope::Read, Timestamp::UNIX_EPOCH).unwrap();
        let mode = fs::metadata(folder.path().join("tokens.json")).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }
}
