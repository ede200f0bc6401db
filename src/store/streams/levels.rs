//! The levels of a stream for each second, in rows of fixed length.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::recording::stream::{ChannelLevel, Level};
use crate::store::StoreError;
use crate::store::objects::file_error;

/// File size in bytes at which the older file is replaced: days of levels for many channels, weeks for few.
const FILE_BYTES: u64 = 16 << 20;

/// The file of the older levels.
pub(in crate::store) const OLDER_LEVELS: &str = "levels.before";

/// Index, time and number of samples of a row.
const HEAD_BYTES: usize = 24;

/// The levels of one second with their time.
#[derive(Debug, Clone, PartialEq)]
pub struct TimedLevel {
    /// Time of the second's first sample in nanoseconds since 1970.
    pub time_ns: i64,
    /// The levels.
    pub level: Level,
}

impl TimedLevel {
    /// Size of a row with this number of channels.
    fn row_bytes(channels: usize) -> usize {
        HEAD_BYTES + 8 * channels
    }

    /// Appends the row of the level.
    pub(in crate::store) fn write(&self, out: &mut Vec<u8>) {
        let Self { time_ns, level } = self;
        out.extend_from_slice(&level.first.to_le_bytes());
        out.extend_from_slice(&time_ns.to_le_bytes());
        out.extend_from_slice(&level.frames.to_le_bytes());
        for channel in &level.channels {
            out.extend_from_slice(&channel.rms.to_le_bytes());
            out.extend_from_slice(&channel.peak.to_le_bytes());
        }
    }

    /// Decodes whole rows with this number of channels.
    pub(in crate::store) fn decode(bytes: &[u8], channels: usize) -> impl Iterator<Item = Self> + '_ {
        bytes.chunks_exact(Self::row_bytes(channels)).map(Self::read)
    }

    /// Decodes a row.
    fn read(bytes: &[u8]) -> Self {
        let (head, values) = bytes.split_at(HEAD_BYTES);
        let (words, _) = head.as_chunks::<8>();
        let (values, _) = values.as_chunks::<4>();
        let (pairs, _) = values.as_chunks::<2>();
        let channels = pairs.iter().map(|[rms, peak]| ChannelLevel {
            rms: f32::from_le_bytes(*rms),
            peak: f32::from_le_bytes(*peak),
        });
        Self {
            time_ns: i64::from_le_bytes(words[1]),
            level: Level {
                first: u64::from_le_bytes(words[0]),
                frames: u64::from_le_bytes(words[2]),
                channels: channels.collect(),
            },
        }
    }
}

/// The levels of a stream in two files; the older one is dropped when the newer one is full.
#[derive(Debug)]
pub struct StreamLevels {
    folder: PathBuf,
    channels: usize,
    /// Index of the last row's first sample.
    last: Option<u64>,
}

impl StreamLevels {
    /// Opens the levels in a folder, which may not exist yet.
    pub fn open(folder: &Path, channels: usize) -> Result<Self, StoreError> {
        let mut levels = Self { folder: folder.to_path_buf(), channels, last: None };
        let last = levels.read(i64::MIN, i64::MAX)?.last().map(|row| row.level.first);
        levels.last = last;
        Ok(levels)
    }

    /// Appends levels; those not later than the last stored one are skipped.
    pub fn append(&mut self, rows: &[TimedLevel]) -> Result<(), StoreError> {
        let new = rows.iter().filter(|row| self.last.is_none_or(|last| row.level.first > last));
        let mut bytes = Vec::new();
        new.for_each(|row| row.write(&mut bytes));
        if bytes.is_empty() {
            return Ok(());
        }
        let path = self.newer();
        let write = || {
            if fs::metadata(&path).is_ok_and(|data| data.len() >= FILE_BYTES) {
                fs::rename(&path, self.older())?;
            }
            let mut file = OpenOptions::new().append(true).create(true).open(&path)?;
            // Drops a partial row left by a crash.
            let length = file.metadata()?.len();
            file.set_len(length - length % self.row_bytes() as u64)?;
            file.write_all(&bytes)
        };
        write().map_err(|source| file_error("write", &path, source))?;
        self.last = rows.last().map(|row| row.level.first).or(self.last);
        Ok(())
    }

    /// The levels of the seconds that start from one time to another, in order.
    pub fn read(&self, from_ns: i64, to_ns: i64) -> Result<Vec<TimedLevel>, StoreError> {
        let mut rows = Vec::new();
        for path in [self.older(), self.newer()] {
            let mut file = match File::open(&path) {
                Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                file => io::BufReader::new(file.map_err(|source| file_error("open", &path, source))?),
            };
            let mut read = || {
                let count = file.get_ref().metadata()?.len() / self.row_bytes() as u64;
                let first = self.first_from(&mut file, count, from_ns)?;
                file.seek(SeekFrom::Start(first * self.row_bytes() as u64))?;
                for _ in first..count {
                    let row = self.row(&mut file)?;
                    if row.time_ns > to_ns {
                        break;
                    }
                    rows.push(row);
                }
                Ok(())
            };
            read().map_err(|source| file_error("read", &path, source))?;
        }
        Ok(rows)
    }

    /// Index of the first of `count` rows that is not before a time.
    fn first_from(&self, file: &mut (impl Read + Seek), count: u64, from_ns: i64) -> io::Result<u64> {
        let (mut low, mut high) = (0, count);
        while low < high {
            let middle = low.midpoint(high);
            file.seek(SeekFrom::Start(middle * self.row_bytes() as u64))?;
            if self.row(file)?.time_ns < from_ns {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        Ok(low)
    }

    fn row(&self, file: &mut impl Read) -> io::Result<TimedLevel> {
        let mut bytes = vec![0; self.row_bytes()];
        file.read_exact(&mut bytes)?;
        Ok(TimedLevel::read(&bytes))
    }

    fn row_bytes(&self) -> usize {
        TimedLevel::row_bytes(self.channels)
    }

    fn newer(&self) -> PathBuf {
        self.folder.join("levels")
    }

    fn older(&self) -> PathBuf {
        self.folder.join(OLDER_LEVELS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(second: u64) -> TimedLevel {
        let channel = |n: f32| ChannelLevel { rms: second as f32 + n, peak: 2.0 * second as f32 };
        let level = Level { first: second * 100, frames: 100, channels: vec![channel(0.0), channel(0.5)] };
        TimedLevel { time_ns: second as i64 * 1_000_000_000, level }
    }

    #[test]
    fn levels_are_read_by_time_and_written_once() {
        let folder = tempfile::tempdir().unwrap();
        let mut levels = StreamLevels::open(folder.path(), 2).unwrap();
        assert_eq!(levels.read(0, i64::MAX).unwrap(), []);
        levels.append(&[row(1), row(2)]).unwrap();
        // Killed in the middle of a row.
        let mut file = OpenOptions::new().append(true).open(levels.newer()).unwrap();
        file.write_all(&[1, 2, 3]).unwrap();
        let mut levels = StreamLevels::open(folder.path(), 2).unwrap();
        levels.append(&[row(2), row(3), row(4)]).unwrap();
        assert_eq!(levels.read(i64::MIN, i64::MAX).unwrap(), [row(1), row(2), row(3), row(4)]);
        assert_eq!(levels.read(1_500_000_000, 3_000_000_000).unwrap(), [row(2), row(3)]);
        fs::rename(levels.newer(), levels.older()).unwrap();
        levels.append(&[row(5)]).unwrap();
        assert_eq!(levels.read(3_500_000_000, i64::MAX).unwrap(), [row(4), row(5)]);
    }
}
