//! Detection of a recording's format from its first bytes.

use super::RecordingError;

/// Format of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// RIFF, RIFX, RF64 or BW64.
    Wav,
    /// MCAP.
    Mcap,
    /// Text, read as CSV.
    Csv,
    /// FLAC.
    Flac,
    /// A NumPy array.
    Npy,
    /// MATLAB, version 5.
    Mat,
}

/// Hint for formats that the Python package reads.
const BY_PYTHON: &str = "`flankwatch.read` of the Python package reads it, and `flankwatch-import` sends it";

/// Common formats that are not supported here: magic number, name, and how to read them instead.
const FOREIGN: [(&[u8], &str, &str); 7] = [
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file", BY_PYTHON),
    (b"MATLAB 7.3 MAT-f", "an HDF5 file (MATLAB v7.3)", BY_PYTHON),
    (b"TDSm", "a TDMS file", BY_PYTHON),
    (b"PAR1", "a Parquet file", BY_PYTHON),
    (
        b"PK\x03\x04",
        "a ZIP archive, such as .npz or .xlsx",
        "the Python package reads .npz; save .xlsx as CSV",
    ),
    (b"\xff\xfe", "text in UTF-16", "save it in UTF-8"),
    (b"\x1f\x8b", "compressed with gzip, without CSV in it", "decompress it"),
];

impl Format {
    /// Returns its name with the article.
    pub fn name(self) -> &'static str {
        match self {
            Self::Wav => "a WAV",
            Self::Mcap => "an MCAP recording",
            Self::Csv => "text",
            Self::Flac => "a FLAC recording",
            Self::Npy => "a NumPy array",
            Self::Mat => "a MATLAB file",
        }
    }

    /// Detects the format from a recording's first bytes (16 are enough), not from a file name.
    pub fn detect(beginning: &[u8]) -> Result<Self, RecordingError> {
        if beginning.is_empty() {
            return Err(RecordingError::NoBytes);
        }
        if beginning.starts_with(mcap::MAGIC) {
            return Ok(Self::Mcap);
        }
        if [b"RIFF", b"RIFX", b"RF64", b"BW64"].iter().any(|tag| beginning.starts_with(*tag)) {
            return Ok(Self::Wav);
        }
        if beginning.starts_with(super::flac::MAGIC) {
            return Ok(Self::Flac);
        }
        if beginning.starts_with(super::npy_header::MAGIC) {
            return Ok(Self::Npy);
        }
        if beginning.starts_with(super::mat::MAGIC) {
            return Ok(Self::Mat);
        }
        if is_universal_file(beginning) {
            return Err(RecordingError::Foreign { name: "a universal file (UFF)", hint: BY_PYTHON });
        }
        if let Some((_, name, hint)) = FOREIGN.iter().find(|(magic, ..)| beginning.starts_with(magic)) {
            return Err(RecordingError::Foreign { name, hint });
        }
        let beginning = &beginning[..beginning.len().min(16)];
        // Text of any code page has no control characters.
        if beginning.iter().any(|&byte| byte < b' ' && !byte.is_ascii_whitespace()) {
            return Err(RecordingError::UnknownFormat);
        }
        Ok(Self::Csv)
    }
}

/// Returns whether the first line with text is the beginning of a dataset: −1 in the first six columns.
fn is_universal_file(beginning: &[u8]) -> bool {
    let lines = beginning.split(|&byte| byte == b'\n');
    let first = lines.map(<[u8]>::trim_ascii_end).find(|line| !line.is_empty());
    first == Some(b"    -1")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_distinguished_from_binary_data() {
        assert_eq!(Format::detect(mcap::MAGIC).unwrap(), Format::Mcap);
        for beginning in [b"RF64....WAVE", b"BW64....WAVE"] {
            assert_eq!(Format::detect(beginning).unwrap(), Format::Wav);
        }
        // 15 bytes and the first half of a letter.
        assert_eq!(Format::detect("Beschleunigung ä".as_bytes()).unwrap(), Format::Csv);
        assert_eq!(Format::detect(b"\xef\xbb\xbfa;b\n").unwrap(), Format::Csv);
        assert!(matches!(Format::detect(b"\x7fELF\x02"), Err(RecordingError::UnknownFormat)));
        assert_eq!(Format::detect(b"fLaC\0\0").unwrap(), Format::Flac);
        assert_eq!(Format::detect(b"\x93NUMPY\x01\0v").unwrap(), Format::Npy);
        assert_eq!(Format::detect(b"MATLAB 5.0 MAT-file, Plat").unwrap(), Format::Mat);
        assert!(matches!(Format::detect(b""), Err(RecordingError::NoBytes)));
    }

    #[test]
    fn unsupported_formats_are_named() {
        for (beginning, name) in [
            (&b"\x89HDF\r\n\x1a\n\0\0"[..], "an HDF5 file"),
            (b"MATLAB 7.3 MAT-file, Plat", "(MATLAB v7.3)"),
            (b"TDSm\x0e\0\0\0", "a TDMS file"),
            (b"    -1\r\n    58\r\n", "a universal file"),
            (b"\r\n    -1   \r\n    58\r\n", "a universal file"),
        ] {
            let error = Format::detect(beginning).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("Python package"), "{error}");
        }
    }
}
