//! The mark of a store among its objects: which store they are of, and how far its database had come.

use bytes::Bytes;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::{Objects, StoreError};

/// Where the mark is.
const PATH: &str = "store.json";

/// What is written to learn the time.
const CLOCK: &str = "clock";

/// Which store this is, and how far it has come.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoreMark {
    /// The store's name, given by chance when it was made.
    pub store: String,
    /// Grows as long as the store is worked on.
    pub generation: i64,
}

impl Objects {
    /// The mark of the store that the objects are of; none where there is none yet.
    pub fn mark(&self) -> Result<Option<StoreMark>, StoreError> {
        let Some(bytes) = self.file(PATH)? else {
            return Ok(None);
        };
        let mark = serde_json::from_slice(&bytes).map_err(|source| StoreError::Damaged {
            what: "mark",
            of: PATH.to_owned(),
            source,
        })?;
        Ok(Some(mark))
    }

    /// Marks the objects.
    pub fn set_mark(&self, mark: &StoreMark) -> Result<(), StoreError> {
        self.put_file(PATH, json(mark)?)
    }

    /// Marks the objects where they are not marked yet; returns the mark that they have then.
    pub fn mark_first(&self, mark: &StoreMark) -> Result<StoreMark, StoreError> {
        self.create_file(PATH, json(mark)?)?;
        Ok(self.mark()?.unwrap_or_else(|| mark.clone()))
    }

    /// Whether there is no object.
    pub fn is_empty(&self) -> Result<bool, StoreError> {
        for shard in 0..=u8::MAX {
            if !self.list(shard)?.is_empty() {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// The time by the clock that objects are dated by, which need not be this machine's.
    pub fn time(&self) -> Result<Timestamp, StoreError> {
        self.put_file(CLOCK, Bytes::new())?;
        let written_at = self.file_written_at(CLOCK)?;
        written_at.ok_or_else(|| StoreError::ObjectMissing(CLOCK.to_owned()))
    }
}

fn json(mark: &StoreMark) -> Result<Bytes, StoreError> {
    let json = serde_json::to_vec(mark).map_err(|source| StoreError::Damaged {
        what: "mark",
        of: PATH.to_owned(),
        source,
    })?;
    Ok(json.into())
}
