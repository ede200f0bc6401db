//! A recording in a file, whatever its format.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::wav::WavBlocks;
use super::{BlockEncoding, Cut, Format, McapReader, RecordDefaults, Recorded, RecordingError, encode_block};

/// The records of a WAV or MCAP file, read as they are asked for.
///
/// A WAV up to 2 minutes (and 4 194 304 samples) is one record a channel; a longer one is cut into records of 10 s, or as `cut` says, where a
/// rest of less than half a record is left out. MCAP records come as they were recorded.
pub struct RecordingFile {
    records: Records,
    read: Arc<AtomicU64>,
}

enum Records {
    Wav(Box<WavBlocks<CountedFile>>),
    Mcap(Box<McapReader>),
}

/// A file that says how far it has been read.
struct CountedFile {
    file: BufReader<File>,
    read: Arc<AtomicU64>,
}

impl Read for CountedFile {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read(buffer)?;
        self.read.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }
}

impl RecordingFile {
    /// Opens a file and reads its header.
    pub fn open(path: impl AsRef<Path>, defaults: RecordDefaults, cut: Option<Cut>) -> Result<Self, RecordingError> {
        let path = path.as_ref();
        let cannot_open = |source| RecordingError::Open {
            path: path.to_owned(),
            source,
        };
        let mut file = File::open(path).map_err(cannot_open)?;
        let bytes = file.metadata().map_err(cannot_open)?.len();
        let mut beginning = Vec::new();
        file.by_ref().take(16).read_to_end(&mut beginning).map_err(cannot_open)?;
        file.seek(SeekFrom::Start(0)).map_err(cannot_open)?;
        let read = Arc::new(AtomicU64::new(0));
        let reader = CountedFile {
            file: BufReader::with_capacity(1 << 16, file),
            read: read.clone(),
        };
        let records = match Format::detect(&beginning)? {
            Format::Wav => Records::Wav(Box::new(WavBlocks::new(reader, bytes, &defaults, cut)?)),
            Format::Mcap => Records::Mcap(Box::new(McapReader::with_defaults(reader, defaults))),
        };
        Ok(Self { records, read })
    }

    /// Bytes of the file read so far.
    pub fn bytes_read(&self) -> u64 {
        self.read.load(Ordering::Relaxed)
    }

    /// The file's format.
    pub fn format(&self) -> Format {
        match self.records {
            Records::Wav(_) => Format::Wav,
            Records::Mcap(_) => Format::Mcap,
        }
    }

    /// Length in seconds of the records into which a long WAV is cut without having been asked to; none where it is not.
    pub fn default_cut_seconds(&self) -> Option<f64> {
        match &self.records {
            Records::Wav(blocks) => blocks.default_cut_seconds(),
            Records::Mcap(_) => None,
        }
    }
}

impl Iterator for RecordingFile {
    type Item = Result<Recorded, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        match &mut self.records {
            Records::Mcap(reader) => reader.next(),
            Records::Wav(blocks) => Some(blocks.next()?.map(|record| Recorded {
                raw: encode_block(&record, BlockEncoding::Protobuf),
                record,
                encoding: BlockEncoding::Protobuf,
                reference_wear_um: None,
            })),
        }
    }
}
