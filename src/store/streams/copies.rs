//! Copies of the folders of live streams, made while a service writes to them.
//!
//! Files of a journal are only appended to or removed. They are all opened before any is copied, so that a
//! copy is a snapshot of the journal, apart from entries appended later. A partial entry is skipped when the
//! journal is read.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::levels::OLDER_LEVELS;
use crate::store::StoreError;
use crate::store::objects::{file_error, if_exists};

/// Folder of the streams in a data folder and in a backup.
const STREAMS: &str = "streams";

/// Folder of incomplete copies.
const PART: &str = "streams.part";

/// Copied streams that are not moved to their final place yet.
#[derive(Debug)]
pub(in crate::store) struct StreamCopies {
    folder: PathBuf,
    /// Relative path of each: asset and name.
    streams: Vec<PathBuf>,
    /// Streams that could not be copied, each with the reason.
    pub(in crate::store) failed: Vec<String>,
}

impl StreamCopies {
    /// Copies the streams of one folder for another one. With `only_new`, streams that the other folder has
    /// are skipped. A stream that cannot be copied is listed in `failed`.
    ///
    /// # Errors
    /// The remains of an earlier copy cannot be removed.
    pub(in crate::store) fn make(from: &Path, to: &Path, only_new: bool) -> Result<Self, StoreError> {
        let mut copies = Self { folder: to.to_path_buf(), streams: Vec::new(), failed: Vec::new() };
        let part = copies.part();
        remove_all(&part)?;
        let source = from.join(STREAMS);
        for stream in streams_in(&source)? {
            if only_new && to.join(STREAMS).join(&stream).exists() {
                continue;
            }
            match copy_stream(&source.join(&stream), &part.join(&stream)) {
                Ok(()) => copies.streams.push(stream),
                Err(error) => copies.failed.push(error.to_string()),
            }
        }
        Ok(copies)
    }

    /// Moves the copies to their place beside existing streams; returns their number.
    pub(in crate::store) fn add(self) -> Result<u64, StoreError> {
        for stream in &self.streams {
            let path = self.folder.join(STREAMS).join(stream);
            let of_asset = path.parent().unwrap_or(&self.folder);
            let placed = fs::create_dir_all(of_asset)
                .and_then(|()| fs::rename(self.part().join(stream), &path))
                .and_then(|()| sync(of_asset))
                .and_then(|()| sync(&self.folder.join(STREAMS)));
            placed.map_err(|source| file_error("rename to", &path, source))?;
        }
        remove_all(&self.part())?;
        Ok(self.streams.len() as u64)
    }

    /// Replaces all existing streams by the copies; returns their number.
    pub(in crate::store) fn replace(self) -> Result<u64, StoreError> {
        remove_all(&self.folder.join(STREAMS))?;
        self.add()
    }

    fn part(&self) -> PathBuf {
        self.folder.join(PART)
    }
}

fn copy_stream(from: &Path, to: &Path) -> Result<(), StoreError> {
    let failed = |source| file_error("copy", from, source);
    let files = open_files(from).map_err(failed)?;
    let copy = || {
        fs::create_dir_all(to)?;
        for (name, mut file) in files {
            let mut copy = File::create(to.join(name))?;
            io::copy(&mut file, &mut copy)?;
            copy.sync_all()?;
        }
        sync(to)
    };
    copy().map_err(failed)
}

/// Opens all files of a stream. Starts again if one is removed or renamed in the meantime.
fn open_files(folder: &Path) -> io::Result<Vec<(OsString, File)>> {
    loop {
        let older_levels = changed_at(&folder.join(OLDER_LEVELS));
        let names = names_in(folder)?;
        let files: io::Result<Vec<_>> =
            names.into_iter().map(|name| Ok((name.clone(), File::open(folder.join(name))?))).collect();
        match files {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
            Ok(files) if changed_at(&folder.join(OLDER_LEVELS)) == older_levels => return Ok(files),
            Ok(_) => {}
        }
    }
}

fn changed_at(path: &Path) -> Option<SystemTime> {
    fs::metadata(path).and_then(|data| data.modified()).ok()
}

/// Relative paths of the streams in a folder: asset and name.
fn streams_in(folder: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let list = || {
        let mut streams = Vec::new();
        for asset in names_in(folder)? {
            let is_folder = |name: &OsString| folder.join(&asset).join(name).is_dir();
            let names = names_in(&folder.join(&asset))?.into_iter();
            streams.extend(names.filter(is_folder).map(|name| Path::new(&asset).join(name)));
        }
        Ok(streams)
    };
    list().map_err(|source| file_error("list", folder, source))
}

