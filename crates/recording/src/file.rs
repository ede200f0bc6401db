//! A recording file of any format.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use flate2::read::MultiGzDecoder;
use jiff::Timestamp;

use super::mat::MAX_BYTES;
use super::mat_variables::invalid;
use super::{
    BlockEncoding, CsvFrames, CsvTiming, Cut, FlacFrames, Format, Frames, FramesInfo, MatFrames, McapReader,
    NpyFrames, RecordBlocks, RecordDefaults, Recorded, RecordingError, TimedCsvFrames, WavFrames,
    encode_block,
};

/// File name extensions of the supported formats.
pub const EXTENSIONS: [&str; 7] = [".wav", ".flac", ".mcap", ".csv", ".csv.gz", ".mat", ".npy"];

/// Magic number of gzip.
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// The records of a WAV, FLAC, MCAP, CSV, MATLAB (v5) or NumPy file, read on demand.
///
/// A file of up to 2 minutes (and 4 194 304 samples) is one record per channel. A longer one is cut into
/// records of 10 s, or as given by `cut`; a remainder of less than half a record is dropped. MCAP records are
/// returned as recorded.
pub struct RecordingFile {
    records: Records,
    read: Arc<AtomicU64>,
    /// Names of the channels to return; empty for all.
    channels: Vec<String>,
    /// Those of them that no record has had yet.
    missing: Vec<String>,
    /// All channels that records had so far, if some were named.
    found: BTreeSet<String>,
}

enum Records {
    Mcap(Box<McapReader>),
    Cut(Box<RecordBlocks<FileFrames>>),
}

/// The frames of a WAV, FLAC, CSV, MATLAB (v5) or NumPy file. CSV may be compressed with gzip; it is read
/// twice, first for its timing. A MATLAB file is read into memory.
pub struct FileFrames {
    frames: Box<dyn Frames + Send>,
    format: Format,
    read: Arc<AtomicU64>,
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

impl Seek for CountedFile {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        self.file.seek(position)
    }
}

impl RecordingFile {
    /// Opens a file and reads its header.
    ///
    /// # Errors
    /// The file cannot be read, is in no supported format, or is damaged; neither it nor the defaults give
    /// the sampling rate; the cut is invalid; the defaults have a scale or a sensitivity for MCAP.
    pub fn open(
        path: impl AsRef<Path>,
        defaults: RecordDefaults,
        cut: Option<Cut>,
    ) -> Result<Self, RecordingError> {
        Self::open_channels(path, &[], defaults, cut)
    }

    /// Opens a file as [`open`](Self::open) does, for the records of the channels with these names; all if
    /// none is named.
    ///
    /// # Errors
    /// Those of `open`; after the last record, a name that no record had.
    pub fn open_channels(
        path: impl AsRef<Path>,
        channels: &[String],
        defaults: RecordDefaults,
        cut: Option<Cut>,
    ) -> Result<Self, RecordingError> {
        let read = Arc::new(AtomicU64::new(0));
        let file = OpenFile::new(path.as_ref())?;
        // The columns of a CSV file are chosen as it is read, also by names that the records do not have.
        let channels_of_file = if file.format == Format::Csv { channels } else { &[] };
        let channels = if file.format == Format::Csv { Vec::new() } else { channels.to_vec() };
        let records = match file.format {
            Format::Mcap if defaults.scale.or(defaults.sensitivity_mv_per_g).is_some() => {
                let expected = "none: the samples of an MCAP recording are in their unit";
                return Err(RecordingError::field("a scale or a sensitivity", "given", expected));
            }
            Format::Mcap => Records::Mcap(Box::new(McapReader::with_defaults(file.counted(&read), defaults))),
            _ => {
                let blocks = RecordBlocks::new(file.frames(channels_of_file, &read)?, &defaults, cut)?;
                Records::Cut(Box::new(blocks))
            }
        };
        Ok(Self { records, read, missing: channels.clone(), channels, found: BTreeSet::new() })
    }

    /// Returns whether a file's name ends in one of the [`EXTENSIONS`].
    pub fn has_extension(path: &Path) -> bool {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        EXTENSIONS.iter().any(|extension| name.ends_with(extension))
    }

