//! Sends due notifications in the background.

use std::sync::Arc;
use std::time::Duration;

use jiff::SignedDuration;
use tokio::sync::watch;
use tokio::task::JoinSet;

use super::error::NotificationError;
use super::message::Message;
use super::settings::{NotificationSettings, Transport};
use crate::service::{Service, blocking};
use crate::store::{Attempt, PendingNotification, StoreError};

/// Interval at which due notifications are polled.
const POLL_INTERVAL: Duration = Duration::from_secs(1);

/// Number of polls between removals of old notifications.
const POLLS_PER_CLEANUP: u32 = 3600;

/// Time for which a process leases a notification; longer than an attempt takes.
const LEASE: SignedDuration = SignedDuration::from_secs(120);

/// First and longest wait after a failed attempt; the wait doubles each time.
const FIRST_WAIT_S: i64 = 5;
const MAX_WAIT_S: i64 = 3600;

/// Age at which a notification is given up after a failed attempt.
const MAX_AGE: SignedDuration = SignedDuration::from_hours(24);

/// Maximum length of a stored error, in characters.
const MAX_ERROR: usize = 500;

/// Sends notifications until it is stopped or dropped.
pub struct Notifier {
    stop: watch::Sender<bool>,
    tasks: JoinSet<()>,
}

/// Sends the notifications of one recipient.
struct Sender {
    recipient: String,
    transport: Transport,
    dashboard_url: Option<String>,
    service: Arc<Service>,
}

impl Notifier {
    /// Starts a task for each recipient. Must be called within a runtime.
    pub fn start(settings: NotificationSettings, service: &Arc<Service>) -> Self {
        let (stop, stopped) = watch::channel(false);
        let mut tasks = JoinSet::new();
        for (recipient, transport) in settings.transports {
            let dashboard_url = settings.dashboard_url.clone();
            let sender = Sender { recipient, transport, dashboard_url, service: Arc::clone(service) };
            tasks.spawn(sender.run(stopped.clone()));
        }
        Self { stop, tasks }
    }

    /// Finishes the current attempts within `grace`; the rest is sent after the next start.
    pub async fn stop(mut self, grace: Duration) {
        let _ = self.stop.send(true);
        let end = async { while self.tasks.join_next().await.is_some() {} };
        if tokio::time::timeout(grace, end).await.is_err() {
            tracing::warn!("failed to finish a notification within the grace period; it is sent again later");
        }
    }
}

impl Sender {
    async fn run(self, mut stop: watch::Receiver<bool>) {
        let mut polls: u32 = 0;
        while !*stop.borrow() && !self.service.store.is_closed() {
            if let Err(error) = self.send_due(&stop, polls.is_multiple_of(POLLS_PER_CLEANUP)).await {
                tracing::warn!(recipient = self.recipient, %error, "failed to read or update notifications");
            }
            polls = polls.wrapping_add(1);
            tokio::select! {
                () = tokio::time::sleep(POLL_INTERVAL) => {}
                _ = stop.wait_for(|stop| *stop) => return,
            }
        }
    }

    /// Sends all due notifications, one after the other; first removes old ones if `cleans_up`.
    async fn send_due(&self, stop: &watch::Receiver<bool>, cleans_up: bool) -> Result<(), StoreError> {
        let store = &self.service.store;
        if store.damage().is_some() {
            return Ok(());
        }
        if cleans_up {
            store.forget_notifications(self.service.now()).await?;
        }
        while !*stop.borrow() {
            let next = store.next_notification(&self.recipient, LEASE, self.service.now()).await?;
            let Some(pending) = next else { break };
            let attempt = match self.send(&pending).await {
                Ok(()) => Attempt::Sent,
                Err(error) => self.failed(&pending, &error).await?,
            };
            store.end_attempt(&pending, &attempt, self.service.now()).await?;
        }
        Ok(())
    }

    async fn send(&self, pending: &PendingNotification) -> Result<(), NotificationError> {
        let notification = pending.notification.clone();
        let asset_name = match self.service.store.asset(&notification.asset_id).await {
            Ok(asset) => asset.spec.name,
            Err(StoreError::AssetUnknown(_)) => String::new(),
            Err(error) => return Err(error.into()),
        };
        let url = self.dashboard_url.as_ref();
        let url = url.map(|url| format!("{url}/#/alarms?show=all&alarm={}", notification.alarm_id));
        let message = Message { notification, asset_name, url };
        match &self.transport {
            Transport::Mail(mail) => mail.send(&message).await,
            Transport::Webhook(webhook) => {
                let (webhook, now) = (webhook.clone(), self.service.now());
                let body = message.json()?;
                let id = message.notification.id;
                blocking("webhook", move || webhook.send(&id, &body, now)).await?
            }
        }
    }

    /// Logs a failed attempt and decides whether to retry.
    async fn failed(
        &self,
        pending: &PendingNotification,
        error: &NotificationError,
    ) -> Result<Attempt, StoreError> {
        let now = self.service.store.now(self.service.now()).await?;
        let (recipient, attempts) = (&self.recipient, pending.attempts);
        let PendingNotification { notification, .. } = pending;
        let (id, asset) = (&notification.id, &notification.asset_id);
        let error: String = chain(error).chars().take(MAX_ERROR).collect();
        if now.duration_since(notification.noted_at) > MAX_AGE {
            tracing::error!(recipient, id, %asset, attempts, error, "failed to send a notification; giving up");
            return Ok(Attempt::GivenUp { error });
        }
        tracing::warn!(recipient, id, %asset, attempts, error, "failed to send a notification; retrying");
        let again_at = now.saturating_add(wait_after(attempts)).unwrap_or(now);
        Ok(Attempt::Failed { error, again_at })
    }
}

/// Returns the wait after a number of attempts.
fn wait_after(attempts: u64) -> SignedDuration {
    let doublings = attempts.saturating_sub(1).min(32);
    SignedDuration::from_secs((FIRST_WAIT_S << doublings).min(MAX_WAIT_S))
}

/// Formats an error and its sources in one line.
fn chain(error: &NotificationError) -> String {
    let mut text = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(next) = cause {
        let source = next.to_string();
        if !text.contains(&source) {
            text = format!("{text}: {source}");
        }
        cause = next.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_up_to_an_hour() {
        let seconds = [1, 2, 3, 10, 11, 1000].map(|attempts| wait_after(attempts).as_secs());
        assert_eq!(seconds, [5, 10, 20, 2560, 3600, 3600]);
    }
}
