//! Resumable uploads that any process goes on with: how far each is in a row, what has come of it in objects.
//!
//! A piece is an object before the row says that it is there. Who comes second with the bytes of one place,
//! or after the upload has gone, finds the row changed, and nothing of his is counted.

use jiff::{SignedDuration, Timestamp};
use sqlx::any::AnyRow;

use super::rows::{asset_id, from_ns, get, get_count, get_time, to_ns};
use super::{Store, StoreError};
use crate::asset::AssetId;

/// How long a process that reads an upload counts as alive after it last said so.
const READER_ALIVE: SignedDuration = SignedDuration::from_secs(20);

/// Characters of an identifier that are the same for all uploads of one client.
const CLIENT_MARK: usize = 8;

/// What an upload is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UploadProgress {
    /// Bytes are missing, or nobody reads it yet.
    Receiving,
    /// All bytes are there and are being read.
    Reading,
    /// Its records are stored or handed over.
    Finished,
    /// It could not be read.
    Failed,
}

impl UploadProgress {
    fn name(self) -> &'static str {
        match self {
            Self::Receiving => "receiving",
            Self::Reading => "reading",
            Self::Finished => "finished",
            Self::Failed => "failed",
        }
    }
}

/// An upload that begins.
#[derive(Debug, Clone)]
pub struct NewUpload {
    /// Identifier; its first eight characters say whose it is.
    pub id: String,
    /// The asset whose records it will hold.
    pub asset: AssetId,
    /// Its length in bytes.
    pub length: u64,
    /// When it goes if nothing comes.
    pub expires_at: Timestamp,
}

/// An upload as it is stored.
#[derive(Debug, Clone)]
pub struct StoredUpload {
    /// Identifier.
    pub id: String,
    /// The asset whose records it holds.
    pub asset: AssetId,
    /// Its length in bytes.
    pub length: u64,
    /// Bytes that are there.
    pub received: u64,
    /// What it is doing.
    pub progress: UploadProgress,
    /// When it goes if nothing more comes.
    pub expires_at: Timestamp,
    /// Until when the process that reads it counts as alive.
    pub reader_until: Option<Timestamp>,
    /// What became of its records, as JSON.
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

impl Store {
    /// Begins an upload; false where `most` are under way, or `most_of_client` whose identifiers begin with
    /// the same `CLIENT_MARK` characters.
    pub async fn begin_resumable(
        &self,
        upload: &NewUpload,
        most: u32,
        most_of_client: u32,
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
        .bind(i64::from(most))
        .bind(upload.id.get(..CLIENT_MARK).unwrap_or(&upload.id))
        .bind(i64::from(most_of_client))
        .execute(self.write())
        .await?;
        Ok(begun.rows_affected() > 0)
    }

    /// An upload that has not expired.
    pub async fn resumable(&self, id: &str, now: Timestamp) -> Result<Option<StoredUpload>, StoreError> {
        let now = self.now(now).await?;
        let row = sqlx::query("SELECT * FROM resumable_uploads WHERE id = $1 AND expires_at_ns >= $2")
            .bind(id)
            .bind(to_ns(now)?)
            .fetch_optional(self.read())
            .await?;
        row.as_ref().map(upload_of).transpose()
    }

