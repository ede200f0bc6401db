//! The text of a CSV file on its way to the parser: its first lines, a limit on lines, spaces as separators.

use std::io::{self, Read};

use super::RecordingError;
use super::csv_head::BEGINNING_BYTES;

/// Longest line in bytes: a file without line ends must not exhaust memory.
const MAX_LINE_BYTES: usize = 1 << 20;

/// Passes text through and fails on a line that is too long, as the parser buffers whole lines.
pub(super) struct LineLimit<R> {
    reader: R,
    beginning: io::Cursor<Vec<u8>>,
    line_bytes: usize,
}

impl<R: Read> LineLimit<R> {
    pub(super) fn new(reader: R) -> Self {
        Self { reader, beginning: io::Cursor::new(Vec::new()), line_bytes: 0 }
    }

    /// Reads the first bytes, which are passed through later.
    pub(super) fn beginning(&mut self) -> Result<&[u8], RecordingError> {
        let mut beginning = Vec::new();
        self.reader.by_ref().take(BEGINNING_BYTES as u64).read_to_end(&mut beginning)?;
        self.beginning = io::Cursor::new(beginning);
        Ok(self.beginning.get_ref())
    }

    /// Skips the first lines.
    pub(super) fn skip_lines(&mut self, lines: u64) {
        let beginning = self.beginning.get_ref();
        let ends =
            beginning.iter().enumerate().filter(|(_, byte)| **byte == b'\n').map(|(at, _)| at as u64 + 1);
        let start = match lines {
            0 if beginning.starts_with(b"\xef\xbb\xbf") => 3,
            0 => 0,
            lines => ends.take(lines as usize).last().unwrap_or(0),
        };
        self.beginning.set_position(start);
    }
}

impl<R: Read> Read for LineLimit<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let mut read = self.beginning.read(buffer)?;
        if read == 0 {
            read = self.reader.read(buffer)?;
        }
        let text = &buffer[..read];
        self.line_bytes = match text.iter().rposition(|&byte| byte == b'\n') {
            Some(end) => read - end - 1,
            None => self.line_bytes + read,
        };
        if self.line_bytes > MAX_LINE_BYTES {
            let what =
                format!("a line of more than {MAX_LINE_BYTES} bytes, expected CSV with one frame a line");
            return Err(io::Error::new(io::ErrorKind::InvalidData, what));
        }
        Ok(read)
    }
}

/// Collapses spaces and tabs between fields into one space, and removes those around a line, if spaces
/// separate fields.
pub(super) struct CollapseSpaces<R> {
    reader: R,
    active: bool,
    in_line: bool,
    space: bool,
}

impl<R: Read> CollapseSpaces<R> {
    pub(super) fn new(reader: R, active: bool) -> Self {
        Self { reader, active, in_line: false, space: false }
    }
}

impl<R: Read> Read for CollapseSpaces<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if !self.active || buffer.len() < 2 {
            return self.reader.read(buffer);
        }
        // Each byte produces at most itself and one pending space before it.
        let mut raw = vec![0; buffer.len() / 2];
        loop {
            let read = self.reader.read(&mut raw)?;
            if read == 0 {
                return Ok(0);
            }
            let mut written = 0;
            for &byte in &raw[..read] {
                match byte {
                    b' ' | b'\t' => self.space = self.in_line,
                    b'\n' | b'\r' => {
                        (self.space, self.in_line) = (false, false);
                        buffer[written] = byte;
                        written += 1;
                    }
                    byte => {
                        if std::mem::take(&mut self.space) {
                            buffer[written] = b' ';
                            written += 1;
                        }
                        self.in_line = true;
                        buffer[written] = byte;
                        written += 1;
                    }
                }
            }
            if written > 0 {
                return Ok(written);
            }
        }
    }
}
