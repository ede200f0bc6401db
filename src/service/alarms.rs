//! Operator actions on alarms, and the expiry of shelvings, which does not wait for a record.

use std::sync::Arc;
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};

use super::background::every;
use super::clock::Clock;
use super::error::ServiceError;
use super::events::EventSender;
use super::history::History;
use super::pipeline::Committer;
use crate::asset::SegmentId;
use crate::estimate::{ActionTaken, AlarmAction};
use crate::store::{AlarmNotice, ChannelSummary, SegmentKey, Store, StoredAlarm};

/// How often expired shelvings are looked for.
const SHELVING_INTERVAL: Duration = Duration::from_secs(1);

/// Maximum number of shelvings ended at a time.
const MAX_EXPIRED: u32 = 64;

/// An action of an operator on an alarm.
#[derive(Debug, Clone, PartialEq)]
pub struct OperatorAction {
    /// The action.
    pub action: AlarmAction,
    /// The operator.
    pub by: String,
    /// The operator's comment.
    pub comment: String,
}

/// The alarms of all channels.
pub struct Alarms {
    pub(crate) store: Store,
    pub(crate) history: Arc<History>,
    pub(crate) committer: Arc<Committer>,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) events: EventSender,
}

impl Alarms {
    /// Applies an action to an alarm; returns once it is durable.
    ///
    /// # Errors
    /// [`ServiceError::AlarmUnknown`]; [`ServiceError::Alarm`] if the action is not possible in the alarm's
    /// state.
    pub async fn act(&self, id: &str, done: OperatorAction) -> Result<StoredAlarm, ServiceError> {
        let stored = self.store.alarm(id).await?;
        let stored = stored.ok_or_else(|| ServiceError::AlarmUnknown(id.to_owned()))?;
        self.act_on(stored, None, done).await
    }

    /// Applies an action to an alarm in its state under the channel's lock; `known` is its state if it is not
    /// stored yet. If a channel was `observed`, the action is applied only if no record has been stored
    /// since.
    pub(crate) async fn act_on(
        &self,
        known: StoredAlarm,
        observed: Option<&ChannelSummary>,
        done: OperatorAction,
    ) -> Result<StoredAlarm, ServiceError> {
        let store = &self.store;
        let id = known.id.clone();
        let unknown = || ServiceError::AlarmUnknown(id.clone());
        // No records are committed in the meantime, so the place after the latest one is known.
        let _pause = self.committer.pause().await;
        let lock = self.history.lock(&known.asset_id, &known.channel).await;
        let channel = store.channel(&known.asset_id, &known.channel).await?.ok_or_else(unknown)?;
        let mut transaction = store.begin().await?;
        let mut channel = transaction.lock_channel(&channel).await?;
        if observed.is_some_and(|observed| observed.segments != channel.segments) {
            return Err(unknown());
        }
        // Read again under the lock: a recomputed history may have changed it.
        let mut stored = match store.alarm(&id).await? {
            Some(stored) => StoredAlarm { rule: stored.rule.or(known.rule), ..stored },
            None if observed.is_some() => known,
            None => return Err(unknown()),
        };
        let now = self.clock.now();
        stored.alarm.check(now, &done.action)?;
        let taken = ActionTaken {
            time: now,
            after: channel.last_start_time.unwrap_or(now),
            action: done.action,
            seen: stored.alarm.severity(),
            by: done.by,
            comment: done.comment,
        };
        let change = stored.alarm.act(&taken);
        stored.changed_at = change.time;
        let place = first_key_after(taken.after);
        transaction.act(&mut channel, place, &stored, &taken, &change).await?;
        transaction.commit().await?;
        drop(lock);
        let alarm = stored.clone();
        self.events.send_alarms(vec![AlarmNotice { alarm, change }]);
        Ok(stored)
    }

    /// Applies an action of the service itself, unless an operator, a record or another process came first:
    /// the alarm is in another state or gone.
    pub(crate) async fn act_automatically(
        &self,
        known: StoredAlarm,
        observed: Option<&ChannelSummary>,
        action: AlarmAction,
    ) -> Result<(), ServiceError> {
        let done = OperatorAction { action, by: String::new(), comment: String::new() };
        match self.act_on(known, observed, done).await {
            Ok(_) | Err(ServiceError::Alarm(_) | ServiceError::AlarmUnknown(_)) => Ok(()),
            Err(error) => Err(error),
        }
    }

    /// Does `work` on the alarms each `interval` in the background, for as long as the service exists.
    pub(crate) fn every<F>(
        self: &Arc<Self>,
        interval: Duration,
        what: &'static str,
        mut work: impl FnMut(Arc<Self>) -> F + Send + 'static,
    ) where
        F: Future<Output = Result<(), ServiceError>> + Send + 'static,
    {
        let alarms = Arc::downgrade(self);
        every(interval, interval, what, &self.store, move || alarms.upgrade().map(&mut work));
    }

    /// Ends expired shelvings in the background.
    pub(crate) fn end_shelvings_in_background(self: &Arc<Self>) {
        self.every(SHELVING_INTERVAL, "end expired shelvings", |alarms| async move {
            alarms.end_shelvings().await
        });
    }

    async fn end_shelvings(&self) -> Result<(), ServiceError> {
        let mut result = Ok(());
        for id in self.store.expired_shelvings(self.clock.now(), MAX_EXPIRED).await? {
            if let Some(stored) = self.store.alarm(&id).await? {
                // The others end also after an error; the next round tries this one again.
                result = result.and(self.act_automatically(stored, None, AlarmAction::ShelvingOver).await);
            }
        }
        result
    }
}

/// The first key after all records of a time.
fn first_key_after(time: Timestamp) -> SegmentKey {
    SegmentKey {
        start_time: time.checked_add(SignedDuration::from_nanos(1)).unwrap_or(Timestamp::MAX),
        id: SegmentId(String::new()),
    }
}
