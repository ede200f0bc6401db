//! Delivery of one message to the service.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;

use super::message::{Message, NO_TIME};
use super::rejection::{FailureAction, Rejection};
use crate::service::{Feed, Service, ServiceError};

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

/// Stores the record of a message; retries until it succeeds, is rejected, or the service stops.
pub(super) async fn deliver(
    service: &Arc<Service>,
    feed: &Arc<Feed>,
    message: &Message,
    mut stop: watch::Receiver<bool>,
) -> DeliveryOutcome {
    let (mut wait, mut internal_errors, mut holding) = (FIRST_WAIT, 0, None);
    loop {
        let reason = match store(service, message).await {
            Ok(()) => return DeliveryOutcome::Stored,
            Err(FailureAction::Reject(rejection)) => return DeliveryOutcome::Rejected(rejection),
            Err(FailureAction::RetryThenReject(rejection)) => {
                internal_errors += 1;
                if internal_errors == MAX_INTERNAL_ERRORS {
                    return DeliveryOutcome::Rejected(rejection);
                }
                rejection.detail().to_owned()
            }
            Err(FailureAction::Retry(reason)) => reason,
        };
        if holding.is_none() {
            tracing::debug!(reason, asset = %message.address.asset, "failed to store a message, retrying");
        }
        // Renewed before the old one is dropped, so that the feed shows the trouble without a gap.
        let renewed = feed.hold(reason);
        holding.replace(renewed);
        tokio::select! {
            () = tokio::time::sleep(wait) => {}
            _ = stop.wait_for(|stop| *stop) => return DeliveryOutcome::Stopped,
        }
        wait = (2 * wait).min(MAX_WAIT);
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
