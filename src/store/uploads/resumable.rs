//! Resumable uploads that any process can continue: their progress in rows, their bytes in objects.
//!
//! A piece is stored as an object before the row counts it. A second sender of the same range, or one after
//! the upload is gone, finds the row changed, and its piece is not counted.

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;

use crate::asset::{AssetId, json_name};
use crate::store::database::rows::{asset_id, get, get_count, get_named, get_time, lease_end, to_ns};
use crate::store::{Store, StoreError};

/// Length of the lease of a process that reads an upload, from its last renewal.
const LEASE: SignedDuration = SignedDuration::from_secs(20);

/// Length of the prefix of an identifier that is the same for all uploads of one client.
const CLIENT_MARK: usize = 8;

/// The state of an upload.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum UploadState {
    /// Bytes are missing, or no process reads it yet.
    Receiving,
    /// All bytes are stored and being read.
    Reading,
    /// Its records are stored or queued.
    Finished,
    /// It could not be read.
    Failed,
}

/// A new upload.
#[derive(Debug, Clone)]
pub struct NewUpload {
    /// Identifier; its first eight characters identify the client.
    pub id: String,
    /// The asset that receives its records.
    pub asset: AssetId,
    /// Its length in bytes.
    pub length: u64,
    /// When it expires if no piece arrives.
    pub expires_at: Timestamp,
}

/// A stored upload.
#[derive(Debug, Clone)]
pub struct StoredUpload {
    /// Identifier.
    pub id: String,
    /// The asset that receives its records.
    pub asset: AssetId,
    /// Its length in bytes.
    pub length: u64,
    /// Number of bytes received.
    pub received: u64,
    /// Its progress.
    pub state: UploadState,
    /// When it expires if no further piece arrives.
    pub expires_at: Timestamp,
    /// The summary of its records as JSON.
    pub result: Option<String>,
    /// Why it failed.
    pub error: Option<String>,
}

/// A piece of an upload.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UploadPiece {
    /// Its length in bytes.
    pub bytes: u64,
    /// Name of its object.
    pub object: String,
}

/// The lease of the process that reads an upload, until another one takes over.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReadLease {
    upload: String,
    number: i64,
}

impl Store {
    /// Starts an upload; returns false if `max` uploads are in progress, or `max_of_client` of the same
    /// client, whose identifiers start with the same `CLIENT_MARK` characters.
    pub async fn begin_resumable(
        &self,
        upload: &NewUpload,
        max: u32,
        max_of_client: u32,
    ) -> Result<bool, StoreError> {
        let begun = sqlx::query(
            "INSERT INTO resumable_uploads (id, asset_id, length, received, progress, expires_at_ns)
             SELECT $1, $2, $3, 0, 'receiving', $4
             WHERE (SELECT COUNT(*) FROM resumable_uploads WHERE progress IN ('receiving', 'reading')) < $5
             AND (SELECT COUNT(*) FROM resumable_uploads WHERE progress IN ('receiving', 'reading') AND SUBSTR(id, 1, 8) = $6) < $7",
        )
        .bind(upload.id.as_str())
        .bind(upload.asset.as_str())
        .bind(i64::try_from(upload.length).unwrap_or(i64::MAX))
        .bind(to_ns(upload.expires_at)?)
        .bind(i64::from(max))
        .bind(upload.id.get(..CLIENT_MARK).unwrap_or(&upload.id))
        .bind(i64::from(max_of_client))
        .execute(self.write()?)
        .await?;
        Ok(begun.rows_affected() > 0)
    }

    /// Reads an upload that has not expired.
    pub async fn resumable(&self, id: &str, now: Timestamp) -> Result<Option<StoredUpload>, StoreError> {
        let now = self.now(now).await?;
        let row = sqlx::query("SELECT * FROM resumable_uploads WHERE id = $1 AND expires_at_ns >= $2")
            .bind(id)
            .bind(to_ns(now)?)
            .fetch_optional(self.read())
            .await?;
        row.as_ref().map(upload_of).transpose()
    }

    /// Adds a piece, whose object is stored, after the first `at` bytes; returns false if the upload is no
    /// longer at that offset.
    pub async fn add_piece(
        &self,
        id: &str,
        at: u64,
        piece: &UploadPiece,
        expires_at: Timestamp,
    ) -> Result<bool, StoreError> {
        let at = i64::try_from(at).unwrap_or(i64::MAX);
        let bytes = i64::try_from(piece.bytes).unwrap_or(i64::MAX);
        let mut transaction = self.write()?.begin().await?;
        let advanced = sqlx::query(
            "UPDATE resumable_uploads SET received = received + $3, expires_at_ns = $4
             WHERE id = $1 AND received = $2 AND progress = 'receiving' AND received + $3 <= length",
        )
        .bind(id)
        .bind(at)
        .bind(bytes)
        .bind(to_ns(expires_at)?)
        .execute(&mut *transaction)
        .await?;
        if advanced.rows_affected() == 0 {
            return Ok(false);
        }
        sqlx::query("INSERT INTO upload_pieces (upload_id, at_byte, bytes, object) VALUES ($1, $2, $3, $4)")
            .bind(id)
            .bind(at)
            .bind(bytes)
            .bind(piece.object.as_str())
            .execute(&mut *transaction)
            .await?;
        transaction.commit().await?;
        Ok(true)
    }

