//! Preview of a CSV file, or of its beginning, before it is imported.

use super::{ColumnRole, CsvFrames, CsvLayout, CsvTiming, RecordingError};

/// A column of a CSV file.
#[derive(Debug, Clone, PartialEq)]
pub struct CsvColumn {
    /// Text in the header, with its unit; the column's number without a header.
    pub label: String,
    /// The label without its unit.
    pub name: String,
    /// The unit in the header.
    pub unit: Option<String>,
    /// The role.
    pub role: ColumnRole,
}

/// Contents of the lines of a CSV file.
#[derive(Debug, Clone, PartialEq)]
pub struct CsvContents {
    /// Number of lines of samples, and their timing.
    pub timing: CsvTiming,
    /// Sampling rate in hertz; `None` if neither the file nor the layout states it.
    pub sample_rate_hz: Option<f64>,
    /// By channel, in column order: lowest and highest sample of intervals of equal length.
    pub envelopes: Vec<Vec<[f32; 2]>>,
}

/// A CSV file as it would be imported.
#[derive(Debug)]
pub struct CsvPreview {
    /// The columns.
    pub columns: Vec<CsvColumn>,
    /// The samples, or why the file cannot be imported.
    pub contents: Result<CsvContents, RecordingError>,
}

impl CsvPreview {
    /// Previews whole lines of a file whose columns are given by `layout`. An envelope has at most
    /// `intervals` entries.
    ///
    /// # Errors
    /// Those of [`CsvFrames`] if the columns cannot be determined.
    pub fn of(lines: &[u8], layout: CsvLayout, intervals: usize) -> Result<Self, RecordingError> {
        let mut frames = CsvFrames::with_layout(lines, layout)?;
        let timing = CsvTiming::scan(CsvFrames::with_layout(lines, layout)?);
        frames.leave_out(timing.as_ref().map_or(&[], |timing| &timing.counters));
        let columns = frames.columns().map(|(column, role)| CsvColumn {
            label: column.label.clone(),
            name: column.name.clone(),
            unit: column.unit.clone(),
            role,
        });
        let columns = columns.collect();
        Ok(Self { columns, contents: timing.and_then(|timing| contents(frames, timing, layout, intervals)) })
    }
}

fn contents(
    mut frames: CsvFrames<&[u8]>,
    timing: CsvTiming,
    layout: CsvLayout,
    intervals: usize,
) -> Result<CsvContents, RecordingError> {
    let rates = [layout.sample_rate_hz, timing.stated_rate_hz, timing.clock_rate_hz];
    let sample_rate_hz = match rates.iter().any(Option::is_some) {
        true => Some(timing.sample_rate_hz(layout.sample_rate_hz)?),
        false => None,
    };
    let mut frame = vec![0.0; frames.channels().len()];
    let intervals = (intervals as u64).clamp(1, timing.frames.max(1));
    let none = [f32::INFINITY, f32::NEG_INFINITY];
    let mut envelopes = vec![vec![none; intervals as usize]; frame.len()];
    for line in 0..timing.frames {
        if !frames.next_frame(&mut frame)? {
            break;
        }
        let interval = (line * intervals / timing.frames) as usize;
        for (envelope, sample) in envelopes.iter_mut().zip(&frame) {
            let [low, high] = envelope[interval];
            envelope[interval] = [low.min(*sample), high.max(*sample)];
        }
    }
    envelopes.iter_mut().for_each(|envelope| envelope.retain(|range| range[0] <= range[1]));
    Ok(CsvContents { timing, sample_rate_hz, envelopes })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_preview_gives_columns_rate_start_and_envelopes() {
        let lines = "at;in [g];count\n2026-03-01T08:00:00Z;1;7\n2026-03-01T08:00:00.5Z;-2;7\n\
                     2026-03-01T08:00:01Z;4;7\n2026-03-01T08:00:01.5Z;3;7\n";
        let layout = CsvLayout::new(None, None, &[2]).unwrap();
        let preview = CsvPreview::of(lines.as_bytes(), layout, 2).unwrap();
        let columns: Vec<_> =
            preview.columns.iter().map(|c| (c.name.as_str(), c.unit.as_deref(), c.role)).collect();
        assert_eq!(
            columns,
            [
                ("at", None, ColumnRole::Time),
                ("in", Some("g"), ColumnRole::Channel),
                ("count", None, ColumnRole::Ignored)
            ]
        );
        let contents = preview.contents.unwrap();
        assert_eq!((contents.sample_rate_hz, contents.timing.frames), (Some(2.0), 4));
        assert_eq!(contents.timing.dated_start.unwrap().to_string(), "2026-03-01T08:00:00Z");
        assert_eq!(contents.envelopes, [[[-2.0, 1.0], [3.0, 4.0]]]);
    }

    #[test]
    fn columns_are_listed_if_the_samples_are_invalid() {
        let text = b"t,a1\n0,1\n1,none\n";
        let preview = CsvPreview::of(text, CsvLayout::default(), 10).unwrap();
        assert_eq!(preview.columns.len(), 2);
        let fault = preview.contents.unwrap_err().to_string();
        assert!(fault.contains("line 3") && fault.contains("\"none\""), "{fault}");
        // Without a rate there is all but the length.
        let preview = CsvPreview::of(b"a1\n1\n3\n", CsvLayout::default(), 10).unwrap();
        assert_eq!(preview.contents.unwrap().sample_rate_hz, None);
        assert!(CsvPreview::of(b"", CsvLayout::default(), 10).is_err());
    }
}
