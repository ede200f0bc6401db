//! Stored states of the fold over a channel's records, from which to restart.
//!
//! A state has up to a quarter of a megabyte once a channel tracks wear, so it is not stored after each
//! record. The records after the newest stored state are folded again when somebody needs the state after the
//! last one.

use sqlx::any::AnyRow;

use crate::asset::SegmentId;
use crate::store::database::rows::{any_of, get, get_count, get_time, rows_of_placeholders, to_ns};
use crate::store::transaction::{ROWS_PER_STATEMENT, Transaction};
use crate::store::{ChannelSummary, SegmentKey, Store, StoreError, WearGeneration};

/// Number of records from one stored state to the next: at most as many are folded again after a start.
pub const RECORDS_PER_STATE: u64 = 16;

/// Whether the state after `position` records is stored while the newest stored state is the one after
/// `newest` records.
///
/// The distance between stored states grows with their age. So there are few, and the records from the
/// nearest state to a late record are at most twice as many as those that follow it.
pub fn is_stored(position: u64, newest: u64) -> bool {
    let age = newest.saturating_sub(position);
    let distance = if age < RECORDS_PER_STATE { RECORDS_PER_STATE } else { 1 << age.ilog2() };
    position.is_multiple_of(distance)
}

/// The state of the fold after some of a channel's records in the order of time.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredFoldState {
    /// The last record folded.
    pub last: SegmentKey,
    /// Number of records folded.
    pub position: u64,
    /// The state as JSON.
    pub state: String,
}

impl Store {
    /// The latest stored state of a channel, in the served generation.
    pub async fn newest_state(
        &self,
        channel: &ChannelSummary,
    ) -> Result<Option<StoredFoldState>, StoreError> {
        let row = sqlx::query("SELECT * FROM fold_states WHERE channel_no = $1 AND generation = $2 ORDER BY position DESC LIMIT 1")
            .bind(channel.channel_no)
            .bind(channel.wear_generation)
            .fetch_optional(self.read())
            .await?;
        row.as_ref().map(state_of).transpose()
    }

    /// The latest stored state of a generation that includes neither `key` nor any later record.
    pub async fn state_before(
        &self,
        channel: &ChannelSummary,
        generation: WearGeneration,
        key: &SegmentKey,
    ) -> Result<Option<StoredFoldState>, StoreError> {
        let row = sqlx::query(
            "SELECT * FROM fold_states WHERE channel_no = $1 AND generation = $2 AND (start_time_ns, segment_id) < ($3, $4)
             ORDER BY position DESC LIMIT 1",
        )
        .bind(channel.channel_no)
        .bind(generation.0)
        .bind(to_ns(key.start_time)?)
        .bind(key.id.0.as_str())
        .fetch_optional(self.read())
        .await?;
        row.as_ref().map(state_of).transpose()
    }
}

/// A channel number, a generation, a position, and the states that replace all states after it, in ascending
/// order.
pub(in crate::store) type StatesAfter<'a> = (i64, i64, u64, &'a [StoredFoldState]);

impl Transaction {
    /// Replaces states of the fold, at most once for each channel, and thins the older ones.
    pub(in crate::store) async fn set_states(&mut self, all: &[StatesAfter<'_>]) -> Result<(), StoreError> {
        for chunk in all.chunks(ROWS_PER_STATEMENT) {
            self.remove_states_after(chunk).await?;
        }
        let new: Vec<(i64, i64, &StoredFoldState)> = all
            .iter()
            .flat_map(|&(channel_no, generation, _, states)| {
                states.iter().map(move |state| (channel_no, generation, state))
            })
            .collect();
        for chunk in new.chunks(ROWS_PER_STATEMENT) {
            let text = format!(
                "INSERT INTO fold_states (channel_no, generation, position, start_time_ns, segment_id, state) VALUES {}",
                rows_of_placeholders(chunk.len(), 6)
            );
            let mut query = sqlx::query(&text).persistent(self.dialect.caches_statement(chunk.len()));
            for (channel_no, generation, state) in chunk {
                query = query
                    .bind(*channel_no)
                    .bind(*generation)
                    .bind(from_count(state.position))
                    .bind(to_ns(state.last.start_time)?)
                    .bind(state.last.id.0.as_str())
                    .bind(state.state.as_str());
            }
            query.execute(&mut *self.inner).await?;
        }
        for &(channel_no, generation, _, states) in all {
            if let Some(newest) = states.last() {
                self.thin_states(channel_no, generation, newest.position).await?;
            }
        }
        Ok(())
    }

    /// Removes the states that are not stored any more with this newest one: see [`is_stored`].
    async fn thin_states(&mut self, channel_no: i64, generation: i64, newest: u64) -> Result<(), StoreError> {
        let ages = (RECORDS_PER_STATE.ilog2() + 1..=newest.ilog2()).map(|power| 1 << power);
        let to_remove: Vec<String> =
            ages.map(|age: u64| format!("position <= {} AND position % {age} <> 0", newest - age)).collect();
        if to_remove.is_empty() {
            return Ok(());
        }
        let text = format!(
            "DELETE FROM fold_states WHERE channel_no = $1 AND generation = $2 AND ({})",
            to_remove.join(" OR ")
        );
        sqlx::query(&text)
            .persistent(false)
            .bind(channel_no)
            .bind(generation)
            .execute(&mut *self.inner)
            .await?;
        Ok(())
    }

    async fn remove_states_after(&mut self, all: &[StatesAfter<'_>]) -> Result<(), StoreError> {
        let which = any_of(all.len(), &["channel_no =", "generation =", "position >"]);
        let text = format!("DELETE FROM fold_states WHERE {which}");
        let mut query = sqlx::query(&text).persistent(self.dialect.caches_statement(all.len()));
        for &(channel_no, generation, after, _) in all {
            query = query.bind(channel_no).bind(generation).bind(from_count(after));
        }
        query.execute(&mut *self.inner).await?;
        Ok(())
    }
}

fn from_count(count: u64) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

fn state_of(row: &AnyRow) -> Result<StoredFoldState, StoreError> {
    Ok(StoredFoldState {
        last: SegmentKey {
            start_time: get_time(row, "start_time_ns")?,
            id: SegmentId(get(row, "segment_id")?),
        },
        position: get_count(row, "position")?,
        state: get(row, "state")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stored_states_are_few_and_the_nearest_before_a_record_is_not_far() {
        let mut stored: Vec<u64> = Vec::new();
        for newest in (RECORDS_PER_STATE..=100_000).step_by(16) {
            stored.push(newest);
            stored.retain(|position| is_stored(*position, newest));
            assert!(stored.len() <= 2 + newest.ilog2() as usize, "{stored:?}");
        }
        let newest = *stored.last().unwrap();
        for late in (1..newest).step_by(97) {
            let before = stored.iter().rev().find(|position| **position <= late).copied().unwrap_or(0);
            assert!(late - before <= 2 * (newest - late).max(RECORDS_PER_STATE), "{late} from {before}");
        }
    }
}
