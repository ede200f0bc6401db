//! Uploads with an idempotency key of the client, which identifies repeated uploads.

use jiff::{SignedDuration, Timestamp};

use crate::asset::AssetId;
use crate::store::database::rows::{get, get_time, to_ns};
use crate::store::{Store, StoreError};

/// How long a key is remembered.
const REMEMBERED: SignedDuration = SignedDuration::from_hours(7 * 24);

/// An upload with a key.
#[derive(Debug, Clone, PartialEq)]
pub struct KeyedUpload {
    /// Hash of the whole request.
    pub request_sha256: String,
    /// When it was first received.
    pub received_at: Timestamp,
    /// The response, once it is complete.
    pub response: Option<String>,
}

impl Store {
    /// Returns the upload with a key, after registering this one if there was none.
    pub async fn begin_upload(
        &self,
        asset: &AssetId,
        key: &str,
        request_sha256: &str,
        now: Timestamp,
    ) -> Result<KeyedUpload, StoreError> {
        sqlx::query("DELETE FROM keyed_uploads WHERE received_at_ns < $1")
            .bind(to_ns(now - REMEMBERED)?)
            .execute(self.write()?)
            .await?;
        let begun = sqlx::query(
            "INSERT INTO keyed_uploads (asset_id, upload_key, request_sha256, received_at_ns) VALUES ($1, $2, $3, $4)
             ON CONFLICT (asset_id, upload_key) DO NOTHING",
        )
        .bind(asset.as_str())
        .bind(key)
        .bind(request_sha256)
        .bind(to_ns(now)?)
        .execute(self.write()?)
        .await?;
        if begun.rows_affected() > 0 {
            return Ok(KeyedUpload {
                request_sha256: request_sha256.to_owned(),
                received_at: now,
                response: None,
            });
        }
        let row = sqlx::query("SELECT * FROM keyed_uploads WHERE asset_id = $1 AND upload_key = $2")
            .bind(asset.as_str())
            .bind(key)
            .fetch_optional(self.read())
            .await?;
        // Deleted in the meantime by another process, or with its asset.
        let row = row.ok_or(StoreError::Outdated("the upload's key"))?;
        Ok(KeyedUpload {
            request_sha256: get(&row, "request_sha256")?,
            received_at: get_time(&row, "received_at_ns")?,
            response: get(&row, "answer")?,
        })
    }

    /// Stores the response to an upload. If a response is stored already, it is kept and returned.
    pub async fn finish_upload(
        &self,
        asset: &AssetId,
        key: &str,
        response: &str,
    ) -> Result<Option<String>, StoreError> {
        let kept = sqlx::query(
            "UPDATE keyed_uploads SET answer = $3 WHERE asset_id = $1 AND upload_key = $2 AND answer IS NULL",
        )
        .bind(asset.as_str())
        .bind(key)
        .bind(response)
        .execute(self.write()?)
        .await?;
        if kept.rows_affected() > 0 {
            return Ok(None);
        }
        let row = sqlx::query("SELECT answer FROM keyed_uploads WHERE asset_id = $1 AND upload_key = $2")
            .bind(asset.as_str())
            .bind(key)
            .fetch_optional(self.read())
            .await?;
        // No row: deleted in the meantime by another process, or with its asset.
        let first: Option<Option<String>> = row.map(|row| get(&row, "answer")).transpose()?;
        Ok(first.flatten())
    }

    /// Forgets the response to an upload with a key, so that the upload can be processed again.
    pub async fn forget_response(&self, asset: &AssetId, key: &str) -> Result<(), StoreError> {
        sqlx::query("UPDATE keyed_uploads SET answer = NULL WHERE asset_id = $1 AND upload_key = $2")
            .bind(asset.as_str())
            .bind(key)
            .execute(self.write()?)
            .await?;
        Ok(())
    }
}
