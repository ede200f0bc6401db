//! Fair shares of limited resources per client: connections, event streams, live streams.

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

/// A pool of slots with a limit per client.
#[derive(Debug, Clone)]
pub(crate) struct Shares {
    max: usize,
    max_per_client: usize,
    occupied: Arc<Mutex<Occupied>>,
}

#[derive(Debug, Default)]
struct Occupied {
    all: usize,
    by_client: HashMap<Client, usize>,
}

/// A slot in use, freed on drop.
#[derive(Debug)]
pub(crate) struct Share {
    client: Client,
    occupied: Arc<Mutex<Occupied>>,
}

impl Shares {
    pub(crate) fn new(max: usize, max_per_client: usize) -> Self {
        Self { max: max.max(1), max_per_client: max_per_client.max(1), occupied: Arc::default() }
    }

    /// Takes a slot for a client; `None` if all slots, or the client's own share of them, are in use.
    pub(crate) fn take(&self, client: Client) -> Option<Share> {
        let mut occupied = lock(&self.occupied);
        let of_client = occupied.by_client.get(&client).copied().unwrap_or_default();
        if occupied.all >= self.max || of_client >= self.max_per_client {
            return None;
        }
        occupied.all += 1;
        occupied.by_client.insert(client.clone(), of_client + 1);
        let occupied = Arc::clone(&self.occupied);
        Some(Share { client, occupied })
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        let mut occupied = lock(&self.occupied);
        occupied.all -= 1;
        if let Some(of_client) = occupied.by_client.get_mut(&self.client) {
            *of_client -= 1;
            if *of_client == 0 {
                occupied.by_client.remove(&self.client);
            }
        }
    }
}

fn lock(occupied: &Mutex<Occupied>) -> MutexGuard<'_, Occupied> {
    occupied.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_client_leaves_places_to_the_others() {
        let shares = Shares::new(3, 2);
        let (one, other) = (Client::Token("one".to_owned()), Client::Address(None));
        let mut held = vec![shares.take(one.clone()).unwrap(), shares.take(one.clone()).unwrap()];
        assert!(shares.take(one.clone()).is_none(), "its own are occupied");
        held.push(shares.take(other.clone()).unwrap());
        assert!(shares.take(other.clone()).is_none(), "all are occupied");
        held.remove(0);
        held.push(shares.take(other.clone()).unwrap());
        drop(held);
        assert!(lock(&shares.occupied).by_client.is_empty());
        assert_ne!(one.mark(), other.mark());
    }
}
