//! Writing alarms: the changes of a new fold replace those of the previous one; operator actions are kept.

use std::collections::HashMap;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::{StoredAlarm, alarm_of, change_of};
use crate::estimate::{ActionTaken, Alarm, AlarmAction, AlarmChange, AlarmPanel, AlarmQuantity, AlarmRule};
use crate::store::database::rows::{get, get_count, to_json, to_ns};
use crate::store::transaction::Transaction;
use crate::store::{ChannelSummary, SegmentKey, StoreError};

/// A change of an alarm and its place in the fold.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedChange {
    /// Twice the number of records up to and including it; plus one if it lies between that record and the
    /// next.
    pub place: u64,
    /// Index of the channel's rule.
    pub rule: usize,
    /// The change.
    pub change: AlarmChange,
}

/// The alarms of a channel as folded after a place.
#[derive(Debug, Clone, Copy)]
pub struct FoldedAlarms<'a> {
    /// The rules.
    pub rules: &'a [AlarmRule],
    /// The alarms after all records and actions.
    pub panel: &'a AlarmPanel,
    /// The changes after the place, in order.
    pub changes: &'a [PlacedChange],
    /// The place.
    pub after: u64,
    /// Whether records were only appended to those folded before.
    pub is_append: bool,
}

/// A change of an alarm, for its event.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AlarmNotice {
    /// The alarm after the change.
    pub alarm: StoredAlarm,
    /// The change.
    pub change: AlarmChange,
}

impl Transaction {
    /// Writes a channel's alarms as folded. Returns the notices of new changes: every change by appended
    /// records; after a history was folded again, only those of alarms whose state or severity differs from
    /// before.
    pub async fn set_alarms(
        &mut self,
        channel: &ChannelSummary,
        folded: FoldedAlarms<'_>,
        now: Timestamp,
    ) -> Result<Vec<AlarmNotice>, StoreError> {
        let before = self.alarms_of(channel).await?;
        let mut old = self.changes_after(channel, folded.after).await?;
        let mut notices = Vec::new();
        for (n, (rule, alarm)) in folded.rules.iter().zip(folded.panel.alarms()).enumerate() {
            let id = alarm_id(channel, &rule.quantity);
            let known = before.iter().find(|alarm| alarm.id == id);
            let old = old.remove(&id).unwrap_or_default();
            let new: Vec<&PlacedChange> = folded.changes.iter().filter(|change| change.rule == n).collect();
            let is_same = old.len() == new.len()
                && old.iter().zip(&new).all(|((place, old), new)| *place == new.place && *old == new.change);
            let is_known = known.is_some_and(|known| known.rule.as_ref() == Some(rule));
            if is_same && (is_known || (known.is_none() && new.is_empty())) {
                continue;
            }
            let stands = |alarm: &Alarm| (alarm.unshelved_state(), alarm.severity());
            let stood = known.map_or_else(|| stands(&Alarm::default()), |known| stands(&known.alarm));
            let mut changed_at =
                alarm.last().map_or_else(|| known.map_or(now, |known| known.changed_at), |last| last.time);
            // A change of the rule may undo the last change: an alarm never changes before it did last.
            if stood != stands(alarm) && known.is_some_and(|known| changed_at < known.changed_at) {
                changed_at = now;
            }
            let stored = StoredAlarm {
                id,
                asset_id: channel.asset_id.clone(),
                channel: channel.channel.clone(),
                quantity: rule.quantity.clone(),
                rule: Some(rule.clone()),
                changed_at,
                alarm: alarm.clone(),
            };
            self.set_alarm(channel, &stored).await?;
            self.replace_changes(&stored.id, folded.after, &old, &new, now).await?;
            let notice = |change: &AlarmChange| AlarmNotice { alarm: stored.clone(), change: change.clone() };
            if folded.is_append {
                let is_new =
                    |new: &&&PlacedChange| !old.iter().any(|(_, old)| old.is_equivalent_to(&new.change));
                notices.extend(new.iter().filter(is_new).map(|new| notice(&new.change)));
            } else if stood != stands(alarm)
                && let Some(last) = alarm.last().or(known.and_then(|known| known.alarm.last()))
            {
                notices.push(notice(last));
            }
        }
        // Alarms without a rule are cleared; their changes and actions are kept.
        for gone in before.iter().filter(|alarm| alarm.rule.is_some()) {
            if folded.rules.iter().all(|rule| rule.quantity != gone.quantity) {
                let over = StoredAlarm { rule: None, alarm: Alarm::default(), ..gone.clone() };
                self.set_alarm(channel, &over).await?;
                if let Some(last) = gone.alarm.last() {
                    notices.push(AlarmNotice { alarm: over, change: last.clone() });
                }
            }
        }
        for notice in &notices {
            self.notify_recipients(notice, now).await?;
        }
        Ok(notices)
    }

