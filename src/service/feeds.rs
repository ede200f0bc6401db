//! Sources of records other than HTTP: their state and their message counts, for `/readyz` and `/metrics`.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// A connection of the service to a source of records, with its message counts since the start.
#[derive(Debug)]
pub struct Feed {
    name: &'static str,
    counts: [AtomicU64; FeedCount::ALL.len()],
    state: Mutex<FeedState>,
}

/// A counter of a feed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FeedCount {
    /// Messages received, including repeated ones.
    Received,
    /// Messages that are durable and acknowledged, including repeated ones.
    Accepted,
    /// Messages received again because their acknowledgement was lost or late.
    Repeated,
    /// Invalid messages.
    Refused,
    /// Connections made after the first.
    Reconnected,
}

#[derive(Debug, Default)]
struct FeedState {
    is_connected: bool,
    lost: Option<String>,
    held: usize,
    held_for: Option<String>,
}

/// A message that is held back because it cannot be accepted now; dropped once it is.
#[derive(Debug)]
pub struct HeldMessage(Arc<Feed>);

impl FeedCount {
    /// All counters in order.
    const ALL: [Self; 5] = [Self::Received, Self::Accepted, Self::Repeated, Self::Refused, Self::Reconnected];
}

impl Feed {
    fn new(name: &'static str) -> Self {
        Self {
            name,
            counts: Default::default(),
            state: Mutex::new(FeedState {
                lost: Some("not connected yet".to_owned()),
                ..FeedState::default()
            }),
        }
    }

    /// Its name, for example `mqtt`.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Increments a counter.
    pub fn count(&self, what: FeedCount) {
        self.counts[what as usize].fetch_add(1, Ordering::Relaxed);
    }

    /// The value of a counter.
    pub fn counted(&self, what: FeedCount) -> u64 {
        self.counts[what as usize].load(Ordering::Relaxed)
    }

    /// Marks the feed as connected.
    pub fn connected(&self) {
        let mut state = self.state();
        state.is_connected = true;
        state.lost = None;
    }

    /// Marks the feed as disconnected, because the connection was lost or could not be made.
    pub fn lost(&self, reason: String) {
        let mut state = self.state();
        state.is_connected = false;
        state.lost = Some(reason);
    }

    /// Counts a message as held back, for this reason, until the returned guard is dropped.
    pub fn hold(self: &Arc<Self>, reason: String) -> HeldMessage {
        let mut state = self.state();
        state.held += 1;
        state.held_for = Some(reason);
        HeldMessage(Arc::clone(self))
    }

    /// Whether the feed is connected.
    pub fn is_connected(&self) -> bool {
        self.state().is_connected
    }

    /// Number of messages held back.
    pub fn held(&self) -> usize {
        self.state().held
    }

    /// Why there is no connection, or else why messages are held back; `None` if neither is the case.
    pub fn trouble(&self) -> Option<String> {
        let state = self.state();
        state.lost.clone().or_else(|| state.held_for.clone())
    }

    fn state(&self) -> std::sync::MutexGuard<'_, FeedState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for HeldMessage {
    fn drop(&mut self) {
        let mut state = self.0.state();
        state.held -= 1;
        if state.held == 0 {
            state.held_for = None;
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
    fn trouble_ends_with_its_cause() {
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
