//! A ring of the latest events, so that a client that lost its connection receives what it missed.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::watch;

use crate::asset::AssetId;
use crate::service::{History, LiveEvent, NumberedEvent, SharedEvents, Streams};

/// Number of events that another node may have sent before they arrived here.
const MAX_AHEAD: u64 = 1000;

/// The latest events.
#[derive(Debug)]
pub(crate) struct EventRing {
    capacity: usize,
    /// Number of events that a client may have received from another node before they arrived here.
    ahead: u64,
    entries: Mutex<Entries>,
    /// The number of the latest event; closed when the service ends.
    latest: watch::Sender<u64>,
    is_over: watch::Sender<bool>,
}

#[derive(Debug)]
struct Entries {
    /// Identifies the sequence of numbers in event ids.
    run: Arc<str>,
    last_number: u64,
    events: VecDeque<Arc<NumberedEvent>>,
}

impl Entries {
    fn of(run: Arc<str>) -> Mutex<Self> {
        Mutex::new(Self { run, last_number: 0, events: VecDeque::new() })
    }

    /// The position after the latest event.
    fn end(&self) -> Position {
        Position { run: Arc::clone(&self.run), number: self.last_number }
    }
}

/// A client's position: that of the last event it received.
#[derive(Debug, PartialEq)]
pub(crate) struct Position {
    run: Arc<str>,
    number: u64,
}

impl Position {
    /// The id of the event at it.
    pub(crate) fn id(&self) -> String {
        format!("{}-{}", self.run, self.number)
    }
}

impl EventRing {
    /// Collects the events that the service sends; `run` must differ between runs of the service.
    pub(crate) fn start(mut receiver: Receiver<LiveEvent>, run: String, capacity: usize) -> Arc<Self> {
        let events = Arc::new(Self {
            capacity: capacity.max(1),
            ahead: 0,
            entries: Entries::of(run.into()),
            latest: watch::Sender::new(0),
            is_over: watch::Sender::new(false),
        });
        let ring = Arc::clone(&events);
        tokio::spawn(async move {
            loop {
                match receiver.recv().await {
                    Ok(event) => ring.add(event),
                    Err(RecvError::Lagged(count)) => ring.add(LiveEvent::Lost(count)),
                    Err(RecvError::Closed) => break,
                }
            }
        });
        events
    }

    /// Collects the events of all nodes; `history` is updated with the recomputations of other processes, and
    /// `streams` with their alarms and deleted assets.
    pub(crate) fn share(
        shared: SharedEvents,
        history: Arc<History>,
        streams: Arc<Streams>,
        capacity: usize,
    ) -> Arc<Self> {
        let SharedEvents { run, backlog, mut receiver } = shared;
        let events = Arc::new(Self {
            capacity: capacity.max(1),
            ahead: MAX_AHEAD,
            entries: Entries::of(run),
            latest: watch::Sender::new(0),
            is_over: watch::Sender::new(false),
        });
        for event in backlog {
            forward_recomputation(&history, &event.event);
            events.push(event);
        }
        let ring = Arc::clone(&events);
        tokio::spawn(async move {
            while let Some(event) = receiver.recv().await {
                forward_recomputation(&history, &event.event);
                streams.handle_event(&event.event);
                ring.push(event);
            }
        });
        events
    }

    /// Ends all streams.
    pub(crate) fn end(&self) {
        self.is_over.send_replace(true);
    }

