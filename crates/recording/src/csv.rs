//! CSV: one channel per column, one frame per line, with or without a header.

use std::io::Read;

use csv::{ByteRecord, ReaderBuilder};

use super::RecordingError;
use super::csv_clock::Clock;
use super::csv_field::{Decimals, Moment, text};
use super::csv_head::{Column, ColumnRole, Head, StatedRate};
use super::csv_layout::CsvLayout;
use super::csv_text::{CollapseSpaces, LineLimit};
use super::error::shortened;

/// Reads the frames (one sample of every selected channel) of a CSV file, line by line.
///
/// Fields are separated by commas, semicolons, tabs or spaces, whichever is consistent with the first two
/// lines of samples, and may be quoted. The decimal separator is a point, or a comma if that does not
/// separate fields: in a single column it separates none if numbers such as `-0,5` or `1,05` show it, or if
/// the line above the samples has a single unit of vibration. Lines before the header are skipped, except
/// that one of them may state the sampling rate. The line above the samples names the columns, unless it is a
/// line of units; then the line above it does. Without a header the columns are `"1"`, `"2"`, ….
///
/// Time columns are not channels unless selected by name. They are columns named `time`, `t`, `Zeit [ms]` or
/// similar, columns with dates or times of day, and the first four if they are hour, minute, second and
/// microsecond. Text is UTF-8 or Latin-1.
pub struct CsvFrames<R> {
    reader: csv::Reader<CollapseSpaces<LineLimit<R>>>,
    head: Head,
    /// Whether lines end with CR LF.
    has_crlf: bool,
    channels: Vec<String>,
    units: Vec<Option<String>>,
    columns: Vec<usize>,
    /// Whether the columns were given explicitly.
    has_explicit_columns: bool,
    decimals: Decimals,
    clock_decimals: Decimals,
    line: ByteRecord,
}

impl<R: Read> CsvFrames<R> {
    /// Reads the header. `selected` names the columns to read, in order; if empty, all data columns are read.
    pub fn new(reader: R, selected: &[String]) -> Result<Self, RecordingError> {
        Self::open(reader, CsvLayout::default(), !selected.is_empty(), |head| choose(head, selected))
    }

    /// Reads the header of a file whose columns are given by `layout`.
    ///
    /// # Errors
    /// Those of [`new`](Self::new); a column that is not in the file.
    pub fn with_layout(reader: R, layout: CsvLayout) -> Result<Self, RecordingError> {
        Self::open(reader, layout, layout.has_columns(), |head| {
            let columns = layout.channel_indices();
            match columns.last() {
                None => choose(head, &[]),
                Some(last) if *last < head.columns.len() => Ok(columns),
                Some(last) => {
                    Err(RecordingError::field("columns", last + 1, "numbers of columns that the file has"))
                }
            }
        })
    }

    fn open(
        reader: R,
        layout: CsvLayout,
        has_explicit_columns: bool,
        choose: impl Fn(&Head) -> Result<Vec<usize>, RecordingError>,
    ) -> Result<Self, RecordingError> {
        let mut limited = LineLimit::new(reader);
        let beginning = limited.beginning()?;
        if beginning.is_empty() {
            return Err(RecordingError::NoBytes);
        }
        let head = Head::read(beginning, layout)?;
        let has_crlf = first_line_ends_with_crlf(beginning);
        limited.skip_lines(head.lines);
        let reader = ReaderBuilder::new()
            .has_headers(false)
            .delimiter(head.separator)
            .trim(csv::Trim::All)
            .from_reader(CollapseSpaces::new(limited, head.separator == b' '));
        let columns = choose(&head)?;
        let of = |column: &usize| &head.columns[*column];
        Ok(Self {
            reader,
            channels: columns.iter().map(|column| of(column).name.clone()).collect(),
            units: columns.iter().map(|column| of(column).unit.clone()).collect(),
            columns,
            has_explicit_columns,
            decimals: Decimals::separated_by(head.separator),
            clock_decimals: Decimals::separated_by(head.separator),
            head,
            has_crlf,
            line: ByteRecord::new(),
        })
    }

    /// Returns the names of the channels, in the order of a frame.
    pub fn channels(&self) -> &[String] {
        &self.channels
    }

    /// Returns the units of the channels, as far as the header states them.
    pub fn units(&self) -> &[Option<String>] {
        &self.units
    }

    /// Returns the sampling rate stated in a line before the header.
    pub(super) fn stated_rate(&self) -> Option<StatedRate> {
        self.head.stated_rate
    }

    /// Returns the resolution of the times in nanoseconds, if their format fixes it.
    pub(super) fn time_resolution_ns(&self) -> Option<i64> {
        self.head.clock.and_then(Clock::resolution_ns)
    }

    /// Returns whether the file has times of day.
    pub(super) fn shows_time_of_day(&self) -> bool {
        self.head.clock.is_some_and(Clock::shows_time_of_day)
    }