    /// Stores an operator action on an alarm of a locked channel, and the resulting change; `place` is where
    /// it takes effect.
    pub async fn act(
        &mut self,
        channel: &mut ChannelSummary,
        place: SegmentKey,
        stored: &StoredAlarm,
        taken: &ActionTaken,
        change: &AlarmChange,
    ) -> Result<(), StoreError> {
        let id = stored.id.as_str();
        let place_after = self.place_after(channel).await?;
        // First, because the action references it.
        self.set_alarm(channel, stored).await?;
        sqlx::query(
            "INSERT INTO alarm_actions (alarm_id, number, after_ns, action)
             SELECT $1, COALESCE(MAX(number), 0) + 1, $2, $3 FROM alarm_actions WHERE alarm_id = $1",
        )
        .bind(id)
        .bind(to_ns(taken.after)?)
        .bind(to_json(taken, "action", id)?)
        .execute(&mut *self.inner)
        .await?;
        sqlx::query(
            "INSERT INTO alarm_changes (alarm_id, place, number, change)
             SELECT $1, $2, COALESCE(MAX(number), 0) + 1, $3 FROM alarm_changes WHERE alarm_id = $1",
        )
        .bind(id)
        .bind(i64::try_from(place_after).unwrap_or(i64::MAX))
        .bind(to_json(change, "change", id)?)
        .execute(&mut *self.inner)
        .await?;
        // Other actions, such as comments, cause no notification.
        if matches!(
            taken.action,
            AlarmAction::Unshelve
                | AlarmAction::ShelvingOver
                | AlarmAction::Stale { .. }
                | AlarmAction::Joint { .. }
        ) {
            let notice = AlarmNotice { alarm: stored.clone(), change: change.clone() };
            self.notify_recipients(&notice, taken.time).await?;
        }
        channel.mark_changed(place);
        self.set_channel(channel, false).await
    }

