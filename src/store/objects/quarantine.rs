//! Quarantine of unreferenced objects before their removal: `quarantine/DATE.NAME`.

use std::time::Duration;

use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;

use super::{Objects, StoreError, is_name};

const FOLDER: &str = "quarantine";
const DATE: &str = "%Y%m%dT%H%M%SZ";

/// An object in quarantine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Quarantined {
    /// Its name.
    pub name: String,
    /// Its size in bytes.
    pub bytes: u64,
    /// When it was moved into quarantine.
    pub since: Timestamp,
}

impl Quarantined {
    fn path(&self) -> String {
        path(&self.name, self.since)
    }
}

impl Objects {
    /// Moves an object into quarantine; a missing object is not an error.
    pub fn quarantine(&self, name: &str, now: Timestamp) -> Result<(), StoreError> {
        self.backend.move_file(&self.backend.object_path(name), &path(name, now))
    }

    /// Lists the objects in quarantine, the oldest first.
    pub fn quarantined(&self) -> Result<Vec<Quarantined>, StoreError> {
        let files = self.backend.files(FOLDER)?;
        let quarantined = files.into_iter().filter_map(|file| {
            let (date, name) = file.path.strip_prefix(FOLDER)?.strip_prefix('/')?.split_once('.')?;
            let since = DateTime::strptime(DATE, date).ok()?.to_zoned(TimeZone::UTC).ok()?;
            is_name(name).then(|| Quarantined {
                name: name.to_owned(),
                bytes: file.bytes,
                since: since.timestamp(),
            })
        });
        let mut quarantined: Vec<Quarantined> = quarantined.collect();
        quarantined.sort_by(|a, b| (a.since, &a.name).cmp(&(b.since, &b.name)));
        Ok(quarantined)
    }

    /// Moves an object out of quarantine.
    pub fn release(&self, quarantined: &Quarantined) -> Result<(), StoreError> {
        self.backend.move_file(&quarantined.path(), &self.backend.object_path(&quarantined.name))
    }

    /// Removes objects that have been in quarantine for at least `kept_for`; returns the number of objects
    /// and bytes.
    pub fn remove_quarantined(&self, kept_for: Duration, now: Timestamp) -> Result<(u64, u64), StoreError> {
        let (mut count, mut bytes) = (0, 0);
        for quarantined in self.quarantined()? {
            let age = now.duration_since(quarantined.since);
            if Duration::try_from(age).is_ok_and(|age| age >= kept_for) {
                self.backend.remove_file(&quarantined.path())?;
                count += 1;
                bytes += quarantined.bytes;
            }
        }
        Ok((count, bytes))
    }
}

fn path(name: &str, since: Timestamp) -> String {
    format!("{FOLDER}/{}.{name}", since.strftime(DATE))
}
