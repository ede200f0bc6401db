//! Secrets out of the environment or out of files, which are read again for each use.

use std::fs;
use std::path::PathBuf;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::error::NotificationError;

/// Begins the secret of a webhook, as Standard Webhooks says.
const PREFIX: &str = "whsec_";

/// How many bytes the secret of a webhook has.
const KEY_BYTES: std::ops::RangeInclusive<usize> = 24..=64;

/// Where a secret is found.
#[derive(Clone)]
pub(super) struct Secret {
    /// The setting, for messages.
    field: String,
    place: Place,
}

#[derive(Clone)]
enum Place {
    Given(String),
    InFile(PathBuf),
}

impl Secret {
    /// The one that the environment gives, else that in a file; none where there is neither.
    pub(super) fn of(field: String, given: Option<String>, file: Option<PathBuf>) -> Option<Self> {
        let place = given.map(Place::Given).or(file.map(Place::InFile))?;
        Some(Self { field, place })
    }

    /// Its text without a line's end.
    pub(super) fn text(&self) -> Result<String, NotificationError> {
        match &self.place {
            Place::Given(text) => Ok(text.clone()),
            Place::InFile(path) => {
                let text = fs::read_to_string(path).map_err(|source| NotificationError::File {
                    field: self.field.clone(),
                    path: path.clone(),
                    source,
                })?;
                Ok(text.trim_end_matches(['\r', '\n']).to_owned())
            }
        }
    }

    /// The key of a webhook's signature.
    pub(super) fn key(&self) -> Result<Vec<u8>, NotificationError> {
        let text = self.text()?;
        let key = text.strip_prefix(PREFIX).and_then(|text| STANDARD.decode(text).ok());
        key.filter(|key| KEY_BYTES.contains(&key.len())).ok_or_else(|| {
            // The text itself is a secret.
            let expected =
                "whsec_ and 24 to 64 bytes in base64, as of `echo whsec_$(openssl rand -base64 32)`";
            NotificationError::setting(&self.field, "something else", expected)
        })
    }
}
