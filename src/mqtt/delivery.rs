//! One message from its receipt to its end: stored, or never to be used.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;

use super::message::{Message, NO_TIME};
use super::refusal::{Refusal, Verdict};
use crate::service::{Feed, Service, ServiceError};

/// Waits before a message that could not be taken is tried again: the first and the longest.
const FIRST_WAIT: Duration = Duration::from_millis(20);
const MAX_WAIT: Duration = Duration::from_secs(5);

/// How often a message is tried that the program fails on.
const TRIES_AFTER_FAULT: u32 = 3;

/// How a message ended.
#[derive(Debug)]
pub(super) enum Delivered {
    /// Its record is safe.
    Safe,
    /// It can never be used.
    Refused(Refusal),
    /// The service stops before it could be taken: the broker keeps it.
    LeftBehind,
}

/// Takes a message, however long that needs.
pub(super) async fn deliver(
    service: &Arc<Service>,
    feed: &Arc<Feed>,
    message: &Message,
    mut stop: watch::Receiver<bool>,
) -> Delivered {
    let (mut wait, mut faults, mut holding) = (FIRST_WAIT, 0, None);
    loop {
        let reason = match take(service, message).await {
            Ok(()) => return Delivered::Safe,
            Err(Verdict::Never(refusal)) => return Delivered::Refused(refusal),
            Err(Verdict::Fault(refusal)) => {
                faults += 1;
                if faults == TRIES_AFTER_FAULT {
                    return Delivered::Refused(refusal);
                }
                refusal.detail().to_owned()
            }
            Err(Verdict::Later(reason)) => reason,
        };
        if holding.is_none() {
            tracing::debug!(reason, asset = %message.address.asset, "failed to store a message: trying again");
        }
        // The new one first: the trouble is not over in between.
        let renewed = feed.hold(reason);
        holding.replace(renewed);
        tokio::select! {
            () = tokio::time::sleep(wait) => {}
            _ = stop.wait_for(|stop| *stop) => return Delivered::LeftBehind,
        }
        wait = (2 * wait).min(MAX_WAIT);
    }
}

/// The same path that an upload takes.
async fn take(service: &Arc<Service>, message: &Message) -> Result<(), Verdict> {
    let mut ticket = service.workers.admit()?;
    ticket.grow(message.payload.len())?;
    let given = message.given();
    let taken = service.pipeline.accept(
        &message.address.asset,
        message.format,
        message.payload.clone(),
        given,
        ticket,
    );
    match taken.await {
        Ok(_) => Ok(()),
        Err(ServiceError::Field { field: "start_time", value, .. }) if value == NO_TIME.to_string() => {
            let expected = "the time of the first sample: only by it is a message that comes twice known";
            Err(Verdict::Never(Refusal::field(422, "start_time", "missing", expected)))
        }
        Err(error) => Err(error.into()),
    }
}
