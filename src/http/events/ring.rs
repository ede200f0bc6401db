//! A ring of the latest events, so that a client that lost its connection receives what it missed.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{mpsc, watch};

use crate::asset::AssetId;
use crate::service::{History, LiveEvent, NumberedEvent, Streams};

/// Number of events that another node may have sent before they arrived here.
const MAX_AHEAD: u64 = 1000;

/// The events of all nodes of a cluster in a common order.
#[derive(Debug)]
pub struct SharedEvents {
    /// Identifies this order in event ids.
    pub run: String,
    /// Past events.
    pub backlog: Vec<NumberedEvent>,
    /// Future events.
    pub receiver: mpsc::Receiver<NumberedEvent>,
}

/// The latest events.
#[derive(Debug)]
pub(crate) struct EventRing {
    /// Identifies this run of the service in event ids.
    run: String,
    capacity: usize,
    /// Number of events that a client may have received from another node before they arrived here.
    ahead: u64,
    entries: Mutex<Entries>,
    /// The number of the latest event; closed when the service ends.
    latest: watch::Sender<u64>,
    is_over: watch::Sender<bool>,
}

#[derive(Debug, Default)]
struct Entries {
    last_number: u64,
    events: VecDeque<Arc<NumberedEvent>>,
}

impl EventRing {
    /// Collects the events that the service announces; `run` must differ between runs of the service.
    pub(crate) fn follow(mut announced: Receiver<LiveEvent>, run: String, capacity: usize) -> Arc<Self> {
        let events = Arc::new(Self {
            run,
            capacity: capacity.max(1),
            ahead: 0,
            entries: Mutex::default(),
            latest: watch::Sender::new(0),
            is_over: watch::Sender::new(false),
        });
        let followed = Arc::clone(&events);
        tokio::spawn(async move {
            loop {
                match announced.recv().await {
                    Ok(event) => followed.add(event),
                    Err(RecvError::Lagged(count)) => followed.add(LiveEvent::Lost(count)),
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
            run,
            capacity: capacity.max(1),
            ahead: MAX_AHEAD,
            entries: Mutex::default(),
            latest: watch::Sender::new(0),
            is_over: watch::Sender::new(false),
        });
        for event in backlog {
            note(&history, &event.event);
            events.push(event);
        }
        let followed = Arc::clone(&events);
        tokio::spawn(async move {
            while let Some(event) = receiver.recv().await {
                note(&history, &event.event);
                streams.note_event(&event.event);
                followed.push(event);
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
        let number = self.lock().last_number + 1;
        self.push(NumberedEvent { number, event });
    }

    fn push(&self, event: NumberedEvent) {
        let mut entries = self.lock();
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
    pub(crate) fn next(&self, position: &mut u64, asset: Option<&AssetId>) -> Next {
        let entries = self.lock();
        let oldest = entries.events.front().map_or(entries.last_number + 1, |event| event.number);
        if *position + 1 < oldest {
            let gone = oldest - 1 - *position;
            *position = oldest - 1;
            return Next::Lost(gone);
        }
        let from = entries.events.partition_point(|event| event.number <= *position);
        let is_wanted = |event: &&Arc<NumberedEvent>| {
            let of = event.event.asset();
            asset.is_none() || of.is_none() || of == asset
        };
        let found = entries.events.iter().skip(from).find(is_wanted).cloned();
        // A client may have received more from another node than has arrived here.
        *position = found.as_ref().map_or(entries.last_number.max(*position), |event| event.number);
        found.map_or(Next::Nothing, Next::Event)
    }

    pub(crate) fn id(&self, number: u64) -> String {
        format!("{}-{number}", self.run)
    }

    /// The position after event id `last`; `None` if it is from another run.
    pub(crate) fn position(&self, last: &str) -> Option<u64> {
        let (run, number) = last.rsplit_once('-')?;
        let number = number.parse().ok()?;
        (run == self.run && number <= self.lock().last_number + self.ahead).then_some(number)
    }

    /// The position after the latest event.
    pub(crate) fn end_position(&self) -> u64 {
        self.lock().last_number
    }

    /// Signals for new events and for the end of the service.
    pub(crate) fn subscribe(&self) -> (watch::Receiver<u64>, watch::Receiver<bool>) {
        (self.latest.subscribe(), self.is_over.subscribe())
    }
}

/// Notes a recomputation of another process of the cluster.
fn note(history: &History, event: &LiveEvent) {
    if let LiveEvent::RecomputationChanged(recomputation) = event {
        history.note_recomputation(recomputation.clone());
    }
}

/// The next item in the ring.
pub(crate) enum Next {
    Event(Arc<NumberedEvent>),
    Lost(u64),
    Nothing,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_ring_keeps_the_latest_events_and_detects_dropped_ones() {
        let (_sender, receiver) = tokio::sync::broadcast::channel(1);
        let events = EventRing::follow(receiver, "r".into(), 3);
        let (a, b) = (AssetId::new("a").unwrap(), AssetId::new("b").unwrap());
        for n in 0..5 {
            events.add(LiveEvent::AssetChanged(if n % 2 == 0 { a.clone() } else { b.clone() }));
        }
        let mut position = 0;
        assert!(matches!(events.next(&mut position, None), Next::Lost(2)));
        for n in 2..5 {
            assert!(matches!(events.next(&mut position, None), Next::Event(event) if event.number == n + 1));
        }
        assert!(matches!(events.next(&mut position, None), Next::Nothing));
        let mut position = events.position("r-3").unwrap();
        assert!(matches!(events.next(&mut position, Some(&b)), Next::Event(event) if event.number == 4));
        assert!(matches!(events.next(&mut position, Some(&b)), Next::Nothing));
        assert_eq!(position, 5);
        for unknown in ["r-6", "s-1", "r", "", "r-x"] {
            assert!(events.position(unknown).is_none(), "{unknown}");
        }
    }
}
