//! Bearer tokens: their format and their stored hash.

use jiff::Timestamp;
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

use super::token_error::TokenError;
use crate::store::{Scope, Token};

/// Prefix of every token, so that leaked tokens can be recognised.
const PREFIX: &str = "fwt";

/// Creates a token: returns the token itself and its stored part.
pub(crate) fn mint(name: &str, scope: Scope, now: Timestamp) -> Result<(String, Token), TokenError> {
    let mut random = [0; 36];
    getrandom::fill(&mut random).map_err(TokenError::Random)?;
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