    fn lock(&self) -> MutexGuard<'_, Entries> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn add(&self, event: LiveEvent) {
        let Position { run, number } = self.end_position();
        self.push(NumberedEvent { run, number: number + 1, event });
    }

    fn push(&self, event: NumberedEvent) {
        let mut entries = self.lock();
        if event.run != entries.run {
            // The nodes number their events anew.
            entries.run = Arc::clone(&event.run);
            entries.last_number = 0;
            entries.events.clear();
        }
        if event.number <= entries.last_number {
            // Received twice.
            return;
        }
        entries.last_number = event.number;
        if entries.events.len() == self.capacity {
            entries.events.pop_front();
        }
        entries.events.push_back(Arc::new(event));
        self.latest.send_replace(entries.last_number);
    }

    /// Returns the next event of the asset after `position`, and whether earlier ones were dropped.
    pub(crate) fn next(&self, position: &mut Position, asset: Option<&AssetId>) -> Next {
        let entries = self.lock();
        if position.run != entries.run {
            *position = entries.end();
            return Next::Lost(None);
        }
        let number = &mut position.number;
        let oldest = entries.events.front().map_or(entries.last_number + 1, |event| event.number);
        if *number + 1 < oldest {
            let gone = oldest - 1 - *number;
            *number = oldest - 1;
            return Next::Lost(Some(gone));
        }
        let from = entries.events.partition_point(|event| event.number <= *number);
        let is_wanted = |event: &&Arc<NumberedEvent>| {
            let of = event.event.asset();
            asset.is_none() || of.is_none() || of == asset
        };
        let found = entries.events.iter().skip(from).find(is_wanted).cloned();
        // A client may have received more from another node than has arrived here.
        *number = found.as_ref().map_or(entries.last_number.max(*number), |event| event.number);
        found.map_or(Next::Nothing, Next::Event)
    }

    /// The position after event id `last`; that of no run if it is unknown.
    pub(crate) fn position(&self, last: &str) -> Position {
        let Position { run, number: latest } = self.end_position();
        let known = last.strip_prefix(&*run).and_then(|rest| rest.strip_prefix('-')?.parse().ok());
        match known.filter(|number| *number <= latest + self.ahead) {
            Some(number) => Position { run, number },
            None => Position { run: Arc::default(), number: 0 },
        }
    }

    /// The position after the latest event.
    pub(crate) fn end_position(&self) -> Position {
        self.lock().end()
    }

    /// Signals for new events and for the end of the service.
    pub(crate) fn subscribe(&self) -> (watch::Receiver<u64>, watch::Receiver<bool>) {
        (self.latest.subscribe(), self.is_over.subscribe())
    }
}

/// Forwards a recomputation of another process of the cluster.
fn forward_recomputation(history: &History, event: &LiveEvent) {
    if let LiveEvent::RecomputationChanged(recomputation) = event {
        history.set_recomputation(recomputation.clone());
    }
}

/// The next item in the ring.
pub(crate) enum Next {
    Event(Arc<NumberedEvent>),
    /// Events were dropped; `None` if they were of another run.
    Lost(Option<u64>),
    Nothing,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_ring_keeps_the_latest_events_and_detects_dropped_ones() {
        let (_sender, receiver) = tokio::sync::broadcast::channel(1);
        let events = EventRing::start(receiver, "r".into(), 3);
        let (a, b) = (AssetId::new("a").unwrap(), AssetId::new("b").unwrap());
        for n in 0..5 {
            events.add(LiveEvent::AssetChanged(if n % 2 == 0 { a.clone() } else { b.clone() }));
        }
        let mut position = Position { run: "r".into(), number: 0 };
        assert!(matches!(events.next(&mut position, None), Next::Lost(Some(2))));
        for n in 2..5 {
            assert!(matches!(events.next(&mut position, None), Next::Event(event) if event.number == n + 1));
        }
        assert!(matches!(events.next(&mut position, None), Next::Nothing));
        let mut position = events.position("r-3");
        assert!(matches!(events.next(&mut position, Some(&b)), Next::Event(event) if event.number == 4));
        assert!(matches!(events.next(&mut position, Some(&b)), Next::Nothing));
        assert_eq!(position.id(), "r-5");
        for unknown in ["r-6", "s-1", "r", "", "r-x"] {
            let mut position = events.position(unknown);
            assert!(matches!(events.next(&mut position, None), Next::Lost(None)), "{unknown}");
            assert_eq!(position, events.end_position(), "{unknown}");
        }
    }

    #[tokio::test]
    async fn events_that_are_numbered_anew_follow_after_a_loss() {
        let (_sender, receiver) = tokio::sync::broadcast::channel(1);
        let events = EventRing::start(receiver, "r".into(), 3);
        let event = LiveEvent::AssetChanged(AssetId::new("a").unwrap());
        (0..5).for_each(|_| events.add(event.clone()));
        let mut position = events.end_position();
        let anew = |number| NumberedEvent { run: "s".into(), number, event: event.clone() };
        events.push(anew(1));
        assert!(matches!(events.next(&mut position, None), Next::Lost(None)));
        assert_eq!(position.id(), "s-1");
        events.push(anew(2));
        assert!(matches!(events.next(&mut position, None), Next::Event(event) if event.number == 2));
        assert!(matches!(events.next(&mut position, None), Next::Nothing));
    }
}
