//! The journal of a stream: append-only files of entries with checksums.
//!
//! Every file starts with a checkpoint, the state before its other entries, so that the oldest files can be
//! removed. A file ends at its first incomplete entry: after a crash, entries are written to a
//! new file.

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::{Bytes, BytesMut};

use super::entry::{JournalEntry, ReadEntry};
use crate::store::objects::{file_error, if_exists};
use crate::store::{Disk, StoreError};

/// File size in bytes at which a new file is started.
const FILE_BYTES: u64 = 4 << 20;

/// One file of a journal.
#[derive(Debug)]
struct JournalFile {
    number: u64,
    /// Index after the last sample in it or in earlier files; `None` before the first sample.
    end: Option<u64>,
}

/// A journal that is open for writing.
#[derive(Debug)]
pub struct StreamJournal {
    disk: Arc<dyn Disk>,
    folder: PathBuf,
    frame_bytes: usize,
    /// The oldest first; the last one is written to.
    files: VecDeque<JournalFile>,
    current: File,
    current_bytes: u64,
}

impl StreamJournal {
    /// Calls `take` with the entries of the journal in a folder, file by file, each up to its first
    /// incomplete entry.
    pub fn replay(
        disk: &dyn Disk,
        folder: &Path,
        mut take: impl FnMut(JournalEntry),
    ) -> Result<(), StoreError> {
        for number in numbers(folder)? {
            read_entries(disk, &path_of(folder, number), |entry| {
                take(entry);
                true
            })?;
        }
        Ok(())
    }

    /// Opens the journal in a folder and starts a new file with a checkpoint. `frame_bytes` is the size of a
    /// frame.
    pub fn open(
        disk: Arc<dyn Disk>,
        folder: &Path,
        frame_bytes: usize,
        checkpoint: Bytes,
    ) -> Result<Self, StoreError> {
        disk.create_folder(folder).map_err(|source| file_error("create the folder", folder, source))?;
        let mut files = VecDeque::new();
        for number in numbers(folder)? {
            let mut end = None;
            read_entries(&*disk, &path_of(folder, number), |entry| {
                end = entry.end(frame_bytes).or(end);
                true
            })?;
            files.push_back(JournalFile { number, end });
        }
        let number = files.back().map_or(0, |file| file.number + 1);
        let end = files.iter().rev().find_map(|file| file.end);
        let (current, current_bytes) = begin_file(&*disk, folder, number, checkpoint)?;
        files.push_back(JournalFile { number, end });
        // The parent folders must survive a power failure too.
        for folder in folder.ancestors().skip(1).take(3) {
            sync_folder(&*disk, folder)?;
        }
        Ok(Self { disk, folder: folder.to_path_buf(), frame_bytes, files, current, current_bytes })
    }

    /// Whether the current file is full and a new one should be started with [`rotate`](Self::rotate).
    pub fn is_file_full(&self) -> bool {
        self.current_bytes >= FILE_BYTES
    }

    /// Starts a new file.
    pub fn rotate(&mut self, checkpoint: Bytes) -> Result<(), StoreError> {
        let last = self.files.back();
        let (number, end) = last.map_or((0, None), |file| (file.number + 1, file.end));
        (self.current, self.current_bytes) = begin_file(&*self.disk, &self.folder, number, checkpoint)?;
        self.files.push_back(JournalFile { number, end });
        Ok(())
    }

    /// Appends entries durably. On an error none of them is stored.
    pub fn append(&mut self, entries: &[JournalEntry]) -> Result<(), StoreError> {
        let bytes = JournalEntry::encode(entries);
        if let Err(source) = self.disk.append_synced(&self.current, &bytes) {
            // Entries that may be partial, or only in memory, must not look durable.
            let _ = self.disk.cut_file(&self.current, self.current_bytes);
            let number = self.files.back().map_or(0, |file| file.number);
            return Err(file_error("write", &path_of(&self.folder, number), source));
        }
        self.current_bytes += bytes.len() as u64;
        if let Some(file) = self.files.back_mut() {
            let ends = entries.iter().filter_map(|entry| entry.end(self.frame_bytes));
            file.end = ends.last().or(file.end);
        }
        Ok(())
    }

