//! Who is notified of which change of an alarm, and what they are told; written in the transaction that makes
//! the change.

use std::sync::Arc;

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::commit::Commit;
use super::rows::{get, get_time, to_json, to_ns};
use super::{AlarmNotice, StoreError};
use crate::asset::AssetId;
use crate::estimate::{AlarmQuantity, AlarmRule, AlarmState, Severity};

/// Somebody who is notified.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recipient {
    /// Their name in the settings.
    pub name: String,
    /// They are told of what reaches this severity, and of its end.
    pub at_least: Severity,
}

/// All who are notified.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recipients {
    /// Each of them.
    pub list: Vec<Recipient>,
    /// An alarm that is raised by a record or event older than this is told to nobody: old recordings that
    /// are imported are no news.
    pub newer_than: SignedDuration,
}

impl Default for Recipients {
    fn default() -> Self {
        Self { list: Vec::new(), newer_than: SignedDuration::from_hours(24) }
    }
}

/// What happened to an alarm, compared with what was told before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NotificationKind {
    /// Nothing was raised before.
    Raised,
    /// The severity rose.
    Worsened,
    /// The severity fell.
    Eased,
    /// Nothing is raised any more.
    Cleared,
}

impl NotificationKind {
    /// Its name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Raised => "raised",
            Self::Worsened => "worsened",
            Self::Eased => "eased",
            Self::Cleared => "cleared",
        }
    }

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

/// What the recipients are told of a change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Notification {
    /// Identifier; the same whenever this is sent again, and to whomever.
    pub id: String,
    /// Rises with the notifications of this alarm.
    pub number: u64,
    /// What happened.
    pub kind: NotificationKind,
    /// When it was noted.
    pub noted_at: Timestamp,
    /// The alarm.
    pub alarm_id: String,
    /// The asset.
    pub asset_id: AssetId,
    /// The channel.
    pub channel: String,
    /// What the alarm watches.
    pub quantity: AlarmQuantity,
    /// Its rule; none where the asset has no such rule any more.
    pub rule: Option<AlarmRule>,
    /// The severity now; none where nothing is raised.
    pub severity: Option<Severity>,
    /// The severity that was told before.
    pub severity_before: Option<Severity>,
    /// The time of the record or event that caused it.
    pub time: Timestamp,
    /// The reading that caused it, in the unit of the quantity; none where it was no reading.
    pub value: Option<f64>,
}

impl Commit {
    /// Keeps a notification for each recipient whom a change concerns: one that makes the alarm stand
    /// otherwise than was told last. Nothing is told of a shelved alarm before its shelving is over.
    pub(super) async fn note_for_recipients(
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
            .fetch_one(&mut *self.transaction)
            .await?;
        let told: Option<String> = get(&row, "told_severity")?;
        let before = told.as_deref().and_then(Severity::from_name);
        // What no rule watches any more is over, whatever was said of it last.
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
            .execute(&mut *self.transaction)
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

    /// The time: where processes share the store by the database's clock, as for who sends.
    async fn time(&mut self, local: Timestamp) -> Result<Timestamp, StoreError> {
        let Some(text) = self.dialect.time_ns() else {
            return Ok(local);
        };
        let row = sqlx::query(text).fetch_one(&mut *self.transaction).await?;
        get_time(&row, "now_ns")
    }

    async fn insert_notification(
        &mut self,
        notification: &Notification,
        recipient: &str,
    ) -> Result<(), StoreError> {
        let id = notification.id.as_str();
        // Due at once, whatever the clock that asks.
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
        .execute(&mut *self.transaction)
        .await?;
        Ok(())
    }
}

/// The name of an alarm's notification. The time tells it from that of an alarm of the same name before its
/// asset was deleted.
fn notification_id(alarm: &str, number: i64, noted_at: Timestamp) -> String {
    let text = format!("{alarm} {number} {noted_at}");
    hex::encode(&Sha256::digest(text)[..16])
}
