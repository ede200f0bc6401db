//! What people do to alarms.

use std::sync::Arc;

use jiff::{SignedDuration, Timestamp};

use super::{Announcement, Ingest, IngestError};
use crate::asset::SegmentId;
use crate::estimate::{ActionTaken, AlarmAction};
use crate::store::{AlarmNotice, SegmentKey, StoredAlarm};

/// What somebody does to an alarm.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PersonsAction {
    /// What is done.
    pub action: AlarmAction,
    /// Who does it.
    pub by: String,
    /// What they say.
    pub comment: String,
}

impl Ingest {
    /// Does something to an alarm, and answers once it is on the disk.
    ///
    /// Errors: [`IngestError::AlarmUnknown`]; [`IngestError::Alarm`] where it cannot be done in the alarm's state.
    pub async fn act_on_alarm(&self, id: &str, done: PersonsAction) -> Result<StoredAlarm, IngestError> {
        let store = &self.inner.store;
        let unknown = || IngestError::AlarmUnknown(id.to_owned());
        // No records come in meanwhile: the place after the latest one is known.
        let _turn = self.inner.commits.turn.lock().await;
        let stored = store.alarm(id).await?.ok_or_else(unknown)?;
        let slot = self.inner.channels.lock(&stored.asset_id, &stored.channel).await;
        let channel = store.channel(&stored.asset_id, &stored.channel).await?.ok_or_else(unknown)?;
        let mut commit = store.begin().await?;
        let mut channel = commit.channel_again(&channel).await?;
        // Asked again under the lock: a history that was just folded again may have changed it.
        let mut stored = store.alarm(id).await?.ok_or_else(unknown)?;
        let now = self.inner.clock.now();
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
        self.announce_alarms(vec![AlarmNotice { alarm, change }]);
        Ok(stored)
    }

    pub(super) fn announce_alarms(&self, notices: Vec<AlarmNotice>) {
        for notice in notices {
            self.announce(Announcement::AlarmChanged(Arc::new(notice)));
        }
    }
}

/// The first place after all records of a time.
fn first_key_after(time: Timestamp) -> SegmentKey {
    SegmentKey {
        start_time: time.checked_add(SignedDuration::from_nanos(1)).unwrap_or(Timestamp::MAX),
        id: SegmentId(String::new()),
    }
}