    /// Removes files with only samples before an index.
    pub fn remove_before(&mut self, index: u64) -> Result<(), StoreError> {
        while self.files.len() > 1
            && let Some(oldest) = self.files.front()
            && oldest.end.is_none_or(|end| end <= index)
        {
            let path = path_of(&self.folder, oldest.number);
            if_exists("remove", &path, self.disk.remove_file(&path))?;
            self.files.pop_front();
        }
        Ok(())
    }

    /// Reads the bytes of these frames; returns `None` if some are missing.
    pub fn frames(&self, first: u64, frames: u64) -> Result<Option<Bytes>, StoreError> {
        let end = first + frames;
        let width = self.frame_bytes;
        // Not grown piece by piece, which would take up to twice the memory.
        let mut found = BytesMut::with_capacity(frames as usize * width);
        let mut next = first;
        for file in &self.files {
            if next == end || file.end.is_none_or(|end| end <= next) {
                continue;
            }
            read_entries(&*self.disk, &path_of(&self.folder, file.number), |entry| {
                next = entry.copy_frames(next, end, width, &mut found);
                next < end
            })?;
        }
        Ok((next == end).then(|| found.freeze()))
    }

    /// Total size of the files in bytes.
    pub fn bytes(&self) -> u64 {
        let length = |file: &JournalFile| {
            fs::metadata(path_of(&self.folder, file.number)).map_or(0, |data| data.len())
        };
        self.files.iter().map(length).sum()
    }
}

fn path_of(folder: &Path, number: u64) -> PathBuf {
    folder.join(format!("{number:012}.journal"))
}

/// The sorted numbers of a journal's files.
fn numbers(folder: &Path) -> Result<Vec<u64>, StoreError> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(|source| file_error("list", folder, source))?,
    };
    let mut numbers: Vec<u64> = Vec::new();
    for entry in entries {
        // A file that is missed would have its number given out again.
        let name = entry.map_err(|source| file_error("list", folder, source))?.file_name();
        numbers.extend(name.to_str().and_then(|name| name.strip_suffix(".journal")?.parse::<u64>().ok()));
    }
    numbers.sort_unstable();
    Ok(numbers)
}

fn begin_file(
    disk: &dyn Disk,
    folder: &Path,
    number: u64,
    checkpoint: Bytes,
) -> Result<(File, u64), StoreError> {
    let path = path_of(folder, number);
    let bytes = JournalEntry::encode(&[JournalEntry::Checkpoint(checkpoint)]);
    let failed = |source| file_error("write", &path, source);
    let file = disk.create_file(&path).map_err(failed)?;
    let written = disk.append_synced(&file, &bytes).map_err(failed);
    if let Err(error) = written.and_then(|()| sync_folder(disk, folder)) {
        // Free the number for a retry.
        let _ = disk.remove_file(&path);
        return Err(error);
    }
    Ok((file, bytes.len() as u64))
}

fn sync_folder(disk: &dyn Disk, folder: &Path) -> Result<(), StoreError> {
    disk.sync_folder(folder).map_err(|source| file_error("sync the folder", folder, source))
}

