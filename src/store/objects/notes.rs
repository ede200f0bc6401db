//! What goes beside the raw objects, so that everything else can be made again from them: a note of the
//! records that were stored together (`NAME.BATCH.json` beside the object NAME), one of each asset
//! (`assets/ID.json`), and which records were removed (`removed/…`).

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

/// What makes a record of raw bytes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RecordNote {
    /// The segment that it becomes.
    pub id: SegmentId,
    /// The asset it belongs to.
    pub asset_id: AssetId,
    /// The measuring channel.
    pub channel: String,
    /// The time of the first sample.
    pub start_time: Timestamp,
    /// When the service took it.
    pub received_at: Timestamp,
    /// Unit of the samples.
    pub unit: String,
    /// Operating point as given with the record.
    #[serde(default)]
    pub operating_point: OperatingPoint,
    /// Wear depth in µm known from elsewhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_wear_um: Option<f64>,
    /// Where the raw bytes are.
    pub raw: RawReference,
}

/// What people said of an asset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AssetNote {
    /// The description.
    pub spec: AssetSpec,
    /// When it was made.
    pub created_at: Timestamp,
    /// What was done to the machine.
    #[serde(default)]
    pub maintenance: Vec<MaintenanceEvent>,
    /// Records that take no part in its histories.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub excluded: Vec<SegmentId>,
}

/// Records that people removed: not to be made again.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RemovalNote {
    /// When.
    pub removed_at: Timestamp,
    /// Which; the same sent again later is another one.
    pub segments: Vec<SegmentId>,
}

impl Objects {
    /// The file of a note of records that are stored together; none of no records.
    pub(super) fn note_of(&self, records: &[RecordNote]) -> Result<Option<(String, Bytes)>, StoreError> {
        let Some(first) = records.first() else {
            return Ok(None);
        };
        // The same records tried again have the same note.
        let ids: Vec<&str> = records.iter().map(|record| record.id.0.as_str()).collect();
        let batch = Self::name(ids.join(" ").as_bytes());
        let path = format!("{}.{}.json", self.object_path(&first.raw.sha256), &batch[..16]);
        Ok(Some((path.clone(), json(&path, &records)?)))
    }

    /// The records that objects whose names begin with this byte were stored with.
    pub fn notes(&self, shard: u8) -> Result<Vec<RecordNote>, StoreError> {
        let mut records = Vec::new();
        for (_, path) in self.note_paths(shard)? {
            records.extend(self.read::<Vec<RecordNote>>(&path)?.unwrap_or_default());
        }
        Ok(records)
    }

    /// Removes notes of which no object is there any more, nor among those that are `kept` elsewhere.
    pub fn remove_empty_notes(&self, shard: u8, kept: &HashSet<String>) -> Result<(), StoreError> {
        let is_there =
            |name: &str| Ok::<_, StoreError>(kept.contains(name) || self.written_at(name)?.is_some());
        for (first, path) in self.note_paths(shard)? {
            if is_there(&first)? {
                continue;
            }
            let mut is_empty = true;
            for record in self.read::<Vec<RecordNote>>(&path)?.unwrap_or_default() {
                is_empty &= !is_there(&record.raw.sha256)?;
            }
            if is_empty {
                self.remove_file(&path)?;
            }
        }
        Ok(())
    }

    /// Keeps what people said of an asset.
    pub fn put_asset_note(&self, note: &AssetNote) -> Result<(), StoreError> {
        let path = asset_path(&note.spec.id);
        let bytes = json(&path, note)?;
        if self.file(&path)?.is_some_and(|known| known == bytes) {
            return Ok(());
        }
        self.put_file(&path, bytes)
    }

    /// What people said of an asset; none where nothing is kept.
    pub fn asset_note(&self, id: &AssetId) -> Result<Option<AssetNote>, StoreError> {
        self.read(&asset_path(id))
    }

    /// What people said of all assets.
    pub fn asset_notes(&self) -> Result<Vec<AssetNote>, StoreError> {
        let notes = self.files(ASSETS)?.into_iter().map(|file| self.read(&file.path));
        Ok(notes.collect::<Result<Vec<Option<AssetNote>>, _>>()?.into_iter().flatten().collect())
    }

    /// Copies all notes to other objects; a note of an asset that is there is replaced.
    pub(in crate::store) fn copy_notes(&self, to: &Self) -> Result<(), StoreError> {
        let mut paths: Vec<String> = Vec::new();
        for shard in 0..=u8::MAX {
            paths.extend(self.note_paths(shard)?.into_iter().map(|(_, path)| path));
        }
        for folder in [ASSETS, REMOVED] {
            paths.extend(self.files(folder)?.into_iter().map(|file| file.path));
        }
        for path in paths {
            let Some(bytes) = self.file(&path)? else { continue };
            if to.file(&path)?.is_none() || path.starts_with(ASSETS) {
                to.put_file(&path, bytes)?;
            }
        }
        Ok(())
    }

    /// Notes that records were removed.
    pub fn put_removal(&self, removal: &RemovalNote) -> Result<(), StoreError> {
        let name = Self::name(&json(REMOVED, removal)?);
        let path = format!("{REMOVED}/{}.json", &name[..16]);
        self.put_file(&path, json(&path, removal)?)
    }

    /// All records that were removed.
    pub fn removals(&self) -> Result<Vec<RemovalNote>, StoreError> {
        let notes = self.files(REMOVED)?.into_iter().map(|file| self.read(&file.path));
        Ok(notes.collect::<Result<Vec<Option<RemovalNote>>, _>>()?.into_iter().flatten().collect())
    }

    /// Forgets an asset.
    pub fn remove_asset_note(&self, id: &AssetId) -> Result<(), StoreError> {
        self.remove_file(&asset_path(id))
    }

    /// Paths of notes, each with the object that it lies beside.
    fn note_paths(&self, shard: u8) -> Result<Vec<(String, String)>, StoreError> {
        let path = self.object_path(&format!("{shard:02x}"));
        let folder = path.rsplit_once('/').map_or("", |(folder, _)| folder);
        let note = |path: String| {
            let name = path.strip_suffix(".json")?.rsplit('/').next()?.split('.').next()?;
            is_name(name).then(|| (name.to_owned(), path.clone()))
        };
        let files = self.files(folder)?.into_iter();
        Ok(files.filter_map(|file| note(file.path)).collect())
    }

    fn read<T: DeserializeOwned>(&self, path: &str) -> Result<Option<T>, StoreError> {
        let read = |bytes: Bytes| {
            serde_json::from_slice(&bytes).map_err(|source| StoreError::Damaged {
                what: "note",
                of: path.to_owned(),
                source,
            })
        };
        self.file(path)?.map(read).transpose()
    }
}

fn asset_path(id: &AssetId) -> String {
    format!("{ASSETS}/{id}.json")
}

fn json(path: &str, note: &impl Serialize) -> Result<Bytes, StoreError> {
    let json = serde_json::to_vec(note).map_err(|source| StoreError::Damaged {
        what: "note",
        of: path.to_owned(),
        source,
    })?;
    Ok(json.into())
}
