//! Buffer of unsent samples: a few MiB in memory, more on disk; oldest first.

use std::collections::VecDeque;
use std::fs;
use std::path::{Path, PathBuf};

use crate::cli::CliError;

/// Maximum bytes in memory before the disk is used, with a spool folder.
const MAX_WITH_FOLDER: u64 = 4 << 20;

/// Maximum bytes in memory without a spool folder.
const MAX_WITHOUT_FOLDER: u64 = 64 << 20;

/// Size of a file's header: the time of the first sample.
const HEADER_BYTES: usize = 8;

/// Consecutive samples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Block {
    /// Index of the first sample.
    pub(super) first: u64,
    /// Time of the first sample, in nanoseconds since 1970.
    pub(super) time_ns: i64,
    /// The frames.
    pub(super) bytes: Vec<u8>,
}

/// Blocks in order. Those in memory are older than those on disk.
#[derive(Debug)]
pub(super) struct Spool {
    memory: VecDeque<Block>,
    memory_bytes: u64,
    folder: Option<PathBuf>,
    /// First index and length of each file.
    files: VecDeque<(u64, u64)>,
    file_bytes: u64,
    max_file_bytes: u64,
}

impl Spool {
    /// Opens the folder with the blocks that an earlier run left in it, which must have the same `format`.
    pub(super) fn open(folder: Option<PathBuf>, max_file_bytes: u64, format: &str) -> Result<Self, CliError> {
        let mut files = Vec::new();
        if let Some(folder) = &folder {
            fs::create_dir_all(folder).map_err(CliError::file(folder))?;
            for entry in fs::read_dir(folder).map_err(CliError::file(folder))?.flatten() {
                let name = entry.file_name();
                let first = name.to_str().and_then(|name| name.strip_suffix(".block")?.parse().ok());
                if let Some((first, data)) = first.zip(entry.metadata().ok()) {
                    files.push((first, data.len()));
                }
            }
            let path = folder.join("format");
            let before = fs::read_to_string(&path).unwrap_or_default();
            if !files.is_empty() && before != format {
                let folder = folder.display();
                let detail =
                    format!("--spool {folder} has samples in the format {before}, expected {format}");
                return Err(CliError::Argument(detail));
            }
            fs::write(&path, format).map_err(CliError::file(&path))?;
        }
        files.sort_unstable();
        let file_bytes = files.iter().map(|(_, bytes)| bytes).sum();
        let (memory, files) = (VecDeque::new(), files.into());
        Ok(Self { memory, memory_bytes: 0, folder, files, file_bytes, max_file_bytes })
    }

    /// Returns the index after the last sample on disk; 0 without any.
    pub(super) fn end_on_disk(&self, frame_bytes: usize) -> u64 {
        let samples = |bytes: u64| bytes.saturating_sub(HEADER_BYTES as u64) / frame_bytes as u64;
        self.files.back().map_or(0, |(first, bytes)| first + samples(*bytes))
    }

    /// Adds a block and drops the oldest blocks above the limits; returns the bytes of samples dropped.
    pub(super) fn push(&mut self, block: Block) -> Result<u64, CliError> {
        let bytes = block.bytes.len() as u64;
        let max_bytes = if self.folder.is_some() { MAX_WITH_FOLDER } else { MAX_WITHOUT_FOLDER };
        if self.folder.is_none() || self.files.is_empty() && self.memory_bytes + bytes <= max_bytes {
            self.memory_bytes += bytes;
            self.memory.push_back(block);
        } else {
            self.write(&block)?;
        }
        let mut dropped = 0;
        while self.memory_bytes > max_bytes || self.file_bytes > self.max_file_bytes {
            let Some(oldest) = self.front()? else { break };
            dropped += oldest.bytes.len() as u64;
            self.pop()?;
        }
        Ok(dropped)
    }

    /// Whether the memory is full: a reader that can wait should wait.
    pub(super) fn is_full(&self) -> bool {
        self.memory_bytes >= MAX_WITH_FOLDER || !self.files.is_empty()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.memory.is_empty() && self.files.is_empty()
    }

    /// Whether any block is on disk.
    pub(super) fn is_on_disk(&self) -> bool {
        !self.files.is_empty()
    }

    /// Returns the oldest block.
    pub(super) fn front(&mut self) -> Result<Option<Block>, CliError> {
        if let Some(block) = self.memory.front() {
            return Ok(Some(block.clone()));
        }
        let Some((path, first)) = self.files.front().map(|(first, _)| (self.path(*first), *first)) else {
            return Ok(None);
        };
        let bytes = fs::read(&path).map_err(CliError::file(&path))?;
        let (header, samples) = bytes.split_at(bytes.len().min(HEADER_BYTES));
        let time_ns = header.try_into().map_or(0, i64::from_le_bytes);
        Ok(Some(Block { first, time_ns, bytes: samples.to_vec() }))
    }

