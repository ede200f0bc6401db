//! Delivery of notifications: which one is attempted next and by which process, and the outcomes.

use jiff::{SignedDuration, Timestamp};
use serde::Serialize;
use sqlx::any::AnyRow;

use crate::store::database::rows::{from_ns, get, get_count, get_json, get_time, lease_end, to_ns};
use crate::store::{Notification, Store, StoreError};

/// How long notifications are kept that are sent or given up, or whose recipient is no longer in any
/// settings.
const KEPT: SignedDuration = SignedDuration::from_hours(30 * 24);

/// A notification leased by this process for sending.
#[derive(Debug, Clone, PartialEq)]
pub struct PendingNotification {
    /// The notification.
    pub notification: Notification,
    /// The name of the recipient.
    pub recipient: String,
    /// Number of attempts, including this one.
    pub attempts: u64,
}

/// The outcome of an attempt.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Attempt {
    /// The recipient accepted it.
    Sent,
    /// It failed and will be retried.
    Failed {
        /// Why it failed.
        error: String,
        /// When it will be retried, by the store's clock.
        again_at: Timestamp,
    },
    /// It failed and will not be retried.
    GivenUp {
        /// Why it failed.
        error: String,
    },
}

/// Status of a recipient's notifications.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[schema(as = RecipientView)]
pub struct RecipientStatus {
    /// The recipient's name in the settings.
    #[serde(rename = "name")]
    pub recipient: String,
    /// Number of notifications not sent yet.
    pub waiting: u64,
    /// Creation time of the oldest of them; none if nothing waits.
    pub oldest_at: Option<Timestamp>,
    /// Number sent in the last 30 days.
    pub sent: u64,
    /// When the last one was sent.
    pub last_sent_at: Option<Timestamp>,
    /// Number that failed for good in the last 30 days.
    pub given_up: u64,
    /// Error of the latest waiting or failed notification; none if there was no error.
    pub error: Option<String>,
}

impl Store {
    /// Leases the next due notification of a recipient; returns `None` if none is due. The lease expires
    /// unless the outcome is reported within `lease`.
    ///
    /// Notifications of one alarm are sent one after the other, in the order in which they were created.
    pub async fn next_notification(
        &self,
        recipient: &str,
        lease: SignedDuration,
        local: Timestamp,
    ) -> Result<Option<PendingNotification>, StoreError> {
        let now = self.now(local).await?;
        let until = lease_end(now, lease);
        loop {
            let found = sqlx::query(
                "SELECT n.id FROM notifications n WHERE n.recipient = $1 AND n.progress = 'waiting' AND n.due_at_ns <= $2
                    AND NOT EXISTS (SELECT 1 FROM notifications e WHERE e.alarm_id = n.alarm_id AND e.recipient = n.recipient
                        AND e.progress = 'waiting' AND e.number < n.number)
                 ORDER BY n.due_at_ns, n.noted_at_ns, n.id LIMIT 1",
            )
            .bind(recipient)
            .bind(to_ns(now)?)
            .fetch_optional(self.read())
            .await?;
            let Some(found) = found else { return Ok(None) };
            let id: String = get(&found, "id")?;
            let taken = sqlx::query(
                "UPDATE notifications SET attempts = attempts + 1, due_at_ns = $4
                 WHERE id = $1 AND recipient = $2 AND progress = 'waiting' AND due_at_ns <= $3
                 RETURNING notification, attempts",
            )
            .bind(id.as_str())
            .bind(recipient)
            .bind(to_ns(now)?)
            .bind(to_ns(until)?)
            .fetch_optional(self.write()?)
            .await?;
            // If another process leased it first, the next one may be free.
            if let Some(row) = taken {
                return Ok(Some(PendingNotification {
                    notification: get_json(&row, "notification", &id)?,
                    recipient: recipient.to_owned(),
                    attempts: get_count(&row, "attempts")?,
                }));
            }
        }
    }

