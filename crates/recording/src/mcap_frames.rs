//! The records of an MCAP file in order, including those in chunks, in bounded memory and with their byte
//! positions.

use std::io::{self, Read};

use mcap::MAGIC;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::RecordingError;
use super::mcap_record::{check_chunk, opcode};

/// Longest record and chunk in bytes: the longest waveform plus a margin.
const MAX_RECORD_BYTES: usize = 80 << 20;

/// Longest record of other types, in bytes.
const MAX_SMALL_RECORD_BYTES: usize = 8 << 20;

/// Number of bytes read at a time, so that memory grows with the available bytes and not with the declared
/// length.
const READ_BYTES: usize = 1 << 16;

/// Iterates over the records of an MCAP file up to the end of its data. Records that are not needed (indexes,
/// attachments) are skipped.
pub(crate) struct McapFrames {
    reader: Box<dyn Read + Send>,
    position: u64,
    record_start: u64,
    started: bool,
    ended: bool,
    record: Vec<u8>,
    /// Decodes chunks; receives whole chunk records.
    decoder: LinearReader,
    /// Number of bytes of the chunk in `record` passed to the decoder; `None` outside a chunk.
    fed: Option<usize>,
}

impl McapFrames {
    pub(crate) fn new(reader: impl Read + Send + 'static) -> Self {
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            // A chunk is validated before any of it is used.
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(MAX_RECORD_BYTES);
        Self {
            reader: Box::new(reader),
            position: 0,
            record_start: 0,
            started: false,
            ended: false,
            record: Vec::new(),
            decoder: LinearReader::new_with_options(options),
            fed: None,
        }
    }

    /// Returns the position of the latest record (of its chunk, if it is in one).
    pub(crate) fn record_start(&self) -> u64 {
        self.record_start
    }

    /// Passes the next record's opcode and bytes to `handle`. Returns `None` at the end of the data and after
    /// an error.
    pub(crate) fn next_record<T>(
        &mut self,
        handle: impl FnOnce(u8, &[u8]) -> T,
    ) -> Result<Option<T>, RecordingError> {
        if self.ended {
            return Ok(None);
        }
        let result = self.advance(handle);
        self.ended = !matches!(result, Ok(Some(_)));
        result
    }

    fn advance<T>(&mut self, handle: impl FnOnce(u8, &[u8]) -> T) -> Result<Option<T>, RecordingError> {
        if !self.started {
            self.started = true;
            let mut magic = [0; MAGIC.len()];
            self.fill(&mut magic, "the file's first bytes")?;
            if magic != MAGIC {
                return Err(self.damaged("the file's first bytes are not those of MCAP".to_owned()));
            }
        }
        loop {
            if let Some(fed) = &mut self.fed {
                match self.decoder.next_event() {
                    Some(Ok(LinearReadEvent::ReadRequest(wanted))) => {
                        let rest = &self.record[*fed..];
                        if rest.is_empty() {
                            self.fed = None;
                            continue;
                        }
                        let piece = &rest[..wanted.min(rest.len()).min(READ_BYTES)];
                        self.decoder.insert(piece.len()).copy_from_slice(piece);
                        self.decoder.notify_read(piece.len());
                        *fed += piece.len();
                    }
                    Some(Ok(LinearReadEvent::Record { opcode, data })) => {
                        return Ok(Some(handle(opcode, data)));
                    }
                    Some(Err(source)) => {
                        return Err(RecordingError::Mcap { byte: self.record_start, source });
                    }
                    None => self.fed = None,
                }
                continue;
            }
            self.record_start = self.position;
            let mut head = [0; 9];
            self.fill(&mut head, "the data: there is no data end record")?;
            let [code, length @ ..] = head;
            let length = u64::from_le_bytes(length);
            let limit = match code {
                opcode::DATA_END | opcode::FOOTER => return Ok(None),
                opcode::CHUNK | opcode::MESSAGE => MAX_RECORD_BYTES,
                opcode::SCHEMA | opcode::CHANNEL | opcode::METADATA => MAX_SMALL_RECORD_BYTES,
                _ => {
                    self.skip(length)?;
                    continue;
                }
            };
            self.load(length, limit)?;
            if code != opcode::CHUNK {
                return Ok(Some(handle(code, &self.record)));
            }
            check_chunk(&self.record, MAX_RECORD_BYTES).map_err(|what| self.damaged(what))?;
            self.decoder.insert(head.len()).copy_from_slice(&head);
            self.decoder.notify_read(head.len());
            self.fed = Some(0);
        }
    }

    /// Reads a record's body; memory grows with the available bytes.
    fn load(&mut self, length: u64, limit: usize) -> Result<(), RecordingError> {
        if length > limit as u64 {
            return Err(self.damaged(format!("a record declares {length} bytes, expected at most {limit}")));
        }
        self.record.clear();
        while (self.record.len() as u64) < length {
            // At most doubles the buffer, and never exceeds the declared length.
            let read_so_far = self.record.len();
            let piece = (length - read_so_far as u64).min(read_so_far.max(READ_BYTES) as u64);
            self.record.reserve_exact(piece as usize);
            let read = self.reader.by_ref().take(piece).read_to_end(&mut self.record)? as u64;
            self.position += read;
            if read < piece {
                return Err(self.ends("a record"));
            }
        }
        Ok(())
    }

    fn skip(&mut self, length: u64) -> Result<(), RecordingError> {
        let skipped = io::copy(&mut self.reader.by_ref().take(length), &mut io::sink())?;
        self.position += skipped;
        if skipped < length {
            return Err(self.ends("a record"));
        }
        Ok(())
    }

    fn fill(&mut self, bytes: &mut [u8], part: &'static str) -> Result<(), RecordingError> {
        let mut filled = 0;
        while filled < bytes.len() {
            match self.reader.read(&mut bytes[filled..]) {
                Ok(0) => return Err(self.ends(part)),
                Ok(n) => {
                    filled += n;
                    self.position += n as u64;
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    fn damaged(&self, what: String) -> RecordingError {
        RecordingError::McapDamaged { byte: self.record_start, what }
    }

    fn ends(&self, part: &'static str) -> RecordingError {
        RecordingError::McapEnds { byte: self.position, part }
    }
}
