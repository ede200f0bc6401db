//! Live streams of a shared store in rows: any process continues them from where another one stopped.
//!
//! What is appended at once is a row, numbered by the process that appends it: one more than the last one it
//! has read. Of two processes that append at the same time one finds the number taken; it reads the other's
//! row before it tries again. A checkpoint makes earlier rows removable.

#[cfg(test)]
mod tests;

use bytes::{Bytes, BytesMut};
use futures_util::TryStreamExt;
use jiff::{SignedDuration, Timestamp};

use crate::asset::AssetId;
use crate::store::database::rows::{asset_id, get, get_count, lease_end, to_ns};
use crate::store::{JournalEntry, Store, StoreError, TimedLevel};

/// Length of the lease of a process that stores the records of a stream, from its last renewal.
const LEASE: SignedDuration = SignedDuration::from_secs(20);

/// Bytes of levels of a stream beyond which the oldest are removed: twelve days for one channel.
const MAX_LEVEL_BYTES: i64 = 32 << 20;

/// Number of blocks of levels removed at once.
const LEVEL_BLOCKS: i64 = 16;

/// Identifies a stream; never given out twice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamKey(i64);

/// How far a stream has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamVersion {
    /// The number of the entries after which the stored state is.
    pub checkpoint: u64,
    /// The number of the last entries.
    pub last: u64,
}

/// Entries to be appended to a stream.
#[derive(Debug)]
pub struct StreamAppend<'a> {
    /// Their number.
    pub number: u64,
    /// Index after the last sample before these entries.
    pub first: u64,
    /// Index after their last sample.
    pub end: u64,
    /// Number of pending records after them.
    pub pending: usize,
    /// The entries.
    pub entries: &'a [JournalEntry],
}

/// A stored state of a stream, from which a reader starts.
#[derive(Debug)]
pub struct StreamCheckpoint<'a> {
    /// The number of the previous checkpoint.
    pub previous: u64,
    /// The number of the entries after which the state is.
    pub number: u64,
    /// The state.
    pub state: Bytes,
    /// Levels that were completed since the previous checkpoint.
    pub levels: &'a [TimedLevel],
    /// Earlier samples are not needed any more.
    pub needed_from: u64,
}

impl Store {
    /// Creates a stream with a state, unless there is one; returns false if the asset has `max` others.
    ///
    /// # Errors
    /// [`StoreError::AssetUnknown`] if the asset created at `created_at` is deleted.
    pub async fn create_stream(
        &self,
        asset: &AssetId,
        created_at: Timestamp,
        name: &str,
        state: &Bytes,
        max: usize,
    ) -> Result<bool, StoreError> {
        let mut transaction = self.write()?.begin().await?;
        // Streams of an asset are created one after the other.
        let text = format!(
            "SELECT created_at_ns, (SELECT COUNT(*) FROM streams WHERE asset_id = $1 AND name <> $2) AS others
             FROM assets WHERE id = $1{}",
            self.dialect().for_update()
        );
        let row =
            sqlx::query(&text).bind(asset.as_str()).bind(name).fetch_optional(&mut *transaction).await?;
        let unknown = || StoreError::AssetUnknown(asset.clone());
        let row = row.ok_or_else(unknown)?;
        if get::<i64>(&row, "created_at_ns")? != to_ns(created_at)? {
            return Err(unknown());
        }
        if get_count(&row, "others")? >= max as u64 {
            return Ok(false);
        }
        sqlx::query("UPDATE counters SET value = value + 1 WHERE name = 'stream_no'")
            .execute(&mut *transaction)
            .await?;
        let inserted = sqlx::query(
            "INSERT INTO streams (stream_no, asset_id, name)
             SELECT value, $1, $2 FROM counters WHERE name = 'stream_no'
             ON CONFLICT (asset_id, name) DO NOTHING",
        )
        .bind(asset.as_str())
        .bind(name)
        .execute(&mut *transaction)
        .await?;
        if inserted.rows_affected() > 0 {
            sqlx::query(
                "INSERT INTO stream_states (stream_no, state)
                 SELECT value, $1 FROM counters WHERE name = 'stream_no'",
            )
            .bind(state.to_vec())
            .execute(&mut *transaction)
            .await?;
        }
        transaction.commit().await?;
        Ok(true)
    }