    /// Adds a piece, whose object is there, behind the first `at` bytes; false where the upload is not at
    /// that byte any more.
    pub async fn add_piece(
        &self,
        id: &str,
        at: u64,
        piece: &UploadPiece,
        expires_at: Timestamp,
    ) -> Result<bool, StoreError> {
        let at = i64::try_from(at).unwrap_or(i64::MAX);
        let bytes = i64::try_from(piece.bytes).unwrap_or(i64::MAX);
        let mut transaction = self.write().begin().await?;
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

    /// The pieces of an upload in their order.
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

    /// For the start of a process that is alone on its store: nobody reads uploads any more, and those that
    /// are whole are kept until `expires_at` at least, as nobody could read them while no process ran.
    pub async fn resume_resumable(&self, expires_at: Timestamp) -> Result<(), StoreError> {
        sqlx::query(
            "UPDATE resumable_uploads SET reader_until_ns = NULL, expires_at_ns = $1
             WHERE received = length AND progress IN ('receiving', 'reading') AND expires_at_ns <= $1",
        )
        .bind(to_ns(expires_at)?)
        .execute(self.write())
        .await?;
        Ok(())
    }

    /// Uploads that are whole and that nobody reads.
    pub async fn unread_uploads(&self, now: Timestamp, limit: u32) -> Result<Vec<String>, StoreError> {
        let now = self.now(now).await?;
        let text = format!("SELECT id FROM resumable_uploads WHERE {UNREAD} ORDER BY expires_at_ns LIMIT $2");
        let rows = sqlx::query(&text).bind(to_ns(now)?).bind(i64::from(limit)).fetch_all(self.read()).await?;
        rows.iter().map(|row| get(row, "id")).collect()
    }

    /// The right to read an upload that is whole; false where another process has it, or it is read.
    pub async fn begin_reading(&self, id: &str, now: Timestamp) -> Result<bool, StoreError> {
        let now = self.now(now).await?;
        let text = format!(
            "UPDATE resumable_uploads SET progress = 'reading', reader_until_ns = $3 WHERE id = $2 AND {UNREAD}"
        );
        let begun = sqlx::query(&text)
            .bind(to_ns(now)?)
            .bind(id)
            .bind(alive_until(now)?)
            .execute(self.write())
            .await?;
        Ok(begun.rows_affected() > 0)
    }

    /// Says that an upload is still being read.
    pub async fn go_on_reading(&self, id: &str, now: Timestamp) -> Result<(), StoreError> {
        let now = self.now(now).await?;
        sqlx::query(
            "UPDATE resumable_uploads SET reader_until_ns = $2 WHERE id = $1 AND progress = 'reading'",
        )
        .bind(id)
        .bind(alive_until(now)?)
        .execute(self.write())
        .await?;
        Ok(())
    }

    /// Keeps what became of an upload, which is kept until `expires_at` for those who ask.
    pub async fn finish_reading(
        &self,
        id: &str,
        result: Result<&str, &str>,
        expires_at: Timestamp,
    ) -> Result<(), StoreError> {
        let (progress, result, error) = match result {
            Ok(result) => (UploadProgress::Finished, result, ""),
            Err(error) => (UploadProgress::Failed, "", error),
        };
        let mut transaction = self.write().begin().await?;
        sqlx::query(
            "UPDATE resumable_uploads SET progress = $2, result = NULLIF($3, ''), error = NULLIF($4, ''), expires_at_ns = $5, reader_until_ns = NULL
             WHERE id = $1 AND progress = 'reading'",
        )
        .bind(id)
        .bind(progress.name())
        .bind(result)
        .bind(error)
        .bind(to_ns(expires_at)?)
        .execute(&mut *transaction)
        .await?;
        sqlx::query("DELETE FROM upload_pieces WHERE upload_id = $1")
            .bind(id)
            .execute(&mut *transaction)
            .await?;
        Ok(transaction.commit().await?)
    }

    /// Forgets an upload; false where it is being read, unless the caller is the reader. Its objects are the
    /// caller's to remove.
    pub async fn give_up_resumable(
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
        .execute(self.write())
        .await?;
        Ok(gone.rows_affected() > 0)
    }

    /// Forgets up to `limit` uploads that nobody went on with, and returns which. Their objects are the
    /// caller's to remove.
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
            // Somebody may have gone on with it meanwhile.
            let deleted = sqlx::query(
                "DELETE FROM resumable_uploads WHERE id = $1 AND expires_at_ns < $2
                 AND (progress <> 'reading' OR reader_until_ns IS NULL OR reader_until_ns < $2)",
            )
            .bind(id.as_str())
            .bind(to_ns(now)?)
            .execute(self.write())
            .await?;
            if deleted.rows_affected() > 0 {
                gone.push(id);
            }
        }
        Ok(gone)
    }

    /// Of some uploads those that are not there any more.
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

/// An upload of which all bytes are there, and whose reader, where there was one, is gone by the time `$1`.
const UNREAD: &str = "received = length AND (progress = 'receiving' OR (progress = 'reading' AND COALESCE(reader_until_ns, 0) < $1))";

fn alive_until(now: Timestamp) -> Result<i64, StoreError> {
    to_ns(now.saturating_add(READER_ALIVE).unwrap_or(Timestamp::MAX))
}

fn upload_of(row: &AnyRow) -> Result<StoredUpload, StoreError> {
    let progress: String = get(row, "progress")?;
    let all = [
        UploadProgress::Receiving,
        UploadProgress::Reading,
        UploadProgress::Finished,
        UploadProgress::Failed,
    ];
    Ok(StoredUpload {
        id: get(row, "id")?,
        asset: asset_id(get(row, "asset_id")?)?,
        length: get_count(row, "length")?,
        received: get_count(row, "received")?,
        progress: all.into_iter().find(|one| one.name() == progress).ok_or(StoreError::Unexpected {
            what: "progress",
            value: progress,
            expected: "receiving, reading, finished or failed",
        })?,
        expires_at: get_time(row, "expires_at_ns")?,
        reader_until: get::<Option<i64>>(row, "reader_until_ns")?.map(from_ns),
        result: get(row, "result")?,
        error: get(row, "error")?,
    })
}