    /// Removes the oldest block.
    pub(super) fn pop(&mut self) -> Result<(), CliError> {
        if let Some(block) = self.memory.pop_front() {
            self.memory_bytes -= block.bytes.len() as u64;
        } else if let Some((first, bytes)) = self.files.pop_front() {
            self.file_bytes -= bytes;
            let path = self.path(first);
            fs::remove_file(&path).map_err(CliError::file(&path))?;
        }
        Ok(())
    }

    /// Writes the blocks in memory to the folder, for the next run; without a folder, returns the bytes of
    /// samples lost.
    pub(super) fn save(&mut self) -> Result<u64, CliError> {
        if self.folder.is_none() {
            return Ok(self.memory_bytes);
        }
        for block in std::mem::take(&mut self.memory) {
            self.write(&block)?;
        }
        Ok(0)
    }

    fn write(&mut self, block: &Block) -> Result<(), CliError> {
        let path = self.path(block.first);
        let part = path.with_extension("part");
        let bytes = [&block.time_ns.to_le_bytes()[..], &block.bytes].concat();
        let write = || {
            fs::write(&part, &bytes)?;
            fs::File::open(&part)?.sync_all()?;
            fs::rename(&part, &path)
        };
        write().map_err(CliError::file(&path))?;
        self.files.push_back((block.first, bytes.len() as u64));
        self.file_bytes += bytes.len() as u64;
        Ok(())
    }

    fn path(&self, first: u64) -> PathBuf {
        // Twenty digits, so that the order of names is the order of samples.
        self.folder.as_deref().unwrap_or(Path::new("")).join(format!("{first:020}.block"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(n: u64, bytes: usize) -> Block {
        Block { first: n * 100, time_ns: n as i64, bytes: vec![n as u8; bytes] }
    }

    fn drain(spool: &mut Spool) -> Vec<Block> {
        let mut blocks = Vec::new();
        while let Some(block) = spool.front().unwrap() {
            blocks.push(block);
            spool.pop().unwrap();
        }
        assert!(spool.is_empty());
        blocks
    }

    #[test]
    fn blocks_are_returned_in_order_from_memory_and_disk() {
        let folder = tempfile::tempdir().unwrap();
        let open = || Spool::open(Some(folder.path().join("spool")), u64::MAX, "f32").unwrap();
        let mut spool = open();
        let blocks: Vec<Block> = (0..10).map(|n| block(n, 1 << 20)).collect();
        for block in &blocks {
            assert_eq!(spool.push(block.clone()).unwrap(), 0);
        }
        assert!(spool.is_full() && spool.is_on_disk());
        assert_eq!(drain(&mut spool), blocks);
        assert_eq!(spool.end_on_disk(8), 0);
        // The next run starts with the blocks that this one leaves.
        for block in &blocks {
            spool.push(block.clone()).unwrap();
        }
        assert_eq!(spool.save().unwrap(), 0);
        let mut spool = open();
        assert_eq!(spool.end_on_disk(8), 900 + (1 << 17));
        spool.push(block(10, 8)).unwrap();
        let all = drain(&mut spool);
        assert_eq!((&all[..10], &all[10]), (&blocks[..], &block(10, 8)));
        spool.push(block(11, 8)).unwrap();
        spool.save().unwrap();
        let other = Spool::open(Some(folder.path().join("spool")), 0, "i16").map(|_| ());
        assert!(other.unwrap_err().to_string().contains("i16"));
    }

    #[test]
    fn a_full_spool_drops_the_oldest_blocks() {
        let folder = tempfile::tempdir().unwrap();
        let mut spool = Spool::open(Some(folder.path().to_owned()), 3 << 20, "f32").unwrap();
        let dropped: u64 = (0..10).map(|n| spool.push(block(n, 1 << 20)).unwrap()).sum();
        assert_eq!(dropped, 8 << 20);
        assert_eq!(drain(&mut spool), [block(8, 1 << 20), block(9, 1 << 20)]);
        let mut spool = Spool::open(None, 0, "f32").unwrap();
        let dropped: u64 = (0..66).map(|n| spool.push(block(n, 1 << 20)).unwrap()).sum();
        assert_eq!((dropped, spool.front().unwrap().unwrap().first), (2 << 20, 200));
        assert_eq!(spool.save().unwrap(), 64 << 20);
    }
}