    /// Returns whether times of day from zero on may count from the start of the recording.
    pub(super) fn times_may_count_from_start(&self) -> bool {
        self.head.clock.is_some_and(Clock::may_count_from_start)
    }

    /// Returns all columns with their roles.
    pub(super) fn columns(&self) -> impl Iterator<Item = (&Column, ColumnRole)> {
        self.head.columns.iter().enumerate().map(|(at, column)| {
            let is_time = self.head.clock.is_some_and(|clock| clock.has(at));
            let role = match () {
                () if self.columns.contains(&at) => ColumnRole::Channel,
                () if is_time => ColumnRole::Time,
                () => ColumnRole::Ignored,
            };
            (column, role)
        })
    }

    /// Reads all data columns as channels, even times and counters.
    pub(super) fn keep_counters(&mut self) {
        self.has_explicit_columns = true;
    }

    /// Returns the indices of the channels that are times or counters, as far as the columns were not given
    /// explicitly. `are_even` tells of each channel whether it rises by the same step from line to line.
    ///
    /// # Errors
    /// There is such a channel and no time column: it may be the unnamed time.
    pub(super) fn counters(&self, are_even: &[bool]) -> Result<Vec<usize>, RecordingError> {
        let is_single = self.head.columns.len() == 1;
        if self.has_explicit_columns || is_single || !are_even.contains(&true) {
            return Ok(Vec::new());
        }
        let counters: Vec<usize> = (0..are_even.len()).filter(|at| are_even[*at]).collect();
        if self.head.clock.is_none() {
            return Err(RecordingError::CsvLine {
                line: self.head.lines.max(1),
                what: format!(
                    "column {:?} rises by the same step from line to line, like a time: name it time, or do not select it",
                    self.head.columns[self.columns[counters[0]]].label
                ),
            });
        }
        // Samples that all rise are the only ones there are.
        Ok(if counters.len() < are_even.len() { counters } else { Vec::new() })
    }

    /// Removes channels by their indices.
    pub(super) fn leave_out(&mut self, channels: &[usize]) {
        let mut at = 0..;
        self.columns.retain(|_| !at.next().is_some_and(|at| channels.contains(&at)));
        self.channels = self.columns.iter().map(|at| self.head.columns[*at].name.clone()).collect();
        self.units = self.columns.iter().map(|at| self.head.columns[*at].unit.clone()).collect();
    }

    /// Reads the next frame; returns false at the end. A value that is not a finite number is an error with
    /// its line and column.
    pub fn next_frame(&mut self, frame: &mut [f32]) -> Result<bool, RecordingError> {
        let skipped = self.head.lines;
        let has_crlf = self.has_crlf;
        let failed = |error| csv_error(error, skipped, has_crlf);
        if !self.reader.read_byte_record(&mut self.line).map_err(failed)? {
            return Ok(false);
        }
        // Only in a single column a blank line may be a sample that is missing.
        let start = self.line.position().map_or(0, csv::Position::line);
        if self.head.columns.len() == 1 && self.reader.position().line() > start + 1 {
            let (line, what) = (self.line(), "empty, expected a number".to_owned());
            return Err(RecordingError::CsvLine { line, what });
        }
        for ((sample, &column), channel) in frame.iter_mut().zip(&self.columns).zip(&self.channels) {
            let field = text(self.line.get(column).unwrap_or_default());
            match self.decimals.parse::<f32>(&field) {
                Some(value) if value.is_finite() => *sample = value,
                _ => {
                    return Err(RecordingError::CsvValue {
                        line: self.line(),
                        column: channel.clone(),
                        value: shortened(&field),
                        expected: self.decimals.expected(),
                    });
                }
            }
        }
        Ok(true)
    }

    /// Returns the number of the line that was read last, counted from 1.
    pub(super) fn line(&self) -> u64 {
        self.head.lines + line_at(self.line.position(), self.has_crlf)
    }

    /// Returns the time of the line that was read last; `None` if the file has no time column.
    pub(super) fn moment(&mut self) -> Result<Option<Moment>, RecordingError> {
        let Some(clock) = self.head.clock else {
            return Ok(None);
        };
        let field =
            |at: usize| std::str::from_utf8(self.line.get(at).unwrap_or_default()).unwrap_or_default();
        match clock.read(field, &mut self.clock_decimals) {
            Some(moment) => Ok(Some(moment)),
            None => {
                let at = (0..self.head.columns.len()).find(|&at| clock.has(at)).unwrap_or_default();
                Err(RecordingError::CsvValue {
                    line: self.line(),
                    column: self.head.columns[at].label.clone(),
                    value: shortened(field(at)),
                    expected: if field(at).contains(['/', ':']) {
                        "a time such as 2026-03-01 12:00:00 or 01.03.2026 12:00:00"
                    } else {
                        "a time as in the lines above"
                    },
                })
            }
        }
    }
}