/// Calls `take` with the entries of a file until it returns false or an entry is incomplete.
fn read_entries(
    disk: &dyn Disk,
    path: &Path,
    mut take: impl FnMut(JournalEntry) -> bool,
) -> Result<(), StoreError> {
    let failed = |source| file_error("read", path, source);
    let mut file = io::BufReader::with_capacity(1 << 16, disk.open(path).map_err(failed)?);
    loop {
        match JournalEntry::read_from(&mut file).map_err(failed)? {
            ReadEntry::Whole(entry) => {
                if !take(entry) {
                    return Ok(());
                }
            }
            ReadEntry::Incomplete => return Ok(()),
            ReadEntry::Damaged => {
                tracing::warn!(file = %path.display(), "skipped the rest of a journal file: an entry is damaged");
                return Ok(());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::SystemDisk;

    fn frames(first: u64, count: u64) -> JournalEntry {
        let bytes = (first..first + count).flat_map(|k| (k as i16).to_le_bytes()).collect();
        JournalEntry::Frames { first, time_ns: Some(7).filter(|_| first > 0), bytes }
    }

    fn entries(folder: &Path) -> Vec<JournalEntry> {
        let mut all = Vec::new();
        StreamJournal::replay(&SystemDisk, folder, |entry| all.push(entry)).unwrap();
        all
    }

    #[test]
    fn complete_entries_are_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let mut journal =
            StreamJournal::open(Arc::new(SystemDisk), folder.path(), 2, Bytes::from_static(b"a")).unwrap();
        let gap = JournalEntry::Gap { first: 10, frames: 5 };
        let event = JournalEntry::Event(Bytes::from_static(b"note"));
        let all = [frames(0, 10), gap, frames(15, 5), event];
        journal.append(&all[..2]).unwrap();
        journal.append(&all[2..]).unwrap();
        let checkpoint = |name| JournalEntry::Checkpoint(Bytes::from_static(name));
        let mut expected = vec![checkpoint(b"a")];
        expected.extend_from_slice(&all);
        assert_eq!(entries(folder.path()), expected);
        assert_eq!(journal.frames(2, 3).unwrap().unwrap(), Bytes::from_static(&[2, 0, 3, 0, 4, 0]));
        assert_eq!(journal.frames(8, 4).unwrap(), None);
        drop(journal);
        // Killed in the middle of an entry, or a bit flipped.
        let path = path_of(folder.path(), 0);
        let whole = fs::read(&path).unwrap();
        for (bytes, left) in [(&whole[..whole.len() - 1], 4), (&whole[..60], 2)] {
            fs::write(&path, bytes).unwrap();
            assert_eq!(entries(folder.path()), expected[..left]);
        }
        let mut turned = whole.clone();
        turned[30] ^= 1;
        fs::write(&path, turned).unwrap();
        assert_eq!(entries(folder.path()), expected[..1]);
        // Later entries are in a new file.
        fs::write(&path, &whole[..whole.len() - 1]).unwrap();
        let mut journal =
            StreamJournal::open(Arc::new(SystemDisk), folder.path(), 2, Bytes::from_static(b"b")).unwrap();
        journal.append(&[frames(20, 1)]).unwrap();
        assert_eq!(entries(folder.path())[4..], [checkpoint(b"b"), frames(20, 1)]);
        assert_eq!(journal.frames(18, 3).unwrap().unwrap().len(), 6);
    }

    #[test]
    fn an_existing_file_is_not_written_to() {
        let folder = tempfile::tempdir().unwrap();
        let open = || StreamJournal::open(Arc::new(SystemDisk), folder.path(), 2, Bytes::new()).unwrap();
        let mut journal = open();
        let mut other = open();
        other.append(&[frames(0, 10)]).unwrap();
        let error = journal.rotate(Bytes::new()).unwrap_err();
        assert!(error.to_string().contains("000000000001.journal"), "{error}");
        assert!(entries(folder.path()).contains(&frames(0, 10)), "its samples are kept");
    }

    #[test]
    fn files_are_removed_once_they_are_not_needed() {
        let folder = tempfile::tempdir().unwrap();
        let mut journal = StreamJournal::open(Arc::new(SystemDisk), folder.path(), 2, Bytes::new()).unwrap();
        for k in 0..4 {
            journal.append(&[frames(k * 10, 10)]).unwrap();
            journal.rotate(Bytes::new()).unwrap();
        }
        journal.remove_before(19).unwrap();
        assert_eq!(numbers(folder.path()).unwrap(), [1, 2, 3, 4]);
        assert!(journal.frames(10, 30).unwrap().is_some());
        journal.remove_before(40).unwrap();
        assert_eq!(numbers(folder.path()).unwrap(), [4]);
        assert!(journal.bytes() > 0 && !journal.is_file_full());
    }
}
