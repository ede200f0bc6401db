//! Operator actions on alarms, and the expiry of shelvings, which does not wait for a record.

use std::sync::Arc;
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};

use super::clock::Clock;
use super::error::ServiceError;
use super::events::Announcer;
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
    pub(crate) events: Announcer,
}

impl Alarms {
    /// Applies an action to an alarm; returns once it is durable.
    ///
    /// Errors: [`ServiceError::AlarmUnknown`]; [`ServiceError::Alarm`] if the action is not possible in the
    /// alarm's state.
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
        let slot = self.history.lock(&known.asset_id, &known.channel).await;
        let channel = store.channel(&known.asset_id, &known.channel).await?.ok_or_else(unknown)?;
        let mut commit = store.begin().await?;
        let mut channel = commit.channel_again(&channel).await?;
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
        commit.act(&mut channel, place, &stored, &taken, &change).await?;
        commit.finish().await?;
        drop(slot);
        let alarm = stored.clone();
        self.events.announce_alarms(vec![AlarmNotice { alarm, change }]);
        Ok(stored)
    }

    /// Ends expired shelvings in the background for as long as the service exists.
    pub(crate) fn end_shelvings_in_background(self: &Arc<Self>) {
        let alarms = Arc::downgrade(self);
        tokio::spawn(async move {
            loop {
                tokio::time::sleep(SHELVING_INTERVAL).await;
                let Some(alarms) = alarms.upgrade() else { return };
                if alarms.store.is_closed() {
                    return;
                }
                if let Err(error) = alarms.end_shelvings().await {
                    tracing::warn!(%error, "failed to end expired shelvings");
                }
            }
        });
    }

    async fn end_shelvings(&self) -> Result<(), ServiceError> {
        for alarm in self.store.expired_shelvings(self.clock.now(), MAX_EXPIRED).await? {
            let over = OperatorAction {
                action: AlarmAction::ShelvingOver,
                by: String::new(),
                comment: String::new(),
            };
            match self.act(&alarm, over).await {
                // Another action came first: the alarm is unshelved, shelved again or gone.
                Ok(_) | Err(ServiceError::Alarm(_) | ServiceError::AlarmUnknown(_)) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

/// The first key after all records of a time.
fn first_key_after(time: Timestamp) -> SegmentKey {
    SegmentKey {
        start_time: time.checked_add(SignedDuration::from_nanos(1)).unwrap_or(Timestamp::MAX),
        id: SegmentId(String::new()),
    }
}