    /// Reports the outcome of an attempt, unless another process has leased the notification since.
    pub async fn end_attempt(
        &self,
        pending: &PendingNotification,
        attempt: &Attempt,
        local: Timestamp,
    ) -> Result<(), StoreError> {
        let now = self.now(local).await?;
        let (progress, error, due_at, ended_at) = match attempt {
            Attempt::Sent => ("sent", "", now, Some(now)),
            Attempt::Failed { error, again_at } => ("waiting", error.as_str(), *again_at, None),
            Attempt::GivenUp { error } => ("given_up", error.as_str(), now, Some(now)),
        };
        sqlx::query(
            "UPDATE notifications SET progress = $4, error = NULLIF($5, ''), due_at_ns = $6, ended_at_ns = $7
             WHERE id = $1 AND recipient = $2 AND progress = 'waiting' AND attempts = $3",
        )
        .bind(pending.notification.id.as_str())
        .bind(pending.recipient.as_str())
        .bind(i64::try_from(pending.attempts).unwrap_or(i64::MAX))
        .bind(progress)
        .bind(error)
        .bind(to_ns(due_at)?)
        .bind(ended_at.map(to_ns).transpose()?)
        .execute(self.write()?)
        .await?;
        Ok(())
    }

    /// The status of the notifications of each recipient that this process knows, and of each that has any.
    pub async fn notified(&self) -> Result<Vec<RecipientStatus>, StoreError> {
        let known = self.recipients();
        let named = known.list.iter().map(|recipient| recipient.name.clone());
        let mut all: Vec<RecipientStatus> =
            named.map(|recipient| RecipientStatus { recipient, ..RecipientStatus::default() }).collect();
        let rows = sqlx::query(
            "SELECT recipient, progress, COUNT(*) AS count, MIN(noted_at_ns) AS oldest_ns, MAX(ended_at_ns) AS last_ns
             FROM notifications GROUP BY recipient, progress ORDER BY recipient, progress",
        )
        .fetch_all(self.read())
        .await?;
        for row in &rows {
            let recipient: String = get(row, "recipient")?;
            let place = all.iter().position(|notified| notified.recipient == recipient);
            let place = place.unwrap_or_else(|| {
                all.push(RecipientStatus { recipient, ..RecipientStatus::default() });
                all.len() - 1
            });
            all[place].count(row)?;
        }
        for notified in all.iter_mut().filter(|notified| notified.waiting + notified.given_up > 0) {
            let row = sqlx::query(
                "SELECT error FROM notifications WHERE recipient = $1 AND progress <> 'sent' AND error IS NOT NULL
                 ORDER BY noted_at_ns DESC, id DESC LIMIT 1",
            )
            .bind(notified.recipient.as_str())
            .fetch_optional(self.read())
            .await?;
            notified.error = row.map(|row| get(&row, "error")).transpose()?;
        }
        Ok(all)
    }

    /// Removes old notifications.
    pub async fn forget_notifications(&self, local: Timestamp) -> Result<(), StoreError> {
        let now = self.now(local).await?;
        let before = to_ns(now.saturating_sub(KEPT).unwrap_or(Timestamp::MIN))?;
        sqlx::query("DELETE FROM notifications WHERE ended_at_ns < $1 OR noted_at_ns < $1")
            .bind(before)
            .execute(self.write()?)
            .await?;
        Ok(())
    }
}

impl RecipientStatus {
    fn count(&mut self, row: &AnyRow) -> Result<(), StoreError> {
        let count = get_count(row, "count")?;
        let last_ns: Option<i64> = get(row, "last_ns")?;
        match get::<String>(row, "progress")?.as_str() {
            "waiting" => (self.waiting, self.oldest_at) = (count, Some(get_time(row, "oldest_ns")?)),
            "sent" => (self.sent, self.last_sent_at) = (count, last_ns.map(from_ns)),
            _ => self.given_up = count,
        }
        Ok(())
    }
}
