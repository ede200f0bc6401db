//! NumPy arrays (.npy): the samples of one channel, or one row of samples per time step.
//!
//! Values are used unchanged, including integers; `scale` of [`RecordDefaults`] converts them. The array has
//! neither rate nor time; the defaults give both. The rows may be stored one after the other, or the columns
//! (Fortran order), of which a piece each is read at a time.

use std::io::{Cursor, Read, Seek, SeekFrom};

use super::npy_header::{NpyHeader, npy};
use super::{Frames, FramesInfo, RecordBlocks, RecordDefaults, RecordingError};
use flankwatch_signal::Record;

/// Largest number of frames read at once.
const FRAMES_PER_READ: u64 = 4096;

/// Reads a NumPy array as one record per channel; the sampling rate is that of the defaults.
///
/// # Errors
/// The array is damaged, not one of real numbers, or longer than a record may be; there is no rate.
pub fn decode_npy(bytes: &[u8], defaults: &RecordDefaults) -> Result<Vec<Record>, RecordingError> {
    if bytes.is_empty() {
        return Err(RecordingError::NoBytes);
    }
    RecordBlocks::whole(NpyFrames::new(Cursor::new(bytes))?, defaults)?.collect()
}

/// The frames of a NumPy array, read on demand.
#[derive(Debug)]
pub struct NpyFrames<R> {
    reader: R,
    header: NpyHeader,
    /// Position of the first value in the file.
    data: u64,
    /// Frames read so far, including those in the buffer.
    read: u64,
    /// Values of the latest frames, in the order of the file.
    buffer: Vec<u8>,
    /// Frames in the buffer, and the next one to return.
    buffered: usize,
    next: usize,
}

impl<R: Read + Seek> NpyFrames<R> {
    /// Reads the header of the array.
    ///
    /// # Errors
    /// The header is damaged, the array is not one of real numbers in one or two dimensions or, in Fortran
    /// order, is not complete, or reading fails.
    pub fn new(mut reader: R) -> Result<Self, RecordingError> {
        let header = NpyHeader::read(&mut reader)?;
        let data = reader.stream_position()?;
        if header.is_by_column {
            // The first frames need the last column.
            let there = reader.seek(SeekFrom::End(0))?.saturating_sub(data);
            let frames = there / header.frame_bytes() as u64;
            if frames < header.frames {
                return Err(incomplete(header.frames, frames));
            }
        }
        Ok(Self { reader, header, data, read: 0, buffer: Vec::new(), buffered: 0, next: 0 })
    }

    fn fill(&mut self) -> Result<(), RecordingError> {
        let header = &self.header;
        let frames = FRAMES_PER_READ.min(header.frames - self.read);
        let wanted = frames as usize * header.frame_bytes();
        self.buffer.clear();
        (self.buffered, self.next) = (frames as usize, 0);
        if header.is_by_column {
            let width = header.number.bytes() as u64;
            for column in 0..header.channels as u64 {
                let first = column * header.frames + self.read;
                self.reader.seek(SeekFrom::Start(self.data + first * width))?;
                self.reader.by_ref().take(frames * width).read_to_end(&mut self.buffer)?;
            }
        } else {
            self.reader.by_ref().take(wanted as u64).read_to_end(&mut self.buffer)?;
        }
        if self.buffer.len() < wanted {
            let there = self.read + (self.buffer.len() / header.frame_bytes()) as u64;
            return Err(incomplete(header.frames, there));
        }
        self.read += frames;
        Ok(())
    }
}

fn incomplete(frames: u64, there: u64) -> RecordingError {
    let what = format!("{frames} frames, but {there} are there");
    npy("shape", what, "as many frames as the file holds")
}

impl<R: Read + Seek> Frames for NpyFrames<R> {
    fn info(&self, defaults: &RecordDefaults) -> Result<FramesInfo, RecordingError> {
        let rate_hz = defaults.sample_rate_hz.ok_or_else(|| {
            let expected = "a rate in hertz, as a NumPy array does not contain it";
            RecordingError::field("sample rate", "missing", expected)
        })?;
        let names = defaults.names_of(self.header.channels);
        Ok(FramesInfo::without_time(names, rate_hz, self.header.frames, defaults))
    }