    /// Returns the number of bytes of the file read so far.
    pub fn bytes_read(&self) -> u64 {
        self.read.load(Ordering::Relaxed)
    }

    /// Returns whether the file is MCAP, whose records state their own values.
    pub fn is_mcap(&self) -> bool {
        matches!(self.records, Records::Mcap(_))
    }

    /// Returns the sampling rate in hertz that a WAV or FLAC header states, which a given one overrides.
    pub fn header_rate_hz(&self) -> Option<f64> {
        let Records::Cut(blocks) = &self.records else { return None };
        let frames = blocks.frames();
        let has_header = matches!(frames.format, Format::Wav | Format::Flac);
        let info = has_header.then(|| frames.frames.info(&RecordDefaults::default()))?;
        info.ok().map(|info| info.sample_rate_hz)
    }

    /// Returns the time after the last sample read so far, which may belong to a dropped remainder; `None`
    /// for MCAP.
    pub fn end_time(&self) -> Option<Timestamp> {
        match &self.records {
            Records::Cut(blocks) => Some(blocks.end_time()),
            Records::Mcap(_) => None,
        }
    }

    /// Returns the length in seconds of the records if a long file is cut by default.
    pub fn default_cut_seconds(&self) -> Option<f64> {
        match &self.records {
            Records::Cut(blocks) => blocks.default_cut_seconds(),
            Records::Mcap(_) => None,
        }
    }
}

impl FileFrames {
    /// Opens a file and reads its header. `channels` names the columns of a CSV file to read, in order; if
    /// empty, all columns with samples are read. Of other formats, all channels are read.
    ///
    /// # Errors
    /// The file cannot be read, is in no supported format or an MCAP file, or is damaged.
    pub fn open(path: impl AsRef<Path>, channels: &[String]) -> Result<Self, RecordingError> {
        OpenFile::new(path.as_ref())?.frames(channels, &Arc::default())
    }

    /// Returns the number of bytes of the file read so far.
    pub fn bytes_read(&self) -> u64 {
        self.read.load(Ordering::Relaxed)
    }

    /// Returns the file's format.
    pub fn format(&self) -> Format {
        self.format
    }
}

impl Frames for FileFrames {
    /// A given rate overrides that of a WAV or FLAC header.
    fn info(&self, defaults: &RecordDefaults) -> Result<FramesInfo, RecordingError> {
        let info = self.frames.info(defaults)?;
        let given = defaults.sample_rate_hz.filter(|_| matches!(self.format, Format::Wav | Format::Flac));
        Ok(FramesInfo { sample_rate_hz: given.unwrap_or(info.sample_rate_hz), ..info })
    }

    fn next_frame(&mut self, frame: &mut [f32]) -> Result<bool, RecordingError> {
        self.frames.next_frame(frame)
    }
}

/// Endings of files that are no text.
const BINARY_ENDINGS: [&str; 5] = ["wav", "flac", "mcap", "npy", "mat"];

/// A file whose format is known, at its beginning.
struct OpenFile {
    file: File,
    bytes: u64,
    format: Format,
    /// Whether the file is compressed with gzip.
    zipped: bool,
}

impl OpenFile {
    fn new(path: &Path) -> Result<Self, RecordingError> {
        let cannot_open = |source| RecordingError::Open { path: path.to_owned(), source };
        let mut file = File::open(path).map_err(cannot_open)?;
        let bytes = file.metadata().map_err(cannot_open)?.len();
        let mut beginning = Vec::new();
        file.by_ref().take(16).read_to_end(&mut beginning).map_err(cannot_open)?;
        file.seek(SeekFrom::Start(0)).map_err(|source| match source.kind() {
            io::ErrorKind::NotSeekable => {
                cannot_open(io::Error::other("a pipe cannot be read, expected a file: save it to one first"))
            }
            _ => cannot_open(source),
        })?;
        let zipped = beginning.starts_with(&GZIP) && has_zipped_csv(&mut file)?;
        let format = if zipped { Format::Csv } else { Format::detect(&beginning)? };
        let ending = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        if format == Format::Csv && BINARY_ENDINGS.contains(&ending.as_str()) {
            return Err(RecordingError::Text { ending });
        }
        Ok(Self { file, bytes, format, zipped })
    }