/// The sorted names in a folder; empty if the folder does not exist.
fn names_in(folder: &Path) -> io::Result<Vec<OsString>> {
    let entries = match fs::read_dir(folder) {
        Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
            return Ok(Vec::new());
        }
        entries => entries?,
    };
    let mut names = entries.map(|entry| Ok(entry?.file_name())).collect::<io::Result<Vec<_>>>()?;
    names.sort_unstable();
    Ok(names)
}

fn remove_all(folder: &Path) -> Result<(), StoreError> {
    if_exists("remove", folder, fs::remove_dir_all(folder)).map(drop)
}

fn sync(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use bytes::Bytes;

    use super::*;
    use crate::store::{JournalEntry, StreamJournal, SystemDisk};

    fn frames(first: u64) -> JournalEntry {
        let bytes = (first..first + 10).flat_map(|k| (k as i16).to_le_bytes()).collect();
        JournalEntry::Frames { first, time_ns: None, bytes }
    }

    /// Indices of the first samples of the entries in a journal.
    fn firsts(folder: &Path) -> Vec<u64> {
        let mut firsts = Vec::new();
        StreamJournal::replay(&SystemDisk, folder, |entry| match entry {
            JournalEntry::Frames { first, .. } => firsts.push(first),
            JournalEntry::Checkpoint(_) => {}
            entry => panic!("{entry:?}"),
        })
        .unwrap();
        firsts
    }

    #[test]
    fn a_copy_is_contiguous_while_files_are_added_and_removed() {
        let (data, to) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let folder = data.path().join("streams/pump/main");
        let mut journal = StreamJournal::open(Arc::new(SystemDisk), &folder, 2, Bytes::new()).unwrap();
        std::thread::scope(|scope| {
            let writer = scope.spawn(|| {
                for k in 0..200 {
                    journal.append(&[frames(k * 10)]).unwrap();
                    journal.rotate(Bytes::new()).unwrap();
                    journal.remove_before((k * 10).saturating_sub(50)).unwrap();
                }
            });
            while !writer.is_finished() {
                let copies = StreamCopies::make(data.path(), to.path(), false).unwrap();
                assert_eq!(copies.failed, [""; 0]);
                assert_eq!(copies.replace().unwrap(), 1);
                let firsts = firsts(&to.path().join("streams/pump/main"));
                assert!(firsts.windows(2).all(|pair| pair[1] == pair[0] + 10), "{firsts:?}");
            }
        });
        let copies = StreamCopies::make(data.path(), to.path(), false).unwrap();
        copies.replace().unwrap();
        let copied = firsts(&to.path().join("streams/pump/main"));
        assert_eq!(copied.last(), Some(&1990));
        assert_eq!(copied, firsts(&folder));
    }

    #[test]
    fn a_backup_replaces_streams_and_a_restore_keeps_existing_ones() {
        let (data, copy) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let write = |folder: &Path, stream: &str, text: &str| {
            let folder = folder.join("streams").join(stream);
            fs::create_dir_all(&folder).unwrap();
            fs::write(folder.join("levels"), text).unwrap();
        };
        let read = |folder: &Path, stream: &str| {
            fs::read_to_string(folder.join("streams").join(stream).join("levels")).ok()
        };
        write(data.path(), "pump/main", "one");
        write(data.path(), "fan/main", "two");
        write(copy.path(), "gone/main", "old");
        // An earlier copy was interrupted.
        fs::create_dir_all(copy.path().join("streams.part/pump/main")).unwrap();
        let copies = StreamCopies::make(data.path(), copy.path(), false).unwrap();
        assert_eq!(copies.replace().unwrap(), 2);
        assert_eq!(read(copy.path(), "gone/main"), None);
        assert_eq!(read(copy.path(), "fan/main").as_deref(), Some("two"));

        write(data.path(), "pump/main", "newer");
        fs::remove_dir_all(data.path().join("streams/fan")).unwrap();
        let copies = StreamCopies::make(copy.path(), data.path(), true).unwrap();
        assert_eq!(copies.add().unwrap(), 1);
        assert_eq!(read(data.path(), "pump/main").as_deref(), Some("newer"));
        assert_eq!(read(data.path(), "fan/main").as_deref(), Some("two"));
        assert!(!data.path().join("streams.part").exists());
    }
}