    /// The place after the latest record. The number of records does not give it: those removed by thinning
    /// keep their places in the fold.
    async fn place_after(&mut self, channel: &ChannelSummary) -> Result<u64, StoreError> {
        let row = sqlx::query(
            "SELECT f.position, (
                SELECT COUNT(*) FROM segments s
                WHERE s.channel_no = f.channel_no AND (s.start_time_ns, s.id) > (f.start_time_ns, f.segment_id)
             ) AS later FROM fold_states f WHERE f.channel_no = $1 AND f.generation = $2 ORDER BY f.position DESC LIMIT 1",
        )
        .bind(channel.channel_no)
        .bind(channel.wear_generation)
        .fetch_optional(&mut *self.inner)
        .await?;
        let folded = match row {
            Some(row) => get_count(&row, "position")? + get_count(&row, "later")?,
            None => channel.segments,
        };
        Ok(2 * folded + 1)
    }

    async fn alarms_of(&mut self, channel: &ChannelSummary) -> Result<Vec<StoredAlarm>, StoreError> {
        let rows = sqlx::query(
            "SELECT l.*, c.asset_id, c.name AS channel FROM alarms l JOIN channels c ON c.channel_no = l.channel_no WHERE l.channel_no = $1",
        )
        .bind(channel.channel_no)
        .fetch_all(&mut *self.inner)
        .await?;
        rows.iter().map(alarm_of).collect()
    }

    /// The changes after a place that are not withdrawn, with their places, in order, for each alarm.
    async fn changes_after(
        &mut self,
        channel: &ChannelSummary,
        after: u64,
    ) -> Result<HashMap<String, Vec<(u64, AlarmChange)>>, StoreError> {
        let rows = sqlx::query(
            "SELECT h.* FROM alarm_changes h JOIN alarms l ON l.id = h.alarm_id
             WHERE l.channel_no = $1 AND h.place > $2 AND h.withdrawn_at_ns IS NULL ORDER BY h.place, h.number",
        )
        .bind(channel.channel_no)
        .bind(i64::try_from(after).unwrap_or(i64::MAX))
        .fetch_all(&mut *self.inner)
        .await?;
        let mut changes: HashMap<String, Vec<_>> = HashMap::new();
        for row in &rows {
            let place = get_count(row, "place")?;
            changes.entry(get(row, "alarm_id")?).or_default().push((place, change_of(row)?.change));
        }
        Ok(changes)
    }

    async fn set_alarm(&mut self, channel: &ChannelSummary, stored: &StoredAlarm) -> Result<(), StoreError> {
        let id = stored.id.as_str();
        let StoredAlarm { quantity, rule, alarm, .. } = stored;
        sqlx::query(
            "INSERT INTO alarms (id, channel_no, quantity, rule, alarm, standing, severity, shelved_until_ns, changed_at_ns)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)
             ON CONFLICT (id) DO UPDATE SET rule = excluded.rule, alarm = excluded.alarm, standing = excluded.standing,
                severity = excluded.severity, shelved_until_ns = excluded.shelved_until_ns, changed_at_ns = excluded.changed_at_ns",
        )
        .bind(id)
        .bind(channel.channel_no)
        .bind(to_json(quantity, "quantity", id)?)
        .bind(rule.as_ref().map(|rule| to_json(rule, "rule", id)).transpose()?)
        .bind(to_json(alarm, "alarm", id)?)
        .bind(alarm.unshelved_state().name())
        .bind(alarm.severity().map(|severity| severity.name()))
        .bind(alarm.shelved_until().map(to_ns).transpose()?)
        .bind(to_ns(stored.changed_at)?)
        .execute(&mut *self.inner)
        .await?;
        Ok(())
    }

    async fn replace_changes(
        &mut self,
        id: &str,
        after: u64,
        old: &[(u64, AlarmChange)],
        new: &[&PlacedChange],
        now: Timestamp,
    ) -> Result<(), StoreError> {
        sqlx::query(
            "DELETE FROM alarm_changes WHERE alarm_id = $1 AND place > $2 AND withdrawn_at_ns IS NULL",
        )
        .bind(id)
        .bind(i64::try_from(after).unwrap_or(i64::MAX))
        .execute(&mut *self.inner)
        .await?;
        // Withdrawn changes that the new fold contains again are no longer withdrawn.
        let text = "SELECT * FROM alarm_changes WHERE alarm_id = $1 AND withdrawn_at_ns IS NOT NULL ORDER BY place, number";
        let rows = sqlx::query(text).bind(id).fetch_all(&mut *self.inner).await?;
        for row in &rows {
            let withdrawn = change_of(row)?.change;
            if new.iter().any(|new| new.change.is_equivalent_to(&withdrawn)) {
                sqlx::query("DELETE FROM alarm_changes WHERE alarm_id = $1 AND number = $2 AND place = $3 AND withdrawn_at_ns IS NOT NULL")
                    .bind(id)
                    .bind(get::<i64>(row, "number")?)
                    .bind(get::<i64>(row, "place")?)
                    .execute(&mut *self.inner)
                    .await?;
            }
        }
        let withdrawn = old.iter().filter(|(_, old)| {
            old.action.is_none() && !new.iter().any(|new| new.change.is_equivalent_to(old))
        });
        let kept = new.iter().map(|new| (new.place, &new.change, None));
        let all = withdrawn.map(|(place, change)| (*place, change, Some(now))).chain(kept);
        let first = sqlx::query(
            "SELECT COALESCE(MAX(number), 0) + 1 AS number FROM alarm_changes WHERE alarm_id = $1",
        )
        .bind(id)
        .fetch_one(&mut *self.inner)
        .await?;
        for (number, (place, change, withdrawn_at)) in (get::<i64>(&first, "number")?..).zip(all) {
            sqlx::query("INSERT INTO alarm_changes (alarm_id, place, number, change, withdrawn_at_ns) VALUES ($1, $2, $3, $4, $5)")
                .bind(id)
                .bind(i64::try_from(place).unwrap_or(i64::MAX))
                .bind(number)
                .bind(to_json(change, "change", id)?)
                .bind(withdrawn_at.map(to_ns).transpose()?)
                .execute(&mut *self.inner)
                .await?;
        }
        Ok(())
    }
}

/// The identifier of an alarm: a hash of its asset, channel and quantity, independent of its levels.
pub(in crate::store) fn alarm_id(channel: &ChannelSummary, quantity: &AlarmQuantity) -> String {
    let mut hash = Sha256::new();
    for part in [channel.asset_id.as_str(), &channel.channel, &quantity.to_string()] {
        hash.update((part.len() as u64).to_le_bytes());
        hash.update(part);
    }
    hex::encode(&hash.finalize()[..8])
}
