//! Metadata files stored beside the raw objects, from which the database can be rebuilt: one of the records
//! that were stored together (`NAME.BATCH.json` beside the object NAME), one of each asset
//! (`assets/ID.json`), and tombstones of removed records (`removed/…`).

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
pub struct RecordMetadata {
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
pub struct AssetMetadata {
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
pub struct Tombstone {
    /// The time of the removal.
    pub removed_at: Timestamp,
    /// Their segments; a record sent again after the removal is not affected.
    pub segments: Vec<SegmentId>,
}

/// A metadata file whose objects are all gone.
#[derive(Debug)]
pub struct OrphanedMetadata {
    path: String,
    /// Names of its objects.
    names: Vec<String>,
}

impl Objects {
    /// The path and content of the metadata of records that are stored together; `None` without records.
    pub(super) fn file_of(&self, records: &[RecordMetadata]) -> Result<Option<(String, Bytes)>, StoreError> {
        let Some(first) = records.first() else {
            return Ok(None);
        };
        // A retry with the same records gives the same metadata file.
        let ids: Vec<&str> = records.iter().map(|record| record.id.0.as_str()).collect();
        let batch = Self::name(ids.join(" ").as_bytes());
        let path = format!("{}.{}.json", self.backend.object_path(&first.raw.sha256), &batch[..16]);
        Ok(Some((path.clone(), json(&path, &records)?)))
    }

    /// Reads the metadata of the records beside the objects whose names start with this byte.
    pub fn record_metadata(&self, shard: u8) -> Result<Vec<RecordMetadata>, StoreError> {
        let mut records = Vec::new();
        for (_, path) in self.metadata_paths(shard)? {
            records.extend(self.read::<Vec<RecordMetadata>>(&path)?.unwrap_or_default());
        }
        Ok(records)
    }

    /// Lists the metadata files that are old enough, and none of whose objects exists, in quarantine or out
    /// of it.
    pub fn orphaned_metadata(
        &self,
        shard: u8,
        is_old_enough: impl Fn(Timestamp) -> bool,
    ) -> Result<Vec<OrphanedMetadata>, StoreError> {
        let mut files = Vec::new();
        for (first, path) in self.metadata_paths(shard)? {
            if self.written_at(&first)?.is_some() {
                continue;
            }
            let records = self.read::<Vec<RecordMetadata>>(&path)?.unwrap_or_default();
            let mut names: Vec<String> = records.into_iter().map(|record| record.raw.sha256).collect();
            names.push(first);
            if !self.has_any(&names)? {
                files.push(OrphanedMetadata { path, names });
            }
        }
        self.empty_among(files, is_old_enough)
    }

    /// Removes those of these metadata files that are still empty and old enough. No objects with metadata
    /// files may be stored meanwhile.
    pub fn remove_orphaned_metadata(
        &self,
        files: Vec<OrphanedMetadata>,
        is_old_enough: impl Fn(Timestamp) -> bool,
    ) -> Result<(), StoreError> {
        let empty = self.empty_among(files, is_old_enough)?;
        empty.iter().try_for_each(|file| self.backend.remove_file(&file.path))
    }

