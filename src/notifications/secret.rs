//! Secrets from the environment or from files; files are read for each use.

use std::fs;
use std::path::PathBuf;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::error::NotificationError;

/// Prefix of a webhook's secret, by Standard Webhooks.
const PREFIX: &str = "whsec_";

/// Length of a webhook's key in bytes.
const KEY_BYTES: std::ops::RangeInclusive<usize> = 24..=64;

/// A secret, or the file that contains it.
#[derive(Clone)]
pub(super) struct Secret {
    /// Name of the setting, for error messages.
    field: String,
    source: Source,
}

#[derive(Clone)]
enum Source {
    Text(String),
    File(PathBuf),
}

impl Secret {
    /// Returns the secret of the environment, or else that of a file; `None` without either.
    pub(super) fn new(field: String, from_env: Option<String>, file: Option<PathBuf>) -> Option<Self> {
        let source = from_env.map(Source::Text).or(file.map(Source::File))?;
        Some(Self { field, source })
    }

    /// Returns the secret without a trailing line break.
    pub(super) fn text(&self) -> Result<String, NotificationError> {
        match &self.source {
            Source::Text(text) => Ok(text.clone()),
            Source::File(path) => {
                let text = fs::read_to_string(path).map_err(|source| NotificationError::File {
                    field: self.field.clone(),
                    path: path.clone(),
                    source,
                })?;
                Ok(text.trim_end_matches(['\r', '\n']).to_owned())
            }
        }
    }

    /// Decodes the key of a webhook's signature.
    pub(super) fn key(&self) -> Result<Vec<u8>, NotificationError> {
        let text = self.text()?;
        let key = text.strip_prefix(PREFIX).and_then(|text| STANDARD.decode(text).ok());
        key.filter(|key| KEY_BYTES.contains(&key.len())).ok_or_else(|| {
            // The value is not repeated: it is a secret.
            let expected =
                "whsec_ and 24 to 64 bytes in base64, as from `echo whsec_$(openssl rand -base64 32)`";
            NotificationError::setting(&self.field, "invalid", expected)
        })
    }
}
