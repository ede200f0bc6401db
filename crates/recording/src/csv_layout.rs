//! Explicit description of a CSV file's columns, overriding automatic detection.

use std::fmt;

use super::RecordingError;

/// Largest number of columns.
pub(super) const MAX_COLUMNS: usize = 256;

/// The media type of CSV.
const MEDIA_TYPE: &str = "text/csv";

/// Roles of the columns of a CSV file. By default they are detected from the file.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CsvLayout {
    /// Sampling rate in hertz; must agree with the time column if there is one.
    pub sample_rate_hz: Option<f64>,
    /// Factor for each value.
    pub scale: Option<f64>,
    /// Sensitivity of the sensor in mV/g, as in [`RecordDefaults`](super::RecordDefaults).
    pub sensitivity_mv_per_g: Option<f64>,
    /// Number of the time column, from 1; 0 if there is none.
    time_column: Option<u16>,
    /// One bit per channel column; if no bit is set, all columns except the time are channels.
    channels: [u64; MAX_COLUMNS / 64],
}

impl CsvLayout {
    /// Creates a layout. Column numbers count from 1. If `channels` is empty, all columns except the time are
    /// channels. `time_column` is 0 if there is no time column.
    ///
    /// # Errors
    /// [`RecordingError::Field`] if a number is not a valid column number.
    pub fn new(
        sample_rate_hz: Option<f64>,
        time_column: Option<u16>,
        channels: &[u16],
    ) -> Result<Self, RecordingError> {
        let max_column = MAX_COLUMNS as u16;
        if let Some(column) = time_column.filter(|column| *column > max_column) {
            return Err(RecordingError::field("time_column", column, "a number from 0 to 256"));
        }
        let mut layout = Self { sample_rate_hz, time_column, ..Self::default() };
        for &column in channels {
            if !(1..=max_column).contains(&column) {
                return Err(RecordingError::field("columns", column, "numbers from 1 to 256"));
            }
            let at = usize::from(column - 1);
            layout.channels[at / 64] |= 1 << (at % 64);
        }
        Ok(layout)
    }

    /// Parses the output of [`Display`](fmt::Display); `None` for another media type.
    pub fn from_media_type(media_type: &str) -> Option<Self> {
        let mut parts = media_type.split(';');
        if parts.next()? != MEDIA_TYPE {
            return None;
        }
        let (mut rate, mut scale, mut sensitivity_mv_per_g) = (None, None, None);
        let (mut time, mut channels) = (None, Vec::new());
        for part in parts {
            let (name, value) = part.split_once('=')?;
            match name {
                "rate" => rate = Some(value.parse().ok()?),
                "scale" => scale = Some(value.parse().ok()?),
                "sensitivity" => sensitivity_mv_per_g = Some(value.parse().ok()?),
                "time" => time = Some(value.parse().ok()?),
                "columns" => channels = numbers(value)?,
                _ => return None,
            }
        }
        Some(Self { scale, sensitivity_mv_per_g, ..Self::new(rate, time, &channels).ok()? })
    }

    /// Returns the index of the time column from 0: `None` if not given, `Some(None)` if there is no time
    /// column.
    pub(super) fn time_index(self) -> Option<Option<usize>> {
        self.time_column.map(|column| usize::from(column).checked_sub(1))
    }

    /// Returns whether the layout specifies columns.
    pub(super) fn has_columns(self) -> bool {
        self.time_column.is_some() || self.channels.iter().any(|bits| *bits != 0)
    }

    /// Returns the indices of the channel columns, from 0; empty if not given.
    pub(super) fn channel_indices(self) -> Vec<usize> {
        (0..MAX_COLUMNS).filter(|at| self.channels[at / 64] >> (at % 64) & 1 == 1).collect()
    }
}

/// Parses comma-separated numbers; `None` if one is invalid.
fn numbers(text: &str) -> Option<Vec<u16>> {
    text.split(',').map(|number| number.trim().parse().ok()).collect()
}

impl fmt::Display for CsvLayout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(MEDIA_TYPE)?;
        if let Some(rate_hz) = self.sample_rate_hz {
            write!(f, ";rate={rate_hz}")?;
        }
        if let Some(scale) = self.scale {
            write!(f, ";scale={scale}")?;
        }
        if let Some(sensitivity) = self.sensitivity_mv_per_g {
            write!(f, ";sensitivity={sensitivity}")?;
        }
        if let Some(column) = self.time_column {
            write!(f, ";time={column}")?;
        }
        for (index, at) in self.channel_indices().into_iter().enumerate() {
            write!(f, "{}{}", if index == 0 { ";columns=" } else { "," }, at + 1)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_media_type_contains_the_whole_layout() {
        for (layout, text) in [
            (CsvLayout::default(), "text/csv"),
            (CsvLayout::new(Some(2560.5), None, &[]).unwrap(), "text/csv;rate=2560.5"),
            (CsvLayout { scale: Some(-0.5), ..CsvLayout::default() }, "text/csv;scale=-0.5"),
            (
                CsvLayout { sensitivity_mv_per_g: Some(100.0), ..CsvLayout::default() },
                "text/csv;sensitivity=100",
            ),
            (CsvLayout::new(None, Some(0), &[256, 2, 2]).unwrap(), "text/csv;time=0;columns=2,256"),
            (CsvLayout::new(Some(1.0), Some(3), &[1]).unwrap(), "text/csv;rate=1;time=3;columns=1"),
        ] {
            assert_eq!(layout.to_string(), text);
            assert_eq!(CsvLayout::from_media_type(text), Some(layout));
        }
        for text in ["text/html", "text/csv;rate=x", "text/csv;columns=0", "text/csv;more=1", "text/csv;"] {
            assert_eq!(CsvLayout::from_media_type(text), None, "{text}");
        }
    }

    #[test]
    fn invalid_columns_are_rejected() {
        let error = CsvLayout::new(None, Some(300), &[]).unwrap_err().to_string();
        assert!(error.contains("time_column is 300, expected a number from 0 to 256"), "{error}");
        let error = CsvLayout::new(None, None, &[1, 0]).unwrap_err().to_string();
        assert!(error.contains("columns is 0, expected numbers from 1 to 256"), "{error}");
    }
}