    /// The names of an asset's streams, sorted.
    pub async fn stream_names(&self, asset: &AssetId) -> Result<Vec<String>, StoreError> {
        let rows = sqlx::query("SELECT name FROM streams WHERE asset_id = $1 ORDER BY name")
            .bind(asset.as_str())
            .fetch_all(self.read())
            .await?;
        rows.iter().map(|row| get(row, "name")).collect()
    }

    /// Whether an asset has a stream of this name.
    pub async fn has_stream(&self, asset: &AssetId, name: &str) -> Result<bool, StoreError> {
        let row = sqlx::query("SELECT stream_no FROM streams WHERE asset_id = $1 AND name = $2")
            .bind(asset.as_str())
            .bind(name)
            .fetch_optional(self.read())
            .await?;
        Ok(row.is_some())
    }

    /// Removes a stream; a missing one is not an error.
    pub async fn remove_stream(&self, asset: &AssetId, name: &str) -> Result<(), StoreError> {
        sqlx::query("DELETE FROM streams WHERE asset_id = $1 AND name = $2")
            .bind(asset.as_str())
            .bind(name)
            .execute(self.write()?)
            .await?;
        Ok(())
    }

    /// A stream with the number and the state of its checkpoint.
    pub async fn stream_checkpoint(
        &self,
        asset: &AssetId,
        name: &str,
    ) -> Result<Option<(StreamKey, u64, Bytes)>, StoreError> {
        let row = sqlx::query(
            "SELECT s.stream_no, s.checkpoint, t.state FROM streams s
             JOIN stream_states t ON t.stream_no = s.stream_no WHERE s.asset_id = $1 AND s.name = $2",
        )
        .bind(asset.as_str())
        .bind(name)
        .fetch_optional(self.read())
        .await?;
        let found = row.map(|row| {
            let state: Vec<u8> = get(&row, "state")?;
            Ok((StreamKey(get(&row, "stream_no")?), get_count(&row, "checkpoint")?, state.into()))
        });
        found.transpose()
    }

    /// How far a stream has come; `None` if it is removed.
    pub async fn stream_version(&self, stream: StreamKey) -> Result<Option<StreamVersion>, StoreError> {
        let row = sqlx::query(
            "SELECT checkpoint, COALESCE((SELECT MAX(number) FROM stream_entries e WHERE e.stream_no = s.stream_no), 0) AS last
             FROM streams s WHERE stream_no = $1",
        )
        .bind(stream.0)
        .fetch_optional(self.read())
        .await?;
        let version = row.map(|row| {
            Ok(StreamVersion { checkpoint: get_count(&row, "checkpoint")?, last: get_count(&row, "last")? })
        });
        version.transpose()
    }

    /// The entries of a stream after a number, in order with their numbers; `None` if the first of them are
    /// removed, because a later checkpoint replaces them.
    pub async fn stream_entries(
        &self,
        stream: StreamKey,
        after: u64,
    ) -> Result<Option<Vec<(u64, Vec<JournalEntry>)>>, StoreError> {
        let mut rows = sqlx::query(
            "SELECT number, entries FROM stream_entries WHERE stream_no = $1 AND number > $2 ORDER BY number",
        )
        .bind(stream.0)
        .bind(to_integer(after))
        .fetch(self.read());
        let mut found = Vec::new();
        while let Some(row) = rows.try_next().await? {
            let number = get_count(&row, "number")?;
            if number != after + 1 + found.len() as u64 {
                return Ok(None);
            }
            found.push((number, decoded(number, &get::<Vec<u8>>(&row, "entries")?)?));
        }
        Ok(Some(found))
    }

    /// Appends entries durably; returns false if their number is taken, or if the stream is removed.
    pub async fn append_to_stream(
        &self,
        stream: StreamKey,
        append: &StreamAppend<'_>,
    ) -> Result<bool, StoreError> {
        // The lock keeps a checkpoint from removing the row that has the number.
        let text = format!(
            "INSERT INTO stream_entries (stream_no, number, first_index, end_index, pending, entries)
             SELECT stream_no, $2, $3, $4, $5, $6 FROM streams WHERE stream_no = $1 AND checkpoint < $2{}
             ON CONFLICT (stream_no, number) DO NOTHING",
            self.dialect().for_share()
        );
        let inserted = sqlx::query(&text)
            .bind(stream.0)
            .bind(to_integer(append.number))
            .bind(to_integer(append.first))
            .bind(to_integer(append.end))
            .bind(append.pending as i64)
            .bind(JournalEntry::encode(append.entries).to_vec())
            .execute(self.write()?)
            .await?;
        Ok(inserted.rows_affected() > 0)
    }

