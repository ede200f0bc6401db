//! Uploads under a key of the client's: what makes a repeat of one the same upload.

use jiff::{SignedDuration, Timestamp};

use super::rows::{get, get_time, to_ns};
use super::{Store, StoreError};
use crate::asset::AssetId;

/// How long a key is remembered.
const REMEMBERED: SignedDuration = SignedDuration::from_hours(7 * 24);

/// What is known of an upload under a key.
#[derive(Debug, Clone, PartialEq)]
pub struct KeyedUpload {
    /// Hash of everything that was uploaded.
    pub request_sha256: String,
    /// When it first came.
    pub received_at: Timestamp,
    /// What was answered, for a recording of many records that is done.
    pub answer: Option<String>,
}

impl Store {
    /// The upload under a key; it is this one where there was none.
    pub async fn begin_upload(&self, asset: &AssetId, key: &str, request_sha256: &str, now: Timestamp) -> Result<KeyedUpload, StoreError> {
        let find = "SELECT * FROM keyed_uploads WHERE asset_id = $1 AND upload_key = $2";
        let mut transaction = self.write().begin().await?;
        sqlx::query("DELETE FROM keyed_uploads WHERE received_at_ns < $1")
            .bind(to_ns(now - REMEMBERED)?)
            .execute(&mut *transaction)
            .await?;
        let known = sqlx::query(find)
            .bind(asset.as_str())
            .bind(key)
            .fetch_optional(&mut *transaction)
            .await?;
        if let Some(row) = known {
            return Ok(KeyedUpload {
                request_sha256: get(&row, "request_sha256")?,
                received_at: get_time(&row, "received_at_ns")?,
                answer: get(&row, "answer")?,
            });
        }
        sqlx::query("INSERT INTO keyed_uploads (asset_id, upload_key, request_sha256, received_at_ns) VALUES ($1, $2, $3, $4)")
            .bind(asset.as_str())
            .bind(key)
            .bind(request_sha256)
            .bind(to_ns(now)?)
            .execute(&mut *transaction)
            .await?;
        transaction.commit().await?;
        Ok(KeyedUpload {
            request_sha256: request_sha256.to_owned(),
            received_at: now,
            answer: None,
        })
    }

    /// Keeps what an upload was answered with.
    pub async fn finish_upload(&self, asset: &AssetId, key: &str, answer: &str) -> Result<(), StoreError> {
        sqlx::query("UPDATE keyed_uploads SET answer = $3 WHERE asset_id = $1 AND upload_key = $2")
            .bind(asset.as_str())
            .bind(key)
            .bind(answer)
            .execute(self.write())
            .await?;
        Ok(())
    }
}
