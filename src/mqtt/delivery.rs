//! Delivery of one message to the service.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;

use super::message::{Message, NO_TIME};
use super::rejection::{FailureAction, Rejection};
use super::topic::Address;
use crate::service::{Feed, HeldMessage, Service, ServiceError};

/// First and longest wait between two attempts.
const FIRST_WAIT: Duration = Duration::from_millis(20);
const MAX_WAIT: Duration = Duration::from_secs(5);

/// Maximum attempts for a message that causes internal errors.
const MAX_INTERNAL_ERRORS: u32 = 3;

/// Outcome of a message.
#[derive(Debug)]
pub(super) enum DeliveryOutcome {
    /// The record is durable.
    Stored,
    /// The message can never be used.
    Rejected(Rejection),
    /// The service stopped first: the broker keeps the message.
    Stopped,
}

/// The attempts to store one message.
pub(super) struct Attempts<'a> {
    feed: &'a Arc<Feed>,
    address: &'a Address,
    stop: watch::Receiver<bool>,
    wait: Duration,
    internal_errors: u32,
    holding: Option<HeldMessage>,
}

impl<'a> Attempts<'a> {
    pub(super) fn new(feed: &'a Arc<Feed>, address: &'a Address, stop: watch::Receiver<bool>) -> Self {
        Self { feed, address, stop, wait: FIRST_WAIT, internal_errors: 0, holding: None }
    }

    /// Handles a failed attempt: returns the outcome if it is the last one, or else waits before the next.
    pub(super) async fn failed(&mut self, failure: FailureAction) -> Option<DeliveryOutcome> {
        let reason = match failure {
            FailureAction::Reject(rejection) => return Some(DeliveryOutcome::Rejected(rejection)),
            FailureAction::RetryThenReject(rejection) => {
                self.internal_errors += 1;
                if self.internal_errors == MAX_INTERNAL_ERRORS {
                    return Some(DeliveryOutcome::Rejected(rejection));
                }
                rejection.detail().to_owned()
            }
            FailureAction::Retry(reason) => reason,
        };
        if self.holding.is_none() {
            tracing::debug!(reason, asset = %self.address.asset, "failed to store a message; retrying");
        }
        // Renewed before the old one is dropped, so that the feed shows the trouble without a gap.
        let renewed = self.feed.hold(reason);
        self.holding.replace(renewed);
        if tokio::time::timeout(self.wait, self.stop.wait_for(|stop| *stop)).await.is_ok() {
            return Some(DeliveryOutcome::Stopped);
        }
        self.wait = (2 * self.wait).min(MAX_WAIT);
        None
    }
}

/// Stores the record of a message; retries until it succeeds, is rejected, or the service stops.
pub(super) async fn deliver(
    service: &Arc<Service>,
    feed: &Arc<Feed>,
    message: &Message,
    stop: watch::Receiver<bool>,
) -> DeliveryOutcome {
    let mut attempts = Attempts::new(feed, &message.address, stop);
    loop {
        let Err(failure) = store(service, message).await else { return DeliveryOutcome::Stored };
        if let Some(outcome) = attempts.failed(failure).await {
            return outcome;
        }
    }
}

/// Passes a message to the service, as an upload is.
async fn store(service: &Arc<Service>, message: &Message) -> Result<(), FailureAction> {
    let mut ticket = service.workers.admit()?;
    ticket.grow(message.payload.len())?;
    let metadata = message.metadata();
    let accepted = service.pipeline.accept(
        &message.address.asset,
        message.format,
        message.payload.clone(),
        metadata,
        ticket,
    );
    match accepted.await {
        Ok(_) => Ok(()),
        Err(ServiceError::Field { field: "start_time", value, .. }) if value == NO_TIME.to_string() => {
            let expected = "the time of the first sample, by which repeated messages are recognised";
            Err(FailureAction::Reject(Rejection::field(422, "start_time", "missing", expected)))
        }
        Err(error) => Err(error.into()),
    }
}