    /// Stores a checkpoint and removes entries that are not needed any more; returns false if another process
    /// has stored one since the previous one.
    pub async fn store_stream_checkpoint(
        &self,
        stream: StreamKey,
        checkpoint: &StreamCheckpoint<'_>,
    ) -> Result<bool, StoreError> {
        let mut levels = Vec::new();
        checkpoint.levels.iter().for_each(|level| level.write(&mut levels));
        let mut transaction = self.write()?.begin().await?;
        let row = sqlx::query(
            "UPDATE streams SET checkpoint = $2, level_bytes = level_bytes + $3
             WHERE stream_no = $1 AND checkpoint = $4 RETURNING level_bytes",
        )
        .bind(stream.0)
        .bind(to_integer(checkpoint.number))
        .bind(levels.len() as i64)
        .bind(to_integer(checkpoint.previous))
        .fetch_optional(&mut *transaction)
        .await?;
        let Some(row) = row else { return Ok(false) };
        sqlx::query("UPDATE stream_states SET state = $2 WHERE stream_no = $1")
            .bind(stream.0)
            .bind(checkpoint.state.to_vec())
            .execute(&mut *transaction)
            .await?;
        if let (Some(first), Some(last)) = (checkpoint.levels.first(), checkpoint.levels.last()) {
            sqlx::query(
                "INSERT INTO stream_levels (stream_no, number, first_ns, last_ns, levels) VALUES ($1, $2, $3, $4, $5)",
            )
            .bind(stream.0)
            .bind(to_integer(checkpoint.number))
            .bind(first.time_ns)
            .bind(last.time_ns)
            .bind(levels)
            .execute(&mut *transaction)
            .await?;
        }
        if get::<i64>(&row, "level_bytes")? > MAX_LEVEL_BYTES {
            let removed = sqlx::query(
                "DELETE FROM stream_levels WHERE stream_no = $1 AND number IN
                    (SELECT number FROM stream_levels WHERE stream_no = $1 ORDER BY number LIMIT $2)
                 RETURNING CAST(LENGTH(levels) AS BIGINT) AS bytes",
            )
            .bind(stream.0)
            .bind(LEVEL_BLOCKS)
            .fetch_all(&mut *transaction)
            .await?;
            let mut bytes = 0;
            for row in &removed {
                bytes += get::<i64>(row, "bytes")?;
            }
            sqlx::query("UPDATE streams SET level_bytes = level_bytes - $2 WHERE stream_no = $1")
                .bind(stream.0)
                .bind(bytes)
                .execute(&mut *transaction)
                .await?;
        }
        // The last entries stay, because their number tells how far the stream has come.
        sqlx::query("DELETE FROM stream_entries WHERE stream_no = $1 AND number < $2 AND end_index <= $3")
            .bind(stream.0)
            .bind(to_integer(checkpoint.number))
            .bind(to_integer(checkpoint.needed_from))
            .execute(&mut *transaction)
            .await?;
        transaction.commit().await?;
        Ok(true)
    }

    /// The bytes of these frames; `None` if some are missing.
    pub async fn stream_frames(
        &self,
        stream: StreamKey,
        first: u64,
        frames: u64,
        frame_bytes: usize,
    ) -> Result<Option<Bytes>, StoreError> {
        let end = first + frames;
        let mut rows = sqlx::query(
            "SELECT number, entries FROM stream_entries
             WHERE stream_no = $1 AND end_index > $2 AND first_index < $3 ORDER BY number",
        )
        .bind(stream.0)
        .bind(to_integer(first))
        .bind(to_integer(end))
        .fetch(self.read());
        let (mut found, mut next) = (BytesMut::new(), first);
        while let Some(row) = rows.try_next().await? {
            for entry in decoded(get_count(&row, "number")?, &get::<Vec<u8>>(&row, "entries")?)? {
                next = entry.copy_frames(next, end, frame_bytes, &mut found);
            }
        }
        Ok((next == end).then(|| found.freeze()))
    }

