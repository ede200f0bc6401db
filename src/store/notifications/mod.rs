//! Notifications about changes of alarms, written in the transaction of the change.

pub(super) mod delivery;

use std::sync::Arc;

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::asset::{AssetId, from_json_name};
use crate::estimate::{AlarmQuantity, AlarmRule, AlarmState, Severity};
use crate::store::database::rows::{get, get_time, to_json, to_ns};
use crate::store::transaction::Transaction;
use crate::store::{AlarmNotice, StoreError};

/// A recipient of notifications.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recipient {
    /// Its name in the settings.
    pub name: String,
    /// The minimum severity: the recipient is notified of alarms that reach it, and of their end.
    pub at_least: Severity,
}

/// All recipients of notifications.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recipients {
    /// The recipients.
    pub list: Vec<Recipient>,
    /// Maximum age of the record or event that raises an alarm: older ones, such as those of imported
    /// recordings, cause no notification.
    pub newer_than: SignedDuration,
}

impl Default for Recipients {
    fn default() -> Self {
        Self { list: Vec::new(), newer_than: SignedDuration::from_hours(24) }
    }
}

/// The change of an alarm relative to the previous notification.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NotificationKind {
    /// The alarm was raised.
    Raised,
    /// The severity increased.
    Worsened,
    /// The severity decreased.
    Eased,
    /// The alarm was cleared.
    Cleared,
}

impl NotificationKind {
    fn between(before: Option<Severity>, after: Option<Severity>) -> Option<Self> {
        match (before, after) {
            (None, Some(_)) => Some(Self::Raised),
            (Some(_), None) => Some(Self::Cleared),
            _ if after > before => Some(Self::Worsened),
            _ if after < before => Some(Self::Eased),
            _ => None,
        }
    }
}

/// A notification about a change of an alarm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Notification {
    /// Identifier; the same for each attempt and each recipient.
    pub id: String,
    /// Sequence number among the notifications of this alarm.
    pub number: u64,
    /// The kind of change.
    pub kind: NotificationKind,
    /// When it was created.
    pub noted_at: Timestamp,
    /// The alarm.
    pub alarm_id: String,
    /// The asset.
    pub asset_id: AssetId,
    /// The channel.
    pub channel: String,
    /// The quantity that the alarm watches.
    pub quantity: AlarmQuantity,
    /// Its rule; `None` if the asset no longer has it.
    pub rule: Option<AlarmRule>,
    /// The current severity; `None` if the alarm is not raised.
    pub severity: Option<Severity>,
    /// The severity in the previous notification.
    pub severity_before: Option<Severity>,
    /// The time of the record or event that caused it.
    pub time: Timestamp,
    /// The reading that caused it, in the unit of the quantity; `None` if it was not caused by a reading.
    pub value: Option<f64>,
}

impl Transaction {
    /// Stores a notification for each recipient concerned if a change gives the alarm another severity than
    /// the previous notification. A shelved alarm causes none until its shelving ends.
    pub(in crate::store) async fn notify_recipients(
        &mut self,
        notice: &AlarmNotice,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        let AlarmNotice { alarm, change } = notice;
        if self.recipients.list.is_empty() || (alarm.rule.is_some() && change.state == AlarmState::Shelved) {
            return Ok(());
        }
        let row = sqlx::query("SELECT told_severity, told_number FROM alarms WHERE id = $1")
            .bind(alarm.id.as_str())
            .fetch_one(&mut *self.inner)
            .await?;
        let last_severity: Option<String> = get(&row, "told_severity")?;
        let before = last_severity.and_then(|name| from_json_name(&name).ok());
        // An alarm without a rule is cleared, whatever its last severity.
        let after = alarm.rule.as_ref().and(change.severity);
        let Some(kind) = NotificationKind::between(before, after) else {
            return Ok(());
        };
        let is_news = change.state == AlarmState::Unacknowledged
            && now.duration_since(change.time) <= self.recipients.newer_than;
        if after > before && !is_news {
            return Ok(());
        }
        let number: i64 = get::<i64>(&row, "told_number")? + 1;
        sqlx::query("UPDATE alarms SET told_severity = $2, told_number = $3 WHERE id = $1")
            .bind(alarm.id.as_str())
            .bind(after.map(Severity::name))
            .bind(number)
            .execute(&mut *self.inner)
            .await?;
        let noted_at = self.time(now).await?;
        let notification = Notification {
            id: notification_id(&alarm.id, number, noted_at),
            number: number.unsigned_abs(),
            kind,
            noted_at,
            alarm_id: alarm.id.clone(),
            asset_id: alarm.asset_id.clone(),
            channel: alarm.channel.clone(),
            quantity: alarm.quantity.clone(),
            rule: alarm.rule.clone(),
            severity: after,
            severity_before: before,
            time: change.time,
            value: change.value,
        };
        let worst = before.max(after);
        let recipients = Arc::clone(&self.recipients);
        for recipient in recipients.list.iter().filter(|recipient| worst >= Some(recipient.at_least)) {
            self.insert_notification(&notification, &recipient.name).await?;
        }
        Ok(())
    }

    /// The current time: on a shared store by the database's clock, which the senders use too.
    async fn time(&mut self, local: Timestamp) -> Result<Timestamp, StoreError> {
        let Some(text) = self.dialect.time_ns() else {
            return Ok(local);
        };
        let row = sqlx::query(text).fetch_one(&mut *self.inner).await?;
        get_time(&row, "now_ns")
    }

    async fn insert_notification(
        &mut self,
        notification: &Notification,
        recipient: &str,
    ) -> Result<(), StoreError> {
        let id = notification.id.as_str();
        // Due at once by any clock.
        sqlx::query(
            "INSERT INTO notifications (id, recipient, alarm_id, number, notification, noted_at_ns, progress, attempts, due_at_ns)
             VALUES ($1, $2, $3, $4, $5, $6, 'waiting', 0, 0)",
        )
        .bind(id)
        .bind(recipient)
        .bind(notification.alarm_id.as_str())
        .bind(i64::try_from(notification.number).unwrap_or(i64::MAX))
        .bind(to_json(notification, "notification", id)?)
        .bind(to_ns(notification.noted_at)?)
        .execute(&mut *self.inner)
        .await?;
        Ok(())
    }
}

/// The identifier of a notification. The time distinguishes it from one of an alarm with the same id of a
/// deleted asset.
fn notification_id(alarm: &str, number: i64, noted_at: Timestamp) -> String {
    let text = format!("{alarm} {number} {noted_at}");
    hex::encode(&Sha256::digest(text)[..16])
}
