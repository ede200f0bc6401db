//! A recording file of any format.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use flate2::read::MultiGzDecoder;

use super::flac::FlacBlocks;
use super::mat::{MAX_BYTES, MatBlocks, MatFrames};
use super::npy::NpyBlocks;
use super::wav::WavBlocks;
use super::{
    BlockEncoding, CsvBlocks, CsvFrames, CsvTiming, Cut, Format, McapReader, RecordDefaults, Recorded,
    RecordingError, encode_block,
};

/// Magic number of gzip.
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// The records of a WAV, FLAC, MCAP, CSV, MATLAB (v5) or NumPy file, read on demand. CSV may be compressed
/// with gzip; it is read twice, first for its timing. A MATLAB file is read into memory.
///
/// A file of up to 2 minutes (and 4 194 304 samples) is one record per channel. A longer one is cut into
/// records of 10 s, or as given by `cut`; a remainder of less than half a record is dropped. MCAP records are
/// returned as recorded.
pub struct RecordingFile {
    records: Records,
    read: Arc<AtomicU64>,
}

enum Records {
    Wav(Box<WavBlocks<CountedFile>>),
    Mcap(Box<McapReader>),
    Csv(Box<CsvBlocks<Box<dyn Read + Send>>>),
    Flac(Box<FlacBlocks<CountedFile>>),
    Npy(Box<NpyBlocks<CountedFile>>),
    Mat(Box<MatBlocks>),
}

/// A file that counts the bytes read.
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
    pub fn open(
        path: impl AsRef<Path>,
        defaults: RecordDefaults,
        cut: Option<Cut>,
    ) -> Result<Self, RecordingError> {
        let path = path.as_ref();
        let cannot_open = |source| RecordingError::Open { path: path.to_owned(), source };
        let mut file = File::open(path).map_err(cannot_open)?;
        let bytes = file.metadata().map_err(cannot_open)?.len();
        let mut beginning = Vec::new();
        file.by_ref().take(16).read_to_end(&mut beginning).map_err(cannot_open)?;
        file.seek(SeekFrom::Start(0)).map_err(cannot_open)?;
        let read = Arc::new(AtomicU64::new(0));
        if let Some(zipped) = csv_of(&mut file, &beginning)? {
            let timing = CsvTiming::scan(CsvFrames::new(BufReader::new(unzipped(&mut file, zipped)), &[])?)?;
            file.seek(SeekFrom::Start(0))?;
            let counted = CountedFile { file: BufReader::with_capacity(1 << 16, file), read: read.clone() };
            let frames = CsvFrames::new(
                Box::new(BufReader::new(unzipped(counted, zipped))) as Box<dyn Read + Send>,
                &[],
            )?;
            let records = Records::Csv(Box::new(CsvBlocks::new(frames, &timing, &defaults, cut)?));
            return Ok(Self { records, read });
        }
        let reader = CountedFile { file: BufReader::with_capacity(1 << 16, file), read: read.clone() };
        let records = match Format::detect(&beginning)? {
            Format::Csv | Format::Wav => {
                Records::Wav(Box::new(WavBlocks::new(reader, bytes, &defaults, cut)?))
            }
            Format::Flac => Records::Flac(Box::new(FlacBlocks::new(reader, &defaults, cut)?)),
            Format::Npy => Records::Npy(Box::new(NpyBlocks::new(reader, &defaults, cut)?)),
            Format::Mat => Records::Mat(Box::new(MatBlocks::new(mat_frames(reader)?, &defaults, cut)?)),
            Format::Mcap => Records::Mcap(Box::new(McapReader::with_defaults(reader, defaults))),
        };
        Ok(Self { records, read })
    }

    /// Returns the number of bytes of the file read so far.
    pub fn bytes_read(&self) -> u64 {
        self.read.load(Ordering::Relaxed)
    }

    /// Returns the file's format.
    pub fn format(&self) -> Format {
        match self.records {
            Records::Wav(_) => Format::Wav,
            Records::Mcap(_) => Format::Mcap,
            Records::Csv(_) => Format::Csv,
            Records::Flac(_) => Format::Flac,
            Records::Npy(_) => Format::Npy,
            Records::Mat(_) => Format::Mat,
        }
    }

    /// Returns the length in seconds of the records if a long file is cut by default.
    pub fn default_cut_seconds(&self) -> Option<f64> {
        match &self.records {
            Records::Wav(blocks) => blocks.default_cut_seconds(),
            Records::Csv(blocks) => blocks.default_cut_seconds(),
            Records::Flac(blocks) => blocks.default_cut_seconds(),
            Records::Npy(blocks) => blocks.default_cut_seconds(),
            Records::Mat(blocks) => blocks.default_cut_seconds(),
            Records::Mcap(_) => None,
        }
    }
}

/// Reads a whole MATLAB file.
fn mat_frames(reader: CountedFile) -> Result<MatFrames, RecordingError> {
    let mut bytes = Vec::new();
    reader.take(MAX_BYTES).read_to_end(&mut bytes)?;
    MatFrames::new(&bytes)
}

/// Returns whether a CSV file is compressed, or `None` if it is not CSV. Rewinds the file.
fn csv_of(file: &mut File, beginning: &[u8]) -> Result<Option<bool>, RecordingError> {
    if !beginning.starts_with(&GZIP) {
        return Ok(matches!(Format::detect(beginning), Ok(Format::Csv)).then_some(false));
    }
    let mut inner = Vec::new();
    // An invalid gzip file is rejected later by its first bytes.
    let read = MultiGzDecoder::new(&mut *file).take(16).read_to_end(&mut inner);
    file.seek(SeekFrom::Start(0))?;
    Ok((read.is_ok() && matches!(Format::detect(&inner), Ok(Format::Csv))).then_some(true))
}

fn unzipped<'a, R: Read + Send + 'a>(reader: R, zipped: bool) -> Box<dyn Read + Send + 'a> {
    if zipped { Box::new(MultiGzDecoder::new(reader)) } else { Box::new(reader) }
}

impl Iterator for RecordingFile {
    type Item = Result<Recorded, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        let record = match &mut self.records {
            Records::Mcap(reader) => return reader.next(),
            Records::Wav(blocks) => blocks.next()?,
            Records::Csv(blocks) => blocks.next()?,
            Records::Flac(blocks) => blocks.next()?,
            Records::Npy(blocks) => blocks.next()?,
            Records::Mat(blocks) => blocks.next()?,
        };
        Some(record.map(|record| Recorded {
            raw: encode_block(&record, BlockEncoding::Protobuf),
            record,
            encoding: BlockEncoding::Protobuf,
            reference_wear_um: None,
        }))
    }
}