    /// The pieces of an upload in order.
    pub async fn upload_pieces(&self, id: &str) -> Result<Vec<UploadPiece>, StoreError> {
        let rows =
            sqlx::query("SELECT bytes, object FROM upload_pieces WHERE upload_id = $1 ORDER BY at_byte")
                .bind(id)
                .fetch_all(self.read())
                .await?;
        let pieces = rows
            .iter()
            .map(|row| Ok(UploadPiece { bytes: get_count(row, "bytes")?, object: get(row, "object")? }));
        pieces.collect()
    }

    /// Releases all readers at the start of a process that is alone on its store. Complete uploads are kept
    /// until `expires_at` at least, because they could not be read while no process ran.
    pub async fn resume_resumable(&self, expires_at: Timestamp) -> Result<(), StoreError> {
        sqlx::query(
            "UPDATE resumable_uploads SET reader_until_ns = NULL, expires_at_ns = $1
             WHERE received = length AND progress IN ('receiving', 'reading') AND expires_at_ns <= $1",
        )
        .bind(to_ns(expires_at)?)
        .execute(self.write()?)
        .await?;
        Ok(())
    }

    /// Complete uploads without a reader.
    pub async fn unread_uploads(&self, now: Timestamp, limit: u32) -> Result<Vec<String>, StoreError> {
        let now = self.now(now).await?;
        let text = format!("SELECT id FROM resumable_uploads WHERE {UNREAD} ORDER BY expires_at_ns LIMIT $2");
        let rows = sqlx::query(&text).bind(to_ns(now)?).bind(i64::from(limit)).fetch_all(self.read()).await?;
        rows.iter().map(|row| get(row, "id")).collect()
    }

    /// Acquires the right to read a complete upload; returns `None` if another process has it, or if it has
    /// been read.
    pub async fn acquire_read_lease(
        &self,
        id: &str,
        now: Timestamp,
    ) -> Result<Option<ReadLease>, StoreError> {
        let now = self.now(now).await?;
        let text = format!(
            "UPDATE resumable_uploads SET progress = 'reading', reader_until_ns = $3, readings = readings + 1
             WHERE id = $2 AND {UNREAD} RETURNING readings"
        );
        let begun = sqlx::query(&text)
            .bind(to_ns(now)?)
            .bind(id)
            .bind(alive_until(now)?)
            .fetch_optional(self.write()?)
            .await?;
        begun.map(|row| Ok(ReadLease { upload: id.to_owned(), number: get(&row, "readings")? })).transpose()
    }

    /// Renews the right to read an upload; returns false if another process has taken over.
    pub async fn renew_read_lease(&self, lease: &ReadLease, now: Timestamp) -> Result<bool, StoreError> {
        let now = self.now(now).await?;
        let renewed = sqlx::query(
            "UPDATE resumable_uploads SET reader_until_ns = $3 WHERE id = $1 AND readings = $2 AND progress = 'reading'",
        )
        .bind(lease.upload.as_str())
        .bind(lease.number)
        .bind(alive_until(now)?)
        .execute(self.write()?)
        .await?;
        Ok(renewed.rows_affected() > 0)
    }

    /// Stores the result of an upload, which can be read until `expires_at`; returns false if another process
    /// has taken over. Otherwise the caller removes its objects.
    pub async fn finish_reading(
        &self,
        lease: &ReadLease,
        result: Result<&str, &str>,
        expires_at: Timestamp,
    ) -> Result<bool, StoreError> {
        let (state, result, error) = match result {
            Ok(result) => (UploadState::Finished, result, ""),
            Err(error) => (UploadState::Failed, "", error),
        };
        let mut transaction = self.write()?.begin().await?;
        let finished = sqlx::query(
            "UPDATE resumable_uploads SET progress = $2, result = NULLIF($3, ''), error = NULLIF($4, ''), expires_at_ns = $5, reader_until_ns = NULL
             WHERE id = $1 AND readings = $6 AND progress = 'reading'",
        )
        .bind(lease.upload.as_str())
        .bind(json_name(&state))
        .bind(result)
        .bind(error)
        .bind(to_ns(expires_at)?)
        .bind(lease.number)
        .execute(&mut *transaction)
        .await?;
        if finished.rows_affected() == 0 {
            return Ok(false);
        }
        sqlx::query("DELETE FROM upload_pieces WHERE upload_id = $1")
            .bind(lease.upload.as_str())
            .execute(&mut *transaction)
            .await?;
        transaction.commit().await?;
        Ok(true)
    }

