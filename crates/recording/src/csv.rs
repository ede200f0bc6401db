//! CSV: one channel a column, one frame a line, with or without a header.

use std::io::{self, Read};

use csv::{ReaderBuilder, StringRecord};

use super::RecordingError;
use super::block::MAX_CHANNEL_BYTES;
use super::error::shortened;

/// Longest line taken, in bytes: a file without line ends must not fill the memory.
const MAX_LINE_BYTES: usize = 1 << 20;

/// Most columns taken.
const MAX_COLUMNS: usize = 256;

/// Reads frames (one sample of every chosen channel) of a CSV file, line by line.
///
/// The first line is a header if a field in it is not a number; without one the columns are `"1"`, `"2"`, …. Columns called `time`, `t`, `timestamp`
/// or like `time (s)` are left out unless they are chosen by name. Fields are separated by commas, or by the semicolons or tabs of the first line.
pub struct CsvFrames<R> {
    reader: csv::Reader<LineLimit<R>>,
    channels: Vec<String>,
    columns: Vec<usize>,
    line: StringRecord,
    /// The first line where it is not a header.
    first: Option<StringRecord>,
}

impl<R: Read> CsvFrames<R> {
    /// Reads the first line; `chosen` names the wanted columns in their order, all data columns where it is empty.
    pub fn new(reader: R, chosen: &[String]) -> Result<Self, RecordingError> {
        let mut limited = LineLimit::new(reader);
        let separator = limited.separator()?;
        let mut reader = ReaderBuilder::new()
            .has_headers(false)
            .delimiter(separator)
            .trim(csv::Trim::All)
            .from_reader(limited);
        let mut line = StringRecord::new();
        if !reader.read_record(&mut line).map_err(csv_error)? {
            return Err(RecordingError::NoBytes);
        }
        if line.len() > MAX_COLUMNS {
            return Err(RecordingError::CsvLine {
                line: 1,
                what: format!("{} columns, expected at most {MAX_COLUMNS}", line.len()),
            });
        }
        let is_header = line.iter().any(|field| field.parse::<f64>().is_err());
        let names: Vec<String> = if is_header {
            line.iter()
                .enumerate()
                .map(|(k, name)| if name.is_empty() { (k + 1).to_string() } else { name.to_owned() })
                .collect()
        } else {
            (1..=line.len()).map(|k| k.to_string()).collect()
        };
        if let Some(name) = names
            .iter()
            .find(|name| name.len() > MAX_CHANNEL_BYTES || name.chars().any(char::is_control))
        {
            return Err(RecordingError::CsvLine {
                line: 1,
                what: format!(
                    "column name {:?}, expected at most 256 bytes without control characters",
                    shortened(name)
                ),
            });
        }
        let columns = choose(&names, chosen)?;
        Ok(Self {
            reader,
            channels: columns.iter().map(|&k| names[k].clone()).collect(),
            columns,
            first: (!is_header).then(|| line.clone()),
            line,
        })
    }

    /// Names of the channels, in the order of a frame.
    pub fn channels(&self) -> &[String] {
        &self.channels
    }

    /// Reads the next frame, false at the end. A value that is no finite number is an error with its line and column.
    pub fn next_frame(&mut self, frame: &mut [f32]) -> Result<bool, RecordingError> {
        if let Some(first) = self.first.take() {
            self.line = first;
        } else if !self.reader.read_record(&mut self.line).map_err(csv_error)? {
            return Ok(false);
        }
        for ((sample, &column), channel) in frame.iter_mut().zip(&self.columns).zip(&self.channels) {
            let field = self.line.get(column).unwrap_or("");
            match field.parse::<f32>() {
                Ok(value) if value.is_finite() => *sample = value,
                _ => {
                    return Err(RecordingError::CsvValue {
                        line: self.line.position().map_or(1, csv::Position::line),
                        column: channel.clone(),
                        value: shortened(field),
                        expected: "a finite number with a decimal point",
                    });
                }
            }
        }
        Ok(true)
    }
}

/// Columns of the chosen names, or all that are not a time.
fn choose(names: &[String], chosen: &[String]) -> Result<Vec<usize>, RecordingError> {
    let columns: Vec<usize> = if chosen.is_empty() {
        (0..names.len()).filter(|&k| !is_time(&names[k])).collect()
    } else {
        let find = |wanted: &String| {
            names.iter().position(|name| name == wanted).ok_or_else(|| RecordingError::CsvLine {
                line: 1,
                what: format!("no column {wanted:?}, expected one of {}", names.join(", ")),
            })
        };
        chosen.iter().map(find).collect::<Result<_, _>>()?
    };
    if columns.is_empty() {
        return Err(RecordingError::CsvLine {
            line: 1,
            what: format!("no column with samples among {}", names.join(", ")),
        });
    }
    Ok(columns)
}

/// Whether a column's name says that it holds the time, not a signal: `t`, `time (s)`, `timestamp_ns`, but not `t_oil`.
fn is_time(name: &str) -> bool {
    let name = name.to_lowercase();
    let mut words = name.split([' ', '(', '[', '_', ')', ']']).filter(|word| !word.is_empty());
    let stem = words.next().unwrap_or_default();
    matches!(stem, "time" | "t" | "timestamp" | "datetime")
        && words.all(|unit| matches!(unit, "s" | "sec" | "seconds" | "ms" | "us" | "µs" | "ns" | "utc"))
}

