//! The client of a request, to which limits of resources apply.

use std::convert::Infallible;
use std::net::IpAddr;

use axum::extract::FromRequestParts;
use axum::http::request::Parts;

use super::session::Caller;
pub(crate) use crate::service::{Client, ClientLimiter, ClientPermit};

/// The peer address of a connection.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PeerAddress(pub(crate) IpAddr);

impl<S: Sync> FromRequestParts<S> for Client {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Infallible> {
        let caller = parts.extensions.get::<Caller>();
        let address = parts.extensions.get::<PeerAddress>().map(|address| address.0);
        Ok(caller.map_or(Self::Address(address), |caller| Self::Token(caller.token.id.clone())))
    }
}
