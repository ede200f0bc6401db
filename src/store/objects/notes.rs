//! Notes stored beside the raw objects, from which the database can be rebuilt: a note of the records that
//! were stored together (`NAME.BATCH.json` beside the object NAME), one of each asset (`assets/ID.json`), and
//! notes of removed records (`removed/…`).

use std::collections::HashSet;

use bytes::Bytes;
use jiff::Timestamp;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::{Objects, StoreError, is_name};
use crate::asset::{AssetId, AssetSpec, RawReference, SegmentId};
use crate::estimate::MaintenanceEvent;
use crate::signal::OperatingPoint;

const ASSETS: &str = "assets";
const REMOVED: &str = "removed";

/// The metadata needed to decode a record from its raw bytes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = QueuedRecord)]
pub struct RecordNote {
    /// Identifier of its segment.
    pub id: SegmentId,
    /// The asset it belongs to.
    pub asset_id: AssetId,
    /// The measuring channel.
    pub channel: String,
    /// The time of the first sample.
    pub start_time: Timestamp,
    /// When the service received it.
    pub received_at: Timestamp,
    /// Unit of the samples.
    pub unit: String,
    /// Operating point as given with the record.
    #[serde(default)]
    #[schema(required = true)]
    pub operating_point: OperatingPoint,
    /// Reference wear depth in µm from another source.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_wear_um: Option<f64>,
    /// The raw bytes.
    pub raw: RawReference,
}

/// The data of an asset entered by users.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AssetNote {
    /// The description.
    pub spec: AssetSpec,
    /// When it was created.
    pub created_at: Timestamp,
    /// When the description last changed.
    #[serde(default)]
    pub updated_at: Timestamp,
    /// The maintenance events.
    #[serde(default)]
    pub maintenance: Vec<MaintenanceEvent>,
    /// Records excluded from its histories.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub excluded: Vec<SegmentId>,
}

/// Records removed by users, which a rebuild skips.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RemovalNote {
    /// The time of the removal.
    pub removed_at: Timestamp,
    /// Their segments; a record sent again after the removal is not affected.
    pub segments: Vec<SegmentId>,
}

/// A note whose objects are all gone.
#[derive(Debug)]
pub struct EmptyNote {
    path: String,
    /// Names of its objects.
    names: Vec<String>,
}

impl Objects {
    /// The path and content of the note of records that are stored together; `None` without records.
    pub(super) fn note_of(&self, records: &[RecordNote]) -> Result<Option<(String, Bytes)>, StoreError> {
        let Some(first) = records.first() else {
            return Ok(None);
        };
        // A retry with the same records gives the same note.
        let ids: Vec<&str> = records.iter().map(|record| record.id.0.as_str()).collect();
        let batch = Self::name(ids.join(" ").as_bytes());
        let path = format!("{}.{}.json", self.backend.object_path(&first.raw.sha256), &batch[..16]);
        Ok(Some((path.clone(), json(&path, &records)?)))
    }

    /// Reads the notes of the records beside the objects whose names start with this byte.
    pub fn notes(&self, shard: u8) -> Result<Vec<RecordNote>, StoreError> {
        let mut records = Vec::new();
        for (_, path) in self.note_paths(shard)? {
            records.extend(self.read::<Vec<RecordNote>>(&path)?.unwrap_or_default());
        }
        Ok(records)
    }

    /// Lists the notes that are old enough, and none of whose objects exists, in quarantine or out of it.
    pub fn empty_notes(
        &self,
        shard: u8,
        is_old_enough: impl Fn(Timestamp) -> bool,
    ) -> Result<Vec<EmptyNote>, StoreError> {
        let mut notes = Vec::new();
        for (first, path) in self.note_paths(shard)? {
            if self.written_at(&first)?.is_some() {
                continue;
            }
            let records = self.read::<Vec<RecordNote>>(&path)?.unwrap_or_default();
            let mut names: Vec<String> = records.into_iter().map(|record| record.raw.sha256).collect();
            names.push(first);
            if !self.has_any(&names)? {
                notes.push(EmptyNote { path, names });
            }
        }
        self.empty_among(notes, is_old_enough)
    }

    /// Removes those of these notes that are still empty and old enough. No objects with notes may be stored
    /// meanwhile.
    pub fn remove_empty_notes(
        &self,
        notes: Vec<EmptyNote>,
        is_old_enough: impl Fn(Timestamp) -> bool,
    ) -> Result<(), StoreError> {
        let empty = self.empty_among(notes, is_old_enough)?;
        empty.iter().try_for_each(|note| self.backend.remove_file(&note.path))
    }

