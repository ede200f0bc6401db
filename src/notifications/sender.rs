//! Sends what waits, in the background.

use std::sync::Arc;
use std::time::Duration;

use jiff::SignedDuration;
use tokio::sync::watch;
use tokio::task::JoinSet;

use super::error::NotificationError;
use super::message::Message;
use super::settings::{NotificationSettings, Way};
use crate::service::{Service, blocking};
use crate::store::{Attempt, PendingNotification, StoreError};

/// How often it is looked for notifications that are due.
const INTERVAL: Duration = Duration::from_secs(1);

/// How often old notifications are removed, in looks.
const FORGOTTEN_EVERY: u32 = 3600;

/// How long a process has the right to send a notification; longer than an attempt takes.
const LEASE: SignedDuration = SignedDuration::from_secs(120);

/// Waits after an attempt that failed: the first one, twice as long each time, and the longest.
const FIRST_WAIT_S: i64 = 5;
const MAX_WAIT_S: i64 = 3600;

/// A notification that is older than this is not tried again after an attempt has failed.
const TRIED_FOR: SignedDuration = SignedDuration::from_hours(24);

/// The longest error that is kept, in characters.
const MAX_ERROR: usize = 500;

/// Notifications that are sent for as long as this is kept.
pub struct Notifier {
    stop: watch::Sender<bool>,
    tasks: JoinSet<()>,
}

/// One recipient's way.
struct Sender {
    recipient: String,
    way: Way,
    dashboard_url: Option<String>,
    service: Arc<Service>,
}

impl Notifier {
    /// Begins to send what waits for each recipient. To be called inside the runtime.
    pub fn start(settings: NotificationSettings, service: &Arc<Service>) -> Self {
        let (stop, stopped) = watch::channel(false);
        let mut tasks = JoinSet::new();
        for (recipient, way) in settings.ways {
            let dashboard_url = settings.dashboard_url.clone();
            let sender = Sender { recipient, way, dashboard_url, service: Arc::clone(service) };
            tasks.spawn(sender.run(stopped.clone()));
        }
        Self { stop, tasks }
    }

    /// Ends within `grace` what was begun; what waits is sent after the next start.
    pub async fn stop(mut self, grace: Duration) {
        let _ = self.stop.send(true);
        let end = async { while self.tasks.join_next().await.is_some() {} };
        if tokio::time::timeout(grace, end).await.is_err() {
            tracing::warn!("failed to end a notification within the time of grace: it is sent again later");
        }
    }
}

impl Sender {
    async fn run(self, mut stop: watch::Receiver<bool>) {
        let mut looks: u32 = 0;
        while !*stop.borrow() && !self.service.store.is_closed() {
            if let Err(error) = self.look_once(&stop, looks.is_multiple_of(FORGOTTEN_EVERY)).await {
                tracing::warn!(recipient = self.recipient, %error, "failed to look for notifications");
            }
            looks = looks.wrapping_add(1);
            tokio::select! {
                () = tokio::time::sleep(INTERVAL) => {}
                _ = stop.wait_for(|stop| *stop) => return,
            }
        }
    }

    /// Sends all that is due, one after the other.
    async fn look_once(&self, stop: &watch::Receiver<bool>, forgets: bool) -> Result<(), StoreError> {
        let store = &self.service.store;
        if store.damage().is_some() {
            return Ok(());
        }
        if forgets {
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
        match &self.way {
            Way::Mail(mail) => mail.send(&message).await,
            Way::Webhook(webhook) => {
                let (webhook, now) = (webhook.clone(), self.service.now());
                let body = message.json()?;
                let id = message.notification.id;
                blocking("webhook", move || webhook.send(&id, &body, now)).await?
            }
        }
    }

    /// What follows from a failure.
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
        if now.duration_since(notification.noted_at) > TRIED_FOR {
            tracing::error!(recipient, id, %asset, attempts, error, "failed to send a notification: given up");
            return Ok(Attempt::GivenUp { error });
        }
        tracing::warn!(recipient, id, %asset, attempts, error, "failed to send a notification: trying again");
        let again_at = now.saturating_add(wait_after(attempts)).unwrap_or(now);
        Ok(Attempt::Failed { error, again_at })
    }
}

/// How long to wait after so many attempts.
fn wait_after(attempts: u64) -> SignedDuration {
    let doublings = attempts.saturating_sub(1).min(32);
    SignedDuration::from_secs((FIRST_WAIT_S << doublings).min(MAX_WAIT_S))
}

/// An error with what caused it, as one line.
fn chain(error: &NotificationError) -> String {
    let mut text = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(next) = cause {
        let said = next.to_string();
        if !text.contains(&said) {
            text = format!("{text}: {said}");
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