/// Returns the selected columns by name or by number from 1, or all columns that are not a time. A number
/// counts all columns, as in a file without a header.
fn choose(head: &Head, selected: &[String]) -> Result<Vec<usize>, RecordingError> {
    let names = || head.columns.iter().map(|column| column.label.as_str()).collect::<Vec<_>>().join(", ");
    let refuse = |what: String| RecordingError::CsvLine { line: head.lines.max(1), what };
    let columns: Vec<usize> = if selected.is_empty() {
        (0..head.columns.len()).filter(|&at| !head.clock.is_some_and(|clock| clock.has(at))).collect()
    } else {
        let find = |name: &String| {
            let has_name = |column: &Column| column.label == *name || column.name == *name;
            let is_time = |at: &usize| head.clock.is_some_and(|clock| clock.has(*at));
            let number = || name.parse::<usize>().ok()?.checked_sub(1).filter(|at| *at < head.columns.len());
            let found = head.columns.iter().position(has_name);
            let found = found.or_else(|| number().filter(|at| !is_time(at)));
            found.ok_or_else(|| refuse(format!("no column {name:?}, expected one of {}", names())))
        };
        selected.iter().map(find).collect::<Result<_, _>>()?
    };
    if columns.is_empty() {
        let names = names();
        let others = if names.is_empty() { "" } else { " among " };
        return Err(refuse(format!("no column with samples{others}{names}")));
    }
    Ok(columns)
}

fn first_line_ends_with_crlf(text: &[u8]) -> bool {
    let end = text.iter().position(|&byte| byte == b'\n');
    end.is_some_and(|end| text[..end].ends_with(b"\r"))
}

/// Returns the line of a parser's position. The parser ends a line at CR and counts it at LF, so between the
/// two its count is one too low.
fn line_at(position: Option<&csv::Position>, has_crlf: bool) -> u64 {
    position.map_or(1, |position| position.line() + u64::from(has_crlf && position.byte() > 0))
}

fn csv_error(error: csv::Error, skipped: u64, has_crlf: bool) -> RecordingError {
    let line = skipped + line_at(error.position(), has_crlf);
    match error.into_kind() {
        csv::ErrorKind::Io(error) => error.into(),
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => RecordingError::CsvLine {
            line,
            what: format!("{len} fields, expected {expected_len} as in the first line of samples"),
        },
        other => RecordingError::CsvLine { line, what: format!("{other:?}") },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, selected: &[&str]) -> Result<(Vec<String>, Vec<Vec<f32>>), String> {
        let selected: Vec<String> = selected.iter().map(ToString::to_string).collect();
        let mut frames = CsvFrames::new(text.as_bytes(), &selected).map_err(|error| error.to_string())?;
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
        assert_eq!(read("a\r\n1\r\n2\r\n\r\n\r\n", &[]).unwrap().1, [[1.0], [2.0]]);
        assert_eq!(read("1\n2\n\n\n", &[]).unwrap().1, [[1.0], [2.0]]);
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
        assert_eq!(read(text, &["3", "2"]).unwrap().1, [[2.0, 1.0]]);
        // The first column is the time.
        for name in ["a3", "0", "1", "4"] {
            assert!(read(text, &[name]).unwrap_err().contains(&format!("no column {name:?}")));
        }
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
            (
                "a;b\n1,5;2\n2.5;3\n",
                "csv line 3, column \"a\": \"2.5\", expected a finite number with a decimal comma",
            ),
            ("a,b\n1,\n", "column \"b\": \"\""),
            ("a\n1\n\n3\n", "csv line 3: empty, expected a number"),
            ("a\r\n1\r\n\r\n3\r\n", ": empty, expected a number"),
            ("a,b\r\n1,x\r\n", "csv line 2, column \"b\": \"x\""),
            ("a,b\r\n1,2\r\n3,4\r\n5,x\r\n", "csv line 4, column \"b\": \"x\""),
            ("a,b\r\n1,2\r\n3,4\r\n5,6\r\n7,8,9\r\n", "csv line 5: 3 fields, expected 2"),
            ("left,right\n0.1,0.2\n0.3\n0.5,0.6\n0.7,0.8\n", "csv line 3: 1 fields, expected 2"),
            ("a,b\n1,2,3\n", "csv line 2: 3 fields, expected 2"),
        ] {
            let error = read(text, &[]).unwrap_err();
            assert!(error.contains(expected), "{text:?}: {error}");
        }
    }

    #[test]
    fn a_file_without_line_ends_is_rejected_early() {
        let mut frames = CsvFrames::new(Read::chain(&b"a\n1"[..], std::io::repeat(b'1')), &[]).unwrap();
        let error = frames.next_frame(&mut [0.0]).unwrap_err().to_string();
        assert!(error.contains("a line of more than 1048576 bytes"), "{error}");
    }
}