    /// The stored levels of the seconds that start from one time to another, in order.
    pub async fn stream_levels(
        &self,
        stream: StreamKey,
        channels: usize,
        from_ns: i64,
        to_ns: i64,
    ) -> Result<Vec<TimedLevel>, StoreError> {
        let rows = sqlx::query(
            "SELECT levels FROM stream_levels WHERE stream_no = $1 AND last_ns >= $2 AND first_ns <= $3 ORDER BY number",
        )
        .bind(stream.0)
        .bind(from_ns)
        .bind(to_ns)
        .fetch_all(self.read())
        .await?;
        let mut levels = Vec::new();
        for row in &rows {
            let block: Vec<u8> = get(row, "levels")?;
            let wanted = |level: &TimedLevel| (from_ns..=to_ns).contains(&level.time_ns);
            levels.extend(TimedLevel::decode(&block, channels).filter(wanted));
        }
        Ok(levels)
    }

    /// Bytes of the stored entries of a stream.
    pub async fn stream_bytes(&self, stream: StreamKey) -> Result<u64, StoreError> {
        let row = sqlx::query(
            "SELECT CAST(COALESCE(SUM(LENGTH(entries)), 0) AS BIGINT) AS bytes FROM stream_entries WHERE stream_no = $1",
        )
        .bind(stream.0)
        .fetch_one(self.read())
        .await?;
        get_count(&row, "bytes")
    }

    /// Acquires or renews the right of a process to store the records of a stream; returns false if another
    /// one has it. A process that `takes` it gets it in any case.
    pub async fn begin_cutting(
        &self,
        stream: StreamKey,
        cutter: i64,
        takes: bool,
        now: Timestamp,
    ) -> Result<bool, StoreError> {
        let now = self.now(now).await?;
        let begun = sqlx::query(
            "UPDATE streams SET cutter = $2, cutting_until_ns = $3
             WHERE stream_no = $1 AND (cutter = $2 OR cutting_until_ns < $4 OR $5 = 1)",
        )
        .bind(stream.0)
        .bind(cutter)
        .bind(to_ns(lease_end(now, LEASE))?)
        .bind(to_ns(now)?)
        .bind(i64::from(takes))
        .execute(self.write()?)
        .await?;
        Ok(begun.rows_affected() > 0)
    }

    /// Releases the right of a process to store the records of a stream, or of all of them.
    pub async fn end_cutting(&self, cutter: i64, stream: Option<StreamKey>) -> Result<(), StoreError> {
        sqlx::query(
            "UPDATE streams SET cutting_until_ns = 0
             WHERE cutter = $1 AND cutting_until_ns > 0 AND (stream_no = $2 OR $2 < 0)",
        )
        .bind(cutter)
        .bind(stream.map_or(-1, |stream| stream.0))
        .execute(self.write()?)
        .await?;
        Ok(())
    }

    /// Up to `limit` streams with pending records that no process stores.
    pub async fn uncut_streams(
        &self,
        now: Timestamp,
        limit: u32,
    ) -> Result<Vec<(AssetId, String)>, StoreError> {
        let now = self.now(now).await?;
        let rows = sqlx::query(
            "SELECT asset_id, name FROM streams s WHERE cutting_until_ns < $1 AND COALESCE(
                (SELECT pending FROM stream_entries e WHERE e.stream_no = s.stream_no ORDER BY number DESC LIMIT 1), 0) > 0
             LIMIT $2",
        )
        .bind(to_ns(now)?)
        .bind(i64::from(limit))
        .fetch_all(self.read())
        .await?;
        rows.iter().map(|row| Ok((asset_id(get(row, "asset_id")?)?, get(row, "name")?))).collect()
    }
}

fn to_integer(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

fn decoded(number: u64, bytes: &[u8]) -> Result<Vec<JournalEntry>, StoreError> {
    JournalEntry::decode(bytes).ok_or_else(|| StoreError::Unexpected {
        what: "stream_entries.entries",
        value: format!("damaged in row {number}"),
        expected: "whole entries with their checksums",
    })
}