    fn counted(self, read: &Arc<AtomicU64>) -> CountedFile {
        CountedFile { file: BufReader::with_capacity(1 << 16, self.file), read: read.clone() }
    }

    fn frames(mut self, channels: &[String], read: &Arc<AtomicU64>) -> Result<FileFrames, RecordingError> {
        let format = self.format;
        let frames: Box<dyn Frames + Send> = match format {
            Format::Wav => {
                let bytes = self.bytes;
                Box::new(WavFrames::new(self.counted(read), bytes)?)
            }
            Format::Csv => {
                let zipped = self.zipped;
                let first_pass = BufReader::new(unzipped(&mut self.file, zipped));
                let timing = CsvTiming::scan(CsvFrames::new(first_pass, channels)?)?;
                self.file.seek(SeekFrom::Start(0))?;
                let reader = BufReader::new(unzipped(self.counted(read), zipped));
                Box::new(TimedCsvFrames::new(CsvFrames::new(reader, channels)?, timing))
            }
            Format::Flac => Box::new(FlacFrames::new(self.counted(read))?),
            Format::Npy => Box::new(NpyFrames::new(self.counted(read))?),
            Format::Mat => {
                check_mat_size(self.bytes)?;
                Box::new(mat_frames(self.counted(read))?)
            }
            Format::Mcap => {
                return Err(RecordingError::field(
                    "format",
                    "MCAP",
                    "WAV, CSV, FLAC, NPY or MAT: an MCAP recording already consists of records",
                ));
            }
        };
        Ok(FileFrames { frames, format, read: Arc::clone(read) })
    }
}

/// Rejects a MATLAB file that is too large for memory.
fn check_mat_size(bytes: u64) -> Result<(), RecordingError> {
    if bytes > MAX_BYTES {
        let expected = format!("at most {MAX_BYTES} bytes: split the file into several");
        return Err(invalid("size", format!("{bytes} bytes"), expected));
    }
    Ok(())
}

/// Reads a whole MATLAB file.
fn mat_frames(reader: CountedFile) -> Result<MatFrames, RecordingError> {
    let mut bytes = Vec::new();
    reader.take(MAX_BYTES).read_to_end(&mut bytes)?;
    MatFrames::new(&bytes)
}

/// Returns whether a gzip file contains CSV. Rewinds the file. An invalid one is rejected later by its first
/// bytes.
fn has_zipped_csv(file: &mut File) -> Result<bool, RecordingError> {
    let mut inner = Vec::new();
    let read = MultiGzDecoder::new(&mut *file).take(16).read_to_end(&mut inner);
    file.seek(SeekFrom::Start(0))?;
    Ok(read.is_ok() && matches!(Format::detect(&inner), Ok(Format::Csv)))
}

fn unzipped<'a, R: Read + Send + 'a>(reader: R, zipped: bool) -> Box<dyn Read + Send + 'a> {
    if zipped { Box::new(MultiGzDecoder::new(reader)) } else { Box::new(reader) }
}

impl Iterator for RecordingFile {
    type Item = Result<Recorded, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let Some(recorded) = self.records.next() else {
                let name = self.missing.pop()?;
                let names: Vec<&str> = self.found.iter().map(String::as_str).collect();
                let expected = format!("names of channels in the recording: {}", names.join(", "));
                return Some(Err(RecordingError::field("channel", format!("{name:?}"), expected)));
            };
            let Ok(Recorded { record, .. }) = &recorded else { return Some(recorded) };
            self.missing.retain(|name| name != record.channel());
            if !self.channels.is_empty() && !self.found.contains(record.channel()) {
                self.found.insert(record.channel().to_owned());
            }
            if self.channels.is_empty() || self.channels.iter().any(|name| name == record.channel()) {
                return Some(recorded);
            }
        }
    }
}

impl Iterator for Records {
    type Item = Result<Recorded, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        let record = match self {
            Self::Mcap(reader) => return reader.next(),
            Self::Cut(blocks) => blocks.next()?,
        };
        Some(record.map(|record| Recorded {
            raw: encode_block(&record, BlockEncoding::Protobuf),
            record,
            encoding: BlockEncoding::Protobuf,
            reference_wear_um: None,
        }))
    }
}
