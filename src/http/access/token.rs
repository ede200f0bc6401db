//! Bearer tokens: their format, their stored hash and their scope.

use std::str::FromStr;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

use super::token_error::TokenError;
use crate::store::StoredToken;

/// Prefix of every token, so that leaked tokens can be recognised.
const PREFIX: &str = "fwt";

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

/// The stored part of a token, without the secret.
#[derive(Debug, Clone, PartialEq, Eq)]
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
    sha256: String,
}

/// Creates a token: returns the token itself and its stored part.
pub(crate) fn mint(name: &str, scope: Scope, now: Timestamp) -> Result<(String, Token), TokenError> {
    let mut random = [0; 36];
    getrandom::fill(&mut random).map_err(|error| TokenError::Random(error.to_string()))?;
    let (id, secret) = random.split_at(4);
    let (id, secret) = (hex::encode(id), hex::encode(secret));
    let stored = Token {
        id: id.clone(),
        name: name.to_owned(),
        scope,
        created_at: now,
        sha256: hex::encode(Sha256::digest(&secret)),
    };
    Ok((format!("{PREFIX}_{id}_{secret}"), stored))
}

/// Finds the presented token among `tokens`.
pub(crate) fn find<'a>(tokens: &'a [Token], presented: &str) -> Option<&'a Token> {
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