    fn next_frame(&mut self, frame: &mut [f32]) -> Result<bool, RecordingError> {
        if self.next == self.buffered {
            self.fill()?;
            if self.buffered == 0 {
                return Ok(false);
            }
        }
        let NpyHeader { number, big_endian, channels, is_by_column, .. } = self.header;
        let width = number.bytes();
        for (channel, sample) in frame.iter_mut().enumerate() {
            let at = if is_by_column {
                channel * self.buffered + self.next
            } else {
                self.next * channels + channel
            };
            let bytes = &mut self.buffer[at * width..(at + 1) * width];
            if big_endian {
                bytes.reverse();
            }
            *sample = number.value(bytes) as f32;
        }
        self.next += 1;
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::super::npy_header::MAGIC;
    use super::*;

    /// A file as NumPy writes it.
    fn file(description: &str, data: &[u8]) -> Vec<u8> {
        let text = format!("{description:<117}\n");
        let mut bytes = [MAGIC, &[1, 0], &(text.len() as u16).to_le_bytes()].concat();
        bytes.extend_from_slice(text.as_bytes());
        bytes.extend_from_slice(data);
        bytes
    }

    fn array(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        file(&format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}"), data)
    }

    fn by_column(shape: &str, data: &[u8]) -> Vec<u8> {
        file(&format!("{{'descr': '<i2', 'fortran_order': True, 'shape': {shape}, }}"), data)
    }

    fn read(bytes: &[u8], scale: Option<f64>) -> Result<Vec<Record>, String> {
        let defaults = RecordDefaults { sample_rate_hz: Some(100.0), scale, ..RecordDefaults::default() };
        let blocks =
            NpyFrames::new(Cursor::new(bytes)).and_then(|frames| RecordBlocks::new(frames, &defaults, None));
        blocks.and_then(Iterator::collect).map_err(|error| error.to_string())
    }

    fn only(bytes: &[u8]) -> Vec<f32> {
        let records = read(bytes, None).unwrap();
        assert_eq!(records.len(), 1);
        records[0].samples().to_vec()
    }

    #[test]
    fn numbers_of_every_type_are_read() {
        let bytes = |values: &[&[u8]]| values.concat();
        let le = bytes(&[&1.5_f32.to_le_bytes(), &(-2.0_f32).to_le_bytes()]);
        assert_eq!(only(&array("<f4", "(2,)", &le)), [1.5, -2.0]);
        let be = bytes(&[&1.5_f64.to_be_bytes(), &(-2.0_f64).to_be_bytes()]);
        assert_eq!(only(&array(">f8", "(2,)", &be)), [1.5, -2.0]);
        assert_eq!(only(&array("|i1", "(2,)", &[0x80, 0x7f])), [-128.0, 127.0]);
        assert_eq!(only(&array("|u1", "(2,)", &[0x80, 0x7f])), [128.0, 127.0]);
        assert_eq!(only(&array(">i2", "(2,)", &[0x80, 0, 0, 1])), [-32768.0, 1.0]);
        assert_eq!(only(&array("<u2", "(2,)", &[0, 0x80, 1, 0])), [32768.0, 1.0]);
        assert_eq!(only(&array("<i4", "(1,)", &(-70_000_i32).to_le_bytes())), [-70_000.0]);
        assert_eq!(only(&array("<u4", "(1,)", &70_000_u32.to_le_bytes())), [70_000.0]);
    }

    #[test]
    fn rows_are_time_steps_and_columns_are_channels() {
        let data: Vec<u8> = [1_i16, 10, 2, 20, 3, 30].iter().flat_map(|value| value.to_le_bytes()).collect();
        let records = read(&array("<i2", "(3, 2)", &data), Some(0.5)).unwrap();
        assert_eq!((records[0].channel(), records[0].samples()), ("1", &[0.5, 1.0, 1.5][..]));
        assert_eq!((records[1].channel(), records[1].samples()), ("2", &[5.0, 10.0, 15.0][..]));
    }

    #[test]
    fn columns_one_after_the_other_are_read_like_rows() {
        // More frames than are read at once.
        let value = |frame: usize, channel: usize| (frame * 3 + channel) as i16;
        let order: Vec<(usize, usize)> = (0..3).flat_map(|c| (0..10_000).map(move |k| (k, c))).collect();
        let data: Vec<u8> = order.iter().flat_map(|&(k, c)| value(k, c).to_le_bytes()).collect();
        let rows: Vec<u8> =
            (0..10_000).flat_map(|k| (0..3).flat_map(move |c| value(k, c).to_le_bytes())).collect();
        let shape = "(10000, 3)";
        let expected = read(&array("<i2", shape, &rows), None).unwrap();
        assert_eq!(expected.len(), 3);
        assert_eq!(read(&by_column(shape, &data), None).unwrap(), expected);
        // Bytes after the array are no values.
        assert_eq!(read(&by_column(shape, &[&data[..], &[1; 6]].concat()), None).unwrap(), expected);
    }

    #[test]
    fn unreadable_files_name_the_problem() {
        for (bytes, words) in [
            (array("<c16", "(2,)", &[]), ["descr", "'<c16'"]),
            (array("O", "(2,)", &[]), ["descr", "'O'"]),
            (array("=f4", "(2,)", &[]), ["descr", "byte order"]),
            (array("<f4", "(2, 3, 4)", &[]), ["shape", "(2, 3, 4)"]),
            (array("<f4", "(2, 0)", &[]), ["shape", "(2, 0)"]),
            (array("<f4", "(2, 257)", &[]), ["shape", "257"]),
            (array("<f4", "()", &[]), ["shape", "()"]),
            (array("<f4", "(99999999999999999999,)", &[]), ["shape", "99999"]),
            (array("<f4", "(18446744073709551615,)", &[0; 8]), ["frames", "2 are there"]),
            (array("<f4", "(3,)", &[0; 8]), ["3 frames", "2 are there"]),
            (
                file("{'descr': '<f4', 'fortran_order': 1, 'shape': (2, 2), }", &[0; 16]),
                ["fortran_order", "True or False"],
            ),
            (by_column("(4, 2)", &[0; 15]), ["4 frames", "3 are there"]),
            (by_column("(18446744073709551615, 2)", &[0; 8]), ["frames", "2 are there"]),
            (file("{'descr': '<f4', 'shape': (2,), }", &[0; 8]), ["description", "fortran_order"]),
            (file("[]", &[]), ["description", "descr"]),
            (array("<f4", "(2,)", &[])[..40].to_vec(), ["header", "cut off"]),
            ([MAGIC, &[2, 0, 0xff, 0xff, 0xff, 0xff]].concat(), ["header length", "4294967295"]),
            ([MAGIC, &[9, 0]].concat(), ["version", "9"]),
            (array("<f4", "(1,)", &f32::NAN.to_le_bytes()), ["sample", "NaN"]),
        ] {
            let error = read(&bytes, None).unwrap_err();
            for word in words {
                assert!(error.contains(word), "{word:?} in {error:?}");
            }
        }
        let bytes = array("<f4", "(1,)", &[0; 4]);
        let frames = NpyFrames::new(Cursor::new(&bytes)).unwrap();
        let error = frames.info(&RecordDefaults::default()).unwrap_err();
        assert!(error.to_string().contains("sample rate"), "{error}");
    }

    #[test]
    fn arbitrary_bytes_are_read_or_rejected() {
        for whole in [array("<i2", "(3, 2)", &[0; 12]), by_column("(3, 2)", &[0; 12])] {
            for at in 0..whole.len() {
                let _ = read(&whole[..at], None);
                for value in [0, 0x27, 0x28, 0x2c, 0x7f, 0xff] {
                    let mut damaged = whole.clone();
                    damaged[at] = value;
                    let _ = read(&damaged, None);
                }
            }
        }
    }
}
