//! Limits of resources in total and per client: connections, event streams, live streams.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use sha2::{Digest, Sha256};

/// A client: the bearer of a token or, without tokens, an address; or a feed.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(crate) enum Client {
    /// Identified by the token's id.
    Token(String),
    /// Identified by the peer address: that of the proxy if there is one.
    Address(Option<IpAddr>),
    /// Everything from a feed of this name, such as a broker.
    #[cfg_attr(not(feature = "mqtt"), expect(dead_code, reason = "there are no feeds"))]
    Feed(&'static str),
}

impl Client {
    /// Eight hexadecimal digits that are stable for a client and rarely equal for two.
    pub(crate) fn mark(&self) -> String {
        let text = match self {
            Self::Token(id) => format!("token {id}"),
            Self::Address(Some(address)) => format!("address {address}"),
            Self::Address(None) => String::new(),
            Self::Feed(name) => format!("feed {name}"),
        };
        hex::encode(&Sha256::digest(text)[..4])
    }
}

/// Permits with a limit in total and a limit per client.
#[derive(Debug, Clone)]
pub(crate) struct ClientLimiter {
    max: usize,
    max_per_client: usize,
    in_use: Arc<Mutex<InUse>>,
}

#[derive(Debug, Default)]
struct InUse {
    all: usize,
    by_client: HashMap<Client, usize>,
}

/// A permit of a client, returned on drop.
#[derive(Debug)]
pub(crate) struct ClientPermit {
    client: Client,
    in_use: Arc<Mutex<InUse>>,
}

impl ClientLimiter {
    pub(crate) fn new(max: usize, max_per_client: usize) -> Self {
        Self { max: max.max(1), max_per_client: max_per_client.max(1), in_use: Arc::default() }
    }

    /// A permit for a client; `None` if all permits, or all that the client may hold, are in use.
    pub(crate) fn try_acquire(&self, client: Client) -> Option<ClientPermit> {
        let mut in_use = lock(&self.in_use);
        let of_client = in_use.by_client.get(&client).copied().unwrap_or_default();
        if in_use.all >= self.max || of_client >= self.max_per_client {
            return None;
        }
        in_use.all += 1;
        in_use.by_client.insert(client.clone(), of_client + 1);
        let in_use = Arc::clone(&self.in_use);
        Some(ClientPermit { client, in_use })
    }
}

impl Drop for ClientPermit {
    fn drop(&mut self) {
        let mut in_use = lock(&self.in_use);
        in_use.all -= 1;
        if let Some(of_client) = in_use.by_client.get_mut(&self.client) {
            *of_client -= 1;
            if *of_client == 0 {
                in_use.by_client.remove(&self.client);
            }
        }
    }
}

fn lock(in_use: &Mutex<InUse>) -> MutexGuard<'_, InUse> {
    in_use.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_client_leaves_permits_to_the_others() {
        let limiter = ClientLimiter::new(3, 2);
        let (one, other) = (Client::Token("one".to_owned()), Client::Address(None));
        let mut held =
            vec![limiter.try_acquire(one.clone()).unwrap(), limiter.try_acquire(one.clone()).unwrap()];
        assert!(limiter.try_acquire(one.clone()).is_none(), "its own are in use");
        held.push(limiter.try_acquire(other.clone()).unwrap());
        assert!(limiter.try_acquire(other.clone()).is_none(), "all are in use");
        held.remove(0);
        held.push(limiter.try_acquire(other.clone()).unwrap());
        drop(held);
        assert!(lock(&limiter.in_use).by_client.is_empty());
        assert_ne!(one.mark(), other.mark());
    }
}