    fn empty_among(
        &self,
        notes: Vec<EmptyNote>,
        is_old_enough: impl Fn(Timestamp) -> bool,
    ) -> Result<Vec<EmptyNote>, StoreError> {
        if notes.is_empty() {
            return Ok(notes);
        }
        // Listed before the objects are looked for again: one that was moved into quarantine a moment ago is
        // in the list, and one that was restored is at its place again.
        let kept: HashSet<String> =
            self.quarantined()?.into_iter().map(|quarantined| quarantined.name).collect();
        let mut empty = Vec::new();
        for note in notes {
            if !note.names.iter().any(|name| kept.contains(name))
                && !self.has_any(&note.names)?
                && self.file_written_at(&note.path)?.is_some_and(&is_old_enough)
            {
                empty.push(note);
            }
        }
        Ok(empty)
    }

    /// Whether one of these objects exists.
    fn has_any(&self, names: &[String]) -> Result<bool, StoreError> {
        for name in names {
            if self.written_at(name)?.is_some() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Writes the note of an asset.
    pub fn put_asset_note(&self, note: &AssetNote) -> Result<(), StoreError> {
        let path = asset_path(&note.spec.id);
        let bytes = json(&path, note)?;
        if self.backend.file(&path)?.is_some_and(|known| known == bytes) {
            return Ok(());
        }
        self.backend.put_file(&path, bytes)
    }

    /// Reads the note of an asset; `None` if there is none.
    pub fn asset_note(&self, id: &AssetId) -> Result<Option<AssetNote>, StoreError> {
        self.read(&asset_path(id))
    }

    /// Reads the notes of all assets.
    pub fn asset_notes(&self) -> Result<Vec<AssetNote>, StoreError> {
        let notes = self.backend.files(ASSETS)?.into_iter().map(|file| self.read(&file.path));
        Ok(notes.collect::<Result<Vec<Option<AssetNote>>, _>>()?.into_iter().flatten().collect())
    }

    /// Copies all notes to other objects; existing notes of assets are replaced if these are newer.
    pub(in crate::store) fn copy_notes(&self, to: &Self, are_newer: bool) -> Result<(), StoreError> {
        let mut paths: Vec<String> = Vec::new();
        for shard in self.shards()? {
            paths.extend(self.note_paths(shard)?.into_iter().map(|(_, path)| path));
        }
        for folder in [ASSETS, REMOVED] {
            paths.extend(self.backend.files(folder)?.into_iter().map(|file| file.path));
        }
        for path in paths {
            let Some(bytes) = self.backend.file(&path)? else { continue };
            if to.backend.file(&path)?.is_none() || (are_newer && path.starts_with(ASSETS)) {
                to.backend.put_file(&path, bytes)?;
            }
        }
        Ok(())
    }

    /// Removes the notes of assets and of removed records that other objects do not have; those of `assets`
    /// are kept.
    pub(in crate::store) fn remove_notes_missing_in(
        &self,
        of: &Self,
        assets: &[String],
    ) -> Result<(), StoreError> {
        let mut kept: HashSet<String> = assets.iter().map(|id| format!("{ASSETS}/{id}.json")).collect();
        for folder in [ASSETS, REMOVED] {
            kept.extend(of.backend.files(folder)?.into_iter().map(|file| file.path));
            for file in self.backend.files(folder)?.into_iter().filter(|file| !kept.contains(&file.path)) {
                self.backend.remove_file(&file.path)?;
            }
        }
        Ok(())
    }

    /// Writes the note of removed records.
    pub fn put_removal(&self, removal: &RemovalNote) -> Result<(), StoreError> {
        let name = Self::name(&json(REMOVED, removal)?);
        let path = format!("{REMOVED}/{}.json", &name[..16]);
        self.backend.put_file(&path, json(&path, removal)?)
    }

    /// Reads the notes of all removed records.
    pub fn removals(&self) -> Result<Vec<RemovalNote>, StoreError> {
        let notes = self.backend.files(REMOVED)?.into_iter().map(|file| self.read(&file.path));
        Ok(notes.collect::<Result<Vec<Option<RemovalNote>>, _>>()?.into_iter().flatten().collect())
    }

    /// Takes segments out of those notes of removed records that are old enough, because they are stored.
    pub fn note_restored(
        &self,
        restored: &HashSet<SegmentId>,
        is_old_enough: impl Fn(Timestamp) -> bool,
    ) -> Result<(), StoreError> {
        for file in self.backend.files(REMOVED)? {
            let Some(note) = self.read::<RemovalNote>(&file.path)? else { continue };
            if !is_old_enough(note.removed_at) {
                continue;
            }
            let (removed_at, mut segments) = (note.removed_at, note.segments);
            let count = segments.len();
            segments.retain(|segment| !restored.contains(segment));
            if segments.len() == count {
                continue;
            }
            // Written before the other is removed: a crash leaves both.
            if !segments.is_empty() {
                self.put_removal(&RemovalNote { removed_at, segments })?;
            }
            self.backend.remove_file(&file.path)?;
        }
        Ok(())
    }

    /// Removes the note of an asset.
    pub fn remove_asset_note(&self, id: &AssetId) -> Result<(), StoreError> {
        self.backend.remove_file(&asset_path(id))
    }

    /// The paths of notes, each with the name of the object beside it.
    fn note_paths(&self, shard: u8) -> Result<Vec<(String, String)>, StoreError> {
        let path = self.backend.object_path(&format!("{shard:02x}"));
        let folder = path.rsplit_once('/').map_or("", |(folder, _)| folder);
        let note = |path: String| {
            let name = path.strip_suffix(".json")?.rsplit('/').next()?.split('.').next()?;
            is_name(name).then(|| (name.to_owned(), path.clone()))
        };
        let files = self.backend.files(folder)?.into_iter();
        Ok(files.filter_map(|file| note(file.path)).collect())
    }

    fn read<T: DeserializeOwned>(&self, path: &str) -> Result<Option<T>, StoreError> {
        let read = |bytes: Bytes| serde_json::from_slice(&bytes).map_err(StoreError::damaged("note", path));
        self.backend.file(path)?.map(read).transpose()
    }
}

fn asset_path(id: &AssetId) -> String {
    format!("{ASSETS}/{id}.json")
}

fn json(path: &str, note: &impl Serialize) -> Result<Bytes, StoreError> {
    let json = serde_json::to_vec(note).map_err(StoreError::damaged("note", path))?;
    Ok(json.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn note_of(name: &str) -> RecordNote {
        RecordNote {
            id: SegmentId(name.to_owned()),
            asset_id: AssetId::new("pump").unwrap(),
            channel: "1".to_owned(),
            start_time: Timestamp::UNIX_EPOCH,
            received_at: Timestamp::UNIX_EPOCH,
            unit: "g".to_owned(),
            operating_point: OperatingPoint::default(),
            reference_wear_um: None,
            raw: RawReference {
                sha256: name.to_owned(),
                bytes: 3,
                media_type: "audio/wav".to_owned(),
                channel_index: 0,
            },
        }
    }

    #[test]
    fn restored_records_are_taken_out_of_the_notes_of_removed_ones() {
        let folder = tempfile::tempdir().unwrap();
        let objects = Objects::open(folder.path()).unwrap();
        let segment = |name: &str| SegmentId(name.to_owned());
        let notes = [vec!["a", "b"], vec!["c"], vec!["d"]].map(|names| RemovalNote {
            removed_at: Timestamp::UNIX_EPOCH,
            segments: names.into_iter().map(segment).collect(),
        });
        notes.iter().for_each(|note| objects.put_removal(note).unwrap());
        let restored = ["b", "c", "e"].into_iter().map(segment).collect();
        objects.note_restored(&restored, |_| false).unwrap();
        assert_eq!(objects.removals().unwrap().len(), notes.len());
        objects.note_restored(&restored, |_| true).unwrap();
        let mut left: Vec<_> = objects.removals().unwrap().into_iter().map(|note| note.segments).collect();
        left.sort_unstable_by(|one, other| one[0].0.cmp(&other[0].0));
        assert_eq!(left, [[segment("a")], [segment("d")]]);
    }

    #[test]
    fn notes_are_kept_while_objects_move_into_quarantine() {
        let folder = tempfile::tempdir().unwrap();
        let objects = Objects::open(folder.path()).unwrap();
        let names: Vec<String> = (0..60).map(|number| format!("00{number:062x}")).collect();
        for name in &names {
            objects.put_all(&[(name.clone(), Bytes::from_static(b"abc"))], &[note_of(name)]).unwrap();
        }
        let remove_empty_notes = |are_old: bool| {
            let empty = objects.empty_notes(0, |_| are_old).unwrap();
            objects.remove_empty_notes(empty, |_| are_old).unwrap();
        };
        std::thread::scope(|scope| {
            let moving = scope.spawn(|| {
                for name in &names {
                    objects.quarantine(name, Timestamp::UNIX_EPOCH).unwrap();
                }
            });
            while !moving.is_finished() {
                remove_empty_notes(true);
            }
        });
        assert_eq!(objects.notes(0).unwrap().len(), names.len());
        objects.remove_quarantined(std::time::Duration::ZERO, Timestamp::now()).unwrap();
        remove_empty_notes(false);
        assert_eq!(objects.notes(0).unwrap().len(), names.len(), "young notes stay");
        remove_empty_notes(true);
        assert_eq!(objects.notes(0).unwrap(), []);
    }
}
