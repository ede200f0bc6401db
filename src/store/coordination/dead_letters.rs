//! Counts of how often a record became a dead letter, so that the queue does not take a repeated one for a
//! duplicate.

use std::collections::HashMap;

use jiff::{SignedDuration, Timestamp};

use crate::asset::SegmentId;
use crate::store::database::rows::{get, placeholders, to_ns};
use crate::store::{Store, StoreError};

/// How long a count is kept: longer than the deduplication window of the queue.
const REMEMBERED: SignedDuration = SignedDuration::from_hours(24);

impl Store {
    /// Counts a record as a dead letter; counting the same letter again changes nothing.
    pub async fn count_dead_letter(
        &self,
        segment: &SegmentId,
        letter: i64,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        sqlx::query("DELETE FROM dead_letters WHERE put_at_ns < $1")
            .bind(to_ns(now.saturating_sub(REMEMBERED).unwrap_or(Timestamp::MIN))?)
            .execute(self.write()?)
            .await?;
        sqlx::query(
            "INSERT INTO dead_letters (segment_id, times, letter, put_at_ns) VALUES ($1, 1, $2, $3)
             ON CONFLICT (segment_id) DO UPDATE SET times = dead_letters.times + 1, letter = excluded.letter, put_at_ns = excluded.put_at_ns
             WHERE dead_letters.letter <> excluded.letter",
        )
        .bind(segment.0.as_str())
        .bind(letter)
        .bind(to_ns(now)?)
        .execute(self.write()?)
        .await?;
        Ok(())
    }

    /// Returns which of these records became dead letters recently, and how often.
    pub async fn dead_letters_of(
        &self,
        segments: &[SegmentId],
    ) -> Result<HashMap<SegmentId, u32>, StoreError> {
        let mut found = HashMap::new();
        for chunk in segments.chunks(500) {
            let text = format!(
                "SELECT segment_id, times FROM dead_letters WHERE segment_id IN ({})",
                placeholders(1, chunk.len())
            );
            let query =
                chunk.iter().fold(sqlx::query(&text), |query, segment| query.bind(segment.0.as_str()));
            for row in query.fetch_all(self.read()).await? {
                let times: i64 = get(&row, "times")?;
                found.insert(SegmentId(get(&row, "segment_id")?), u32::try_from(times).unwrap_or(u32::MAX));
            }
        }
        Ok(found)
    }
}