    fn empty_among(
        &self,
        files: Vec<OrphanedMetadata>,
        is_old_enough: impl Fn(Timestamp) -> bool,
    ) -> Result<Vec<OrphanedMetadata>, StoreError> {
        if files.is_empty() {
            return Ok(files);
        }
        // Listed before the objects are looked for again: one that was moved into quarantine a moment ago is
        // in the list, and one that was restored is at its place again.
        let kept: HashSet<String> =
            self.quarantined()?.into_iter().map(|quarantined| quarantined.name).collect();
        let mut empty = Vec::new();
        for file in files {
            if !file.names.iter().any(|name| kept.contains(name))
                && !self.has_any(&file.names)?
                && self.file_written_at(&file.path)?.is_some_and(&is_old_enough)
            {
                empty.push(file);
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

    /// Writes the metadata of an asset.
    pub fn put_asset_metadata(&self, metadata: &AssetMetadata) -> Result<(), StoreError> {
        let path = asset_path(&metadata.spec.id);
        let bytes = json(&path, metadata)?;
        if self.backend.file(&path)?.is_some_and(|known| known == bytes) {
            return Ok(());
        }
        self.backend.put_file(&path, bytes)
    }

    /// Reads the metadata of an asset; `None` if there is none.
    pub fn asset_metadata(&self, id: &AssetId) -> Result<Option<AssetMetadata>, StoreError> {
        self.read(&asset_path(id))
    }

    /// Reads the metadata of all assets.
    pub fn all_asset_metadata(&self) -> Result<Vec<AssetMetadata>, StoreError> {
        let all = self.backend.files(ASSETS)?.into_iter().map(|file| self.read(&file.path));
        Ok(all.collect::<Result<Vec<Option<AssetMetadata>>, _>>()?.into_iter().flatten().collect())
    }

    /// Copies all metadata files to other objects; existing metadata of assets are replaced if these are
    /// newer.
    pub(in crate::store) fn copy_metadata(&self, to: &Self, are_newer: bool) -> Result<(), StoreError> {
        let mut paths: Vec<String> = Vec::new();
        for shard in self.shards()? {
            paths.extend(self.metadata_paths(shard)?.into_iter().map(|(_, path)| path));
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

    /// Removes the metadata of assets and of removed records that other objects do not have; those of
    /// `assets` are kept.
    pub(in crate::store) fn remove_metadata_missing_in(
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

    /// Writes a tombstone of removed records.
    pub fn put_tombstone(&self, tombstone: &Tombstone) -> Result<(), StoreError> {
        let name = Self::name(&json(REMOVED, tombstone)?);
        let path = format!("{REMOVED}/{}.json", &name[..16]);
        self.backend.put_file(&path, json(&path, tombstone)?)
    }

    /// Reads the tombstones.
    pub fn tombstones(&self) -> Result<Vec<Tombstone>, StoreError> {
        let tombstones = self.backend.files(REMOVED)?.into_iter().map(|file| self.read(&file.path));
        Ok(tombstones.collect::<Result<Vec<Option<Tombstone>>, _>>()?.into_iter().flatten().collect())
    }

    /// Takes segments out of those tombstones that are old enough, because they are stored.
    pub fn withdraw_tombstones(
        &self,
        restored: &HashSet<SegmentId>,
        is_old_enough: impl Fn(Timestamp) -> bool,
    ) -> Result<(), StoreError> {
        for file in self.backend.files(REMOVED)? {
            let Some(tombstone) = self.read::<Tombstone>(&file.path)? else { continue };
            if !is_old_enough(tombstone.removed_at) {
                continue;
            }
            let (removed_at, mut segments) = (tombstone.removed_at, tombstone.segments);
            let count = segments.len();
            segments.retain(|segment| !restored.contains(segment));
            if segments.len() == count {
                continue;
            }
            // Written before the other is removed: a crash leaves both.
            if !segments.is_empty() {
                self.put_tombstone(&Tombstone { removed_at, segments })?;
            }
            self.backend.remove_file(&file.path)?;
        }
        Ok(())
    }

    /// Removes the metadata of an asset.
    pub fn remove_asset_metadata(&self, id: &AssetId) -> Result<(), StoreError> {
        self.backend.remove_file(&asset_path(id))
    }

    /// The paths of metadata files, each with the name of the object beside it.
    fn metadata_paths(&self, shard: u8) -> Result<Vec<(String, String)>, StoreError> {
        let path = self.backend.object_path(&format!("{shard:02x}"));
        let folder = path.rsplit_once('/').map_or("", |(folder, _)| folder);
        let with_object = |path: String| {
            let name = path.strip_suffix(".json")?.rsplit('/').next()?.split('.').next()?;
            is_name(name).then(|| (name.to_owned(), path.clone()))
        };
        let files = self.backend.files(folder)?.into_iter();
        Ok(files.filter_map(|file| with_object(file.path)).collect())
    }

    fn read<T: DeserializeOwned>(&self, path: &str) -> Result<Option<T>, StoreError> {
        let read =
            |bytes: Bytes| serde_json::from_slice(&bytes).map_err(StoreError::damaged("metadata file", path));
        self.backend.file(path)?.map(read).transpose()
    }
}

fn asset_path(id: &AssetId) -> String {
    format!("{ASSETS}/{id}.json")
}

fn json(path: &str, metadata: &impl Serialize) -> Result<Bytes, StoreError> {
    let json = serde_json::to_vec(metadata).map_err(StoreError::damaged("metadata file", path))?;
    Ok(json.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metadata_of(name: &str) -> RecordMetadata {
        RecordMetadata {
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
    fn restored_records_are_withdrawn_from_tombstones() {
        let folder = tempfile::tempdir().unwrap();
        let objects = Objects::open(folder.path()).unwrap();
        let segment = |name: &str| SegmentId(name.to_owned());
        let tombstones = [vec!["a", "b"], vec!["c"], vec!["d"]].map(|names| Tombstone {
            removed_at: Timestamp::UNIX_EPOCH,
            segments: names.into_iter().map(segment).collect(),
        });
        tombstones.iter().for_each(|tombstone| objects.put_tombstone(tombstone).unwrap());
        let restored = ["b", "c", "e"].into_iter().map(segment).collect();
        objects.withdraw_tombstones(&restored, |_| false).unwrap();
        assert_eq!(objects.tombstones().unwrap().len(), tombstones.len());
        objects.withdraw_tombstones(&restored, |_| true).unwrap();
        let mut left: Vec<_> =
            objects.tombstones().unwrap().into_iter().map(|tombstone| tombstone.segments).collect();
        left.sort_unstable_by(|one, other| one[0].0.cmp(&other[0].0));
        assert_eq!(left, [[segment("a")], [segment("d")]]);
    }

    #[test]
    fn notes_are_kept_while_objects_move_into_quarantine() {
        let folder = tempfile::tempdir().unwrap();
        let objects = Objects::open(folder.path()).unwrap();
        let names: Vec<String> = (0..60).map(|number| format!("00{number:062x}")).collect();
        for name in &names {
            objects.put_all(&[(name.clone(), Bytes::from_static(b"abc"))], &[metadata_of(name)]).unwrap();
        }
        let remove_orphaned_metadata = |are_old: bool| {
            let empty = objects.orphaned_metadata(0, |_| are_old).unwrap();
            objects.remove_orphaned_metadata(empty, |_| are_old).unwrap();
        };
        std::thread::scope(|scope| {
            let moving = scope.spawn(|| {
                for name in &names {
                    objects.quarantine(name, Timestamp::UNIX_EPOCH).unwrap();
                }
            });
            while !moving.is_finished() {
                remove_orphaned_metadata(true);
            }
        });
        assert_eq!(objects.record_metadata(0).unwrap().len(), names.len());
        objects.remove_quarantined(std::time::Duration::ZERO, Timestamp::now()).unwrap();
        remove_orphaned_metadata(false);
        assert_eq!(objects.record_metadata(0).unwrap().len(), names.len(), "young metadata files stay");
        remove_orphaned_metadata(true);
        assert_eq!(objects.record_metadata(0).unwrap(), []);
    }
}