    /// Deletes an upload; returns false if it is being read, unless the caller is the reader. The caller
    /// removes its objects.
    pub async fn cancel_resumable(
        &self,
        id: &str,
        is_reader: bool,
        now: Timestamp,
    ) -> Result<bool, StoreError> {
        let now = self.now(now).await?;
        let gone = sqlx::query(
            "DELETE FROM resumable_uploads WHERE id = $1 AND (progress <> 'reading' OR reader_until_ns IS NULL OR reader_until_ns < $2)",
        )
        .bind(id)
        .bind(if is_reader { i64::MAX } else { to_ns(now)? })
        .execute(self.write()?)
        .await?;
        Ok(gone.rows_affected() > 0)
    }

    /// Deletes up to `limit` expired uploads and returns their identifiers. The caller removes their objects.
    pub async fn expire_resumable(&self, now: Timestamp, limit: u32) -> Result<Vec<String>, StoreError> {
        let now = self.now(now).await?;
        let rows = sqlx::query("SELECT id FROM resumable_uploads WHERE expires_at_ns < $1 LIMIT $2")
            .bind(to_ns(now)?)
            .bind(i64::from(limit))
            .fetch_all(self.read())
            .await?;
        let mut gone = Vec::new();
        for row in &rows {
            let id: String = get(row, "id")?;
            // It may have been continued in the meantime.
            let deleted = sqlx::query(
                "DELETE FROM resumable_uploads WHERE id = $1 AND expires_at_ns < $2
                 AND (progress <> 'reading' OR reader_until_ns IS NULL OR reader_until_ns < $2)",
            )
            .bind(id.as_str())
            .bind(to_ns(now)?)
            .execute(self.write()?)
            .await?;
            if deleted.rows_affected() > 0 {
                gone.push(id);
            }
        }
        Ok(gone)
    }

    /// Returns which of these uploads no longer exist.
    pub async fn forgotten_uploads(&self, ids: Vec<String>) -> Result<Vec<String>, StoreError> {
        let mut forgotten = Vec::new();
        for id in ids {
            let found = sqlx::query("SELECT id FROM resumable_uploads WHERE id = $1")
                .bind(id.as_str())
                .fetch_optional(self.read())
                .await?;
            if found.is_none() {
                forgotten.push(id);
            }
        }
        Ok(forgotten)
    }
}

/// Condition for a complete upload that has no reader, or whose reader is no longer alive at the time `$1`.
const UNREAD: &str = "received = length AND (progress = 'receiving' OR (progress = 'reading' AND COALESCE(reader_until_ns, 0) < $1))";

fn alive_until(now: Timestamp) -> Result<i64, StoreError> {
    to_ns(lease_end(now, LEASE))
}

fn upload_of(row: &AnyRow) -> Result<StoredUpload, StoreError> {
    let id: String = get(row, "id")?;
    Ok(StoredUpload {
        state: get_named(row, "progress", &id)?,
        id,
        asset: asset_id(get(row, "asset_id")?)?,
        length: get_count(row, "length")?,
        received: get_count(row, "received")?,
        expires_at: get_time(row, "expires_at_ns")?,
        result: get(row, "result")?,
        error: get(row, "error")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn only_the_latest_reader_of_an_upload_ends_it() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().into()).await.unwrap();
        let start: Timestamp = "2026-01-01T00:00:00Z".parse().unwrap();
        let later = start + LEASE + SignedDuration::from_secs(1);
        let kept_until = start + SignedDuration::from_hours(1);
        let asset = AssetId::new("pump").unwrap();
        let upload = NewUpload { id: "abcdefgh1".to_owned(), asset, length: 3, expires_at: kept_until };
        assert!(store.begin_resumable(&upload, 9, 9).await.unwrap());
        assert_eq!(store.acquire_read_lease(&upload.id, start).await.unwrap(), None, "it is not complete");
        let piece = UploadPiece { bytes: 3, object: "piece".to_owned() };
        assert!(store.add_piece(&upload.id, 0, &piece, kept_until).await.unwrap());

        let first = store.acquire_read_lease(&upload.id, start).await.unwrap().unwrap();
        assert_eq!(store.acquire_read_lease(&upload.id, start).await.unwrap(), None);
        let second = store.acquire_read_lease(&upload.id, later).await.unwrap().unwrap();
        assert!(!store.renew_read_lease(&first, later).await.unwrap());
        assert!(!store.finish_reading(&first, Err("a piece is missing"), kept_until).await.unwrap());
        assert_eq!(store.upload_pieces(&upload.id).await.unwrap(), [piece]);

        assert!(store.renew_read_lease(&second, later).await.unwrap());
        assert!(store.finish_reading(&second, Ok("{}"), kept_until).await.unwrap());
        assert!(!store.renew_read_lease(&second, later).await.unwrap());
        let stored = store.resumable(&upload.id, later).await.unwrap().unwrap();
        assert_eq!((stored.state, stored.error), (UploadState::Finished, None));
        assert_eq!(store.upload_pieces(&upload.id).await.unwrap(), []);
    }
}
