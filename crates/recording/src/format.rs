//! What a recording is, by its first bytes.

use super::RecordingError;

/// What the first bytes of a recording say it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// RIFF, RIFX or RF64.
    Wav,
    /// MCAP.
    Mcap,
}

impl Format {
    /// Tells the format from a recording's first bytes (16 are enough); a name's extension plays no part.
    pub fn detect(beginning: &[u8]) -> Result<Self, RecordingError> {
        if beginning.is_empty() {
            return Err(RecordingError::NoBytes);
        }
        if beginning.starts_with(mcap::MAGIC) {
            return Ok(Self::Mcap);
        }
        if [b"RIFF", b"RIFX", b"RF64"].iter().any(|tag| beginning.starts_with(*tag)) {
            return Ok(Self::Wav);
        }
        let beginning = &beginning[..beginning.len().min(16)];
        let text = match std::str::from_utf8(beginning) {
            // The last character may be cut through.
            Err(error) if error.error_len().is_none() => std::str::from_utf8(&beginning[..error.valid_up_to()]),
            whole => whole,
        };
        match text {
            Ok(text) if !text.chars().any(|c| c.is_control() && !c.is_whitespace()) => Err(RecordingError::Text {
                beginning: text.to_owned(),
            }),
            _ => {
                let hex: Vec<String> = beginning.iter().map(|byte| format!("{byte:02x}")).collect();
                Err(RecordingError::UnknownFormat { beginning: hex.join(" ") })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_told_from_other_bytes() {
        assert_eq!(Format::detect(mcap::MAGIC).unwrap(), Format::Mcap);
        assert_eq!(Format::detect(b"RF64....WAVE").unwrap(), Format::Wav);
        // 15 bytes and the first half of a letter.
        assert!(matches!(
            Format::detect("Beschleunigung ä".as_bytes()),
            Err(RecordingError::Text { .. })
        ));
        assert!(matches!(Format::detect(b"\xef\xbb\xbfa;b\n"), Err(RecordingError::Text { .. })));
        assert!(matches!(Format::detect(b"\x7fELF\x02"), Err(RecordingError::UnknownFormat { .. })));
        assert!(matches!(Format::detect(b""), Err(RecordingError::NoBytes)));
    }
}
