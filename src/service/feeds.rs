//! Ways in beside HTTP: how each stands and what came through it, for `/readyz` and `/metrics`.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// A connection that the service keeps to somebody who sends records, and what came through it since the
/// start.
#[derive(Debug)]
pub struct Feed {
    name: &'static str,
    counts: [AtomicU64; FeedCount::ALL.len()],
    standing: Mutex<Standing>,
}

/// What is counted of a feed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FeedCount {
    /// Messages received, those that came again among them.
    Received,
    /// Messages that are safe and acknowledged, now or since before.
    Accepted,
    /// Messages that came again because their acknowledgement was lost or late.
    Repeated,
    /// Messages that cannot be used.
    Refused,
    /// Connections made after the first.
    Reconnected,
}

#[derive(Debug, Default)]
struct Standing {
    is_connected: bool,
    lost: Option<String>,
    held: usize,
    held_for: Option<String>,
}

/// A message that cannot be taken now; what is wrong is over when this is dropped.
#[derive(Debug)]
pub struct Holding(Arc<Feed>);

impl FeedCount {
    /// All of them, in their order.
    const ALL: [Self; 5] = [Self::Received, Self::Accepted, Self::Repeated, Self::Refused, Self::Reconnected];
}

impl Feed {
    fn new(name: &'static str) -> Self {
        Self {
            name,
            counts: Default::default(),
            standing: Mutex::new(Standing {
                lost: Some("not connected yet".to_owned()),
                ..Standing::default()
            }),
        }
    }

    /// What it is, for example `mqtt`.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Counts one more.
    pub fn count(&self, what: FeedCount) {
        self.counts[what as usize].fetch_add(1, Ordering::Relaxed);
    }

    /// How many there were.
    pub fn counted(&self, what: FeedCount) -> u64 {
        self.counts[what as usize].load(Ordering::Relaxed)
    }

    /// The connection stands.
    pub fn connected(&self) {
        let mut standing = self.standing();
        standing.is_connected = true;
        standing.lost = None;
    }

    /// The connection is lost, or could not be made.
    pub fn lost(&self, reason: String) {
        let mut standing = self.standing();
        standing.is_connected = false;
        standing.lost = Some(reason);
    }

    /// A message is held back because it cannot be taken now.
    pub fn hold(self: &Arc<Self>, reason: String) -> Holding {
        let mut standing = self.standing();
        standing.held += 1;
        standing.held_for = Some(reason);
        Holding(Arc::clone(self))
    }

    /// Whether the connection stands.
    pub fn is_connected(&self) -> bool {
        self.standing().is_connected
    }

    /// Messages held back now.
    pub fn held(&self) -> usize {
        self.standing().held
    }

    /// Why there is no connection, or else why messages are held back; none where all is well.
    pub fn trouble(&self) -> Option<String> {
        let standing = self.standing();
        standing.lost.clone().or_else(|| standing.held_for.clone())
    }

    fn standing(&self) -> std::sync::MutexGuard<'_, Standing> {
        self.standing.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Holding {
    fn drop(&mut self) {
        let mut standing = self.0.standing();
        standing.held -= 1;
        if standing.held == 0 {
            standing.held_for = None;
        }
    }
}

/// The feeds of a service in the order in which they were added.
#[derive(Debug, Default)]
pub struct Feeds(Mutex<Vec<Arc<Feed>>>);

impl Feeds {
    /// Adds a feed; it is not connected yet.
    pub fn add(&self, name: &'static str) -> Arc<Feed> {
        let feed = Arc::new(Feed::new(name));
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(Arc::clone(&feed));
        feed
    }

    /// The feeds in the order in which they were added.
    pub fn all(&self) -> Vec<Arc<Feed>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trouble_is_over_with_its_cause() {
        let feed = Arc::new(Feed::new("test"));
        assert_eq!(feed.trouble().as_deref(), Some("not connected yet"));
        feed.connected();
        assert_eq!(feed.trouble(), None);
        let first = feed.hold("the disk is full".into());
        let second = feed.hold("the queue is full".into());
        drop(first);
        assert_eq!((feed.held(), feed.trouble().as_deref()), (1, Some("the queue is full")));
        feed.lost("connection refused".into());
        assert_eq!(feed.trouble().as_deref(), Some("connection refused"));
        feed.connected();
        drop(second);
        assert_eq!((feed.held(), feed.trouble()), (0, None));
        feed.count(FeedCount::Repeated);
        assert_eq!((feed.counted(FeedCount::Repeated), feed.counted(FeedCount::Refused)), (1, 0));
    }
}
