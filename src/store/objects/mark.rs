//! The mark of a store among its objects: the store to which they belong, and its generation.

use bytes::Bytes;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::{Objects, StoreError};

/// Path of the mark.
const PATH: &str = "store.json";

/// Path of the file that is written to read the clock of the object store.
const CLOCK: &str = "clock";

/// The identity of a store, and its generation.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoreMark {
    /// The random identifier of the store, assigned when it was created.
    pub store: String,
    /// A number that increases while the store is in use.
    pub generation: i64,
}

impl Objects {
    /// Reads the mark of the store to which the objects belong; `None` before it is written.
    pub fn mark(&self) -> Result<Option<StoreMark>, StoreError> {
        let Some(bytes) = self.backend.file(PATH)? else {
            return Ok(None);
        };
        let mark = serde_json::from_slice(&bytes).map_err(StoreError::damaged("mark", PATH))?;
        Ok(Some(mark))
    }

    /// Writes the mark.
    pub fn set_mark(&self, mark: &StoreMark) -> Result<(), StoreError> {
        self.backend.put_file(PATH, json(mark)?)
    }

    /// Writes the mark unless there is one; returns the resulting mark.
    pub fn mark_first(&self, mark: &StoreMark) -> Result<StoreMark, StoreError> {
        self.backend.create_file(PATH, json(mark)?)?;
        Ok(self.mark()?.unwrap_or_else(|| mark.clone()))
    }

    /// Whether there are no objects.
    pub fn is_empty(&self) -> Result<bool, StoreError> {
        for shard in self.shards()? {
            if !self.list(shard)?.is_empty() {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// The time by the clock that dates the objects, which may not be that of this machine.
    pub fn time(&self) -> Result<Timestamp, StoreError> {
        self.backend.put_file(CLOCK, Bytes::new())?;
        let written_at = self.file_written_at(CLOCK)?;
        written_at.ok_or_else(|| StoreError::ObjectMissing(CLOCK.to_owned()))
    }
}

fn json(mark: &StoreMark) -> Result<Bytes, StoreError> {
    let json = serde_json::to_vec(mark).map_err(StoreError::damaged("mark", PATH))?;
    Ok(json.into())
}