fn csv_error(error: csv::Error) -> RecordingError {
    let line = error.position().map_or(1, csv::Position::line);
    match error.into_kind() {
        csv::ErrorKind::Io(error) => error.into(),
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => RecordingError::CsvLine {
            line,
            what: format!("{len} fields, expected {expected_len} as in the first line"),
        },
        csv::ErrorKind::Utf8 { .. } => RecordingError::CsvLine {
            line,
            what: "not UTF-8 text".to_owned(),
        },
        other => RecordingError::CsvLine {
            line,
            what: format!("{other:?}"),
        },
    }
}

/// Passes text on and fails on a line that is too long, for the parser keeps a whole line.
struct LineLimit<R> {
    reader: R,
    beginning: io::Cursor<Vec<u8>>,
    line_bytes: usize,
}

impl<R: Read> LineLimit<R> {
    fn new(reader: R) -> Self {
        Self {
            reader,
            beginning: io::Cursor::new(Vec::new()),
            line_bytes: 0,
        }
    }

    /// Looks at the first line for its separator.
    fn separator(&mut self) -> Result<u8, RecordingError> {
        let mut beginning = Vec::new();
        self.reader.by_ref().take(4096).read_to_end(&mut beginning)?;
        let line = beginning.split(|&byte| byte == b'\n').next().unwrap_or_default();
        let separator = [b';', b'\t'].into_iter().find(|separator| line.contains(separator));
        self.beginning = io::Cursor::new(beginning);
        Ok(separator.unwrap_or(b','))
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
            let what = format!("a line of more than {MAX_LINE_BYTES} bytes, expected CSV with one frame a line");
            return Err(io::Error::new(io::ErrorKind::InvalidData, what));
        }
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, chosen: &[&str]) -> Result<(Vec<String>, Vec<Vec<f32>>), String> {
        let chosen: Vec<String> = chosen.iter().map(ToString::to_string).collect();
        let mut frames = CsvFrames::new(text.as_bytes(), &chosen).map_err(|error| error.to_string())?;
        let mut all = Vec::new();
        let mut frame = vec![0.0; frames.channels().len()];
        while frames.next_frame(&mut frame).map_err(|error| error.to_string())? {
            all.push(frame.clone());
        }
        Ok((frames.channels().to_vec(), all))
    }

    #[test]
    fn with_and_without_a_header() {
        let (channels, frames) = read("a1, a2\n1.5,-2e-3\r\n\n3,4", &[]).unwrap();
        assert_eq!(channels, ["a1", "a2"]);
        assert_eq!(frames, [[1.5, -2e-3], [3.0, 4.0]]);
        let (channels, frames) = read("1,2\n3,4\n", &[]).unwrap();
        assert_eq!(channels, ["1", "2"]);
        assert_eq!(frames, [[1.0, 2.0], [3.0, 4.0]]);
    }

    #[test]
    fn columns_are_chosen_by_name_and_time_is_none() {
        let text = "\u{feff}Time (s);a1;a2\n0.0;1;2\n";
        assert_eq!(read(text, &[]).unwrap().1, [[1.0, 2.0]]);
        assert_eq!(read(text, &["a2"]).unwrap().1, [[2.0]]);
        assert_eq!(read(text, &["a2", "a1"]).unwrap().1, [[2.0, 1.0]]);
        assert!(read(text, &["a3"]).unwrap_err().contains("no column \"a3\""));
        assert!(read("t\n1\n", &[]).unwrap_err().contains("no column with samples"));
        assert_eq!(read("torque\tt_s\tt_oil\n1\t0\t60\n", &[]).unwrap().0, ["torque", "t_oil"]);
    }

    #[test]
    fn an_error_names_line_column_and_value() {
        for (text, expected) in [
            ("", "0 bytes"),
            ("a,b\n1,2\n3,x\n", "csv line 3, column \"b\": \"x\", expected a finite number"),
            ("a\nNaN\n", "csv line 2, column \"a\": \"NaN\""),
            ("1\n2\ninf\n", "csv line 3, column \"1\": \"inf\""),
            ("a\n1e39\n", "csv line 2, column \"a\": \"1e39\""),
            ("a;b\n1,5;2\n", "csv line 2, column \"a\": \"1,5\""),
            ("a,b\n1,\n", "column \"b\": \"\""),
            ("a,b\n1,2,3\n", "csv line 2: 3 fields, expected 2"),
        ] {
            let error = read(text, &[]).unwrap_err();
            assert!(error.contains(expected), "{text:?}: {error}");
        }
    }

    #[test]
    fn a_file_without_line_ends_is_refused_early() {
        let mut frames = CsvFrames::new(Read::chain(&b"a\n1"[..], io::repeat(b'1')), &[]).unwrap();
        let error = frames.next_frame(&mut [0.0]).unwrap_err().to_string();
        assert!(error.contains("a line of more than 1048576 bytes"), "{error}");
    }
}
