//! Records of a CSV file.

use std::io::Read;

use super::{
    CsvFrames, CsvLayout, CsvTiming, Frames, FramesInfo, RecordBlocks, RecordDefaults, RecordingError,
};
use flankwatch_signal::Record;

/// Reads a CSV file, whose columns are given by `layout`, as one record per channel.
///
/// The rate is that of the layout, else of the defaults, else the file's own. The start time from a column
/// with dates and the units in the header take precedence over the defaults.
pub fn decode_csv(
    bytes: &[u8],
    layout: CsvLayout,
    defaults: &RecordDefaults,
) -> Result<Vec<Record>, RecordingError> {
    if bytes.is_empty() {
        return Err(RecordingError::NoBytes);
    }
    let defaults = &RecordDefaults {
        sample_rate_hz: layout.sample_rate_hz.or(defaults.sample_rate_hz),
        scale: layout.scale.or(defaults.scale),
        sensitivity_mv_per_g: layout.sensitivity_mv_per_g.or(defaults.sensitivity_mv_per_g),
        ..defaults.clone()
    };
    let open = || {
        let mut frames = CsvFrames::with_layout(bytes, layout)?;
        if defaults.every_series {
            frames.keep_counters();
        }
        Ok::<_, RecordingError>(frames)
    };
    let timing = CsvTiming::scan(open()?)?;
    RecordBlocks::whole(TimedCsvFrames::new(open()?, timing), defaults)?.collect()
}

/// The frames of a CSV file whose timing is known.
pub struct TimedCsvFrames<R> {
    frames: CsvFrames<R>,
    timing: CsvTiming,
}

impl<R: Read> TimedCsvFrames<R> {
    /// Joins the frames of a file with its timing. Counters and times beside the time column are not
    /// channels.
    pub fn new(mut frames: CsvFrames<R>, timing: CsvTiming) -> Self {
        frames.leave_out(&timing.counters);
        Self { frames, timing }
    }
}

impl<R: Read> Frames for TimedCsvFrames<R> {
    fn info(&self, defaults: &RecordDefaults) -> Result<FramesInfo, RecordingError> {
        let own = self.frames.channels();
        let channels = defaults.names_or(own.to_vec());
        let units = channels.iter().zip(self.frames.units()).filter(|_| !defaults.every_series);
        Ok(FramesInfo {
            channel_units: units
                .filter_map(|(channel, unit)| Some((channel.clone(), unit.clone()?)))
                .collect(),
            channels,
            sample_rate_hz: self.timing.sample_rate_hz(defaults.sample_rate_hz)?,
            start_time: self.timing.start_time(defaults),
            frames_at_most: self.timing.frames,
        })
    }

    fn next_frame(&mut self, frame: &mut [f32]) -> Result<bool, RecordingError> {
        self.frames.next_frame(frame)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CsvPreview, TimeOfDay};
    use proptest::prelude::*;

    fn read(text: &str, rate_hz: Option<f64>) -> Result<Vec<Record>, String> {
        let defaults = RecordDefaults { sample_rate_hz: rate_hz, ..RecordDefaults::default() };
        decode_csv(text.as_bytes(), CsvLayout::default(), &defaults).map_err(|error| error.to_string())
    }

    fn only(text: &str, rate_hz: Option<f64>) -> Record {
        let mut records = read(text, rate_hz).unwrap();
        assert_eq!(records.len(), 1, "{text:?}");
        records.remove(0)
    }

    #[test]
    fn a_german_file_with_preamble_units_and_decimal_comma_is_read() {
        let text = "Messung;Getriebe 7\nAbtastrate;12,8;kHz\n\nZeit [ms];Eingang;Ausgang\nms;m/s²;g\n0,000;1,5;\"2,25\"\n0,078125;-3e-1;4\n";
        let records = read(text, None).unwrap();
        let found: Vec<_> =
            records.iter().map(|r| (r.channel(), r.unit(), r.sample_rate_hz(), r.samples())).collect();
        assert_eq!(
            found,
            [("Eingang", "m/s2", 12_800.0, &[1.5, -0.3][..]), ("Ausgang", "g", 12_800.0, &[2.25, 4.0][..])]
        );
    }

    #[test]
    fn separators_are_found() {
        for text in [
            "a,b\n1,2.5\n3,4\n",
            "a;b\n1;2.5\n3;4\n",
            "a\tb\n1\t2,5\n3\t4\n",
            "a b\n1 2.5\n3 4\n",
            "  a   b\n  1.0   2,5\n  3.0   4,0\n".replace("1.0", "1,0").replace("3.0", "3,0").as_str(),
            "\u{feff}\"a\",\"b\"\r\n\"1\",\"2.5\"\r\n\r\n3,4\r\n",
            "a,b,\n1,2.5,\n3,4,\n",
        ] {
            let records = read(text, Some(10.0)).unwrap_or_else(|error| panic!("{text:?}: {error}"));
            let found: Vec<_> = records.iter().map(|record| (record.channel(), record.samples())).collect();
            assert_eq!(found, [("a", &[1.0, 3.0][..]), ("b", &[2.5, 4.0][..])], "{text:?}");
        }
    }

    #[test]
    fn a_single_column_may_have_decimal_commas() {
        for (text, name, samples) in [
            ("Beschleunigung\n0,25\n-0,5\n1,75\n", "Beschleunigung", [0.25, -0.5, 1.75]),
            ("a [g]\r\n12,5\r\n3,05\r\n-7,25\r\n\r\n", "a", [12.5, 3.05, -7.25]),
            ("0,25\n-0,5\n1,75", "1", [0.25, -0.5, 1.75]),
            ("v (mm/s)\n1,5\n-2,5\n3,0\n", "v", [1.5, -2.5, 3.0]),
            ("Schwingung\n[m/s²]\n1,5\n-2,5\n3,0\n", "Schwingung", [1.5, -2.5, 3.0]),
        ] {
            let record = only(text, Some(10.0));
            assert_eq!((record.channel(), record.samples()), (name, &samples[..]), "{text:?}");
        }
        // These are two columns.
        for text in [
            "a,b\n0,25\n-0,5\n",
            "1,2\n-3,4\n",
            "1,0\n0,00\n",
            "0,5\n-0,0.5\n",
            "-0,-5\n1,2\n",
            "[g]\n1,-2\n3,4\n",
            "Run (A)\n1,2\n3,4\n",
        ] {
            assert_eq!(read(text, Some(10.0)).unwrap().len(), 2, "{text:?}");
        }
    }

    #[test]
    fn a_clock_in_four_columns_gives_the_rate() {
        let line = |k: u32| {
            format!(
                "9,39,{},{},0.{},-0.{k}\n",
                39 + (999_960 + 39 * k) / 1_000_000,
                (999_960 + 39 * k) % 1_000_000,
                k * 7 % 9
            )
        };
        let text: String = (0..9).map(line).collect();
        let records = read(&text, None).unwrap();
        assert_eq!(records.len(), 2);
        assert_eq!(records[1].channel(), "6");
        assert!((records[0].sample_rate_hz() - 1e6 / 39.0).abs() < 1e-6);
        // Steps of 39 µs may be those of 25.6 kHz, rounded.
        assert_eq!(read(&text, Some(25_600.0)).unwrap()[0].sample_rate_hz(), 25_600.0);
        assert_eq!(
            read(&text, Some(25_200.0)).unwrap_err().split(',').next(),
            Some("the sampling rate is 25200 Hz")
        );
        // Whole numbers that are no clock are samples.
        assert_eq!(read("9,39,39,5,1\n3,70,2,1,4\n1,1,1,1,1\n", Some(1.0)).unwrap().len(), 5);
    }

    #[test]
    fn dates_and_times_may_be_in_columns_of_their_own() {
        for text in [
            "Date,Time,a [g]\n2026-03-01,08:00:00.0,1\n2026-03-01,08:00:00.5,2\n",
            "Datum;Zeit;a [g]\n01.03.2026;08:00:00,0;1,0\n01.03.2026;08:00:00,5;2,0\n",
            "Time\ta [g]\tDate\n08:00:00.0\t1\t2026-03-01\n08:00:00.5\t2\t2026-03-01\n",
        ] {
            let record = only(text, None);
            assert_eq!(record.start_time().to_string(), "2026-03-01T08:00:00Z", "{text}");
            assert_eq!((record.channel(), record.unit(), record.sample_rate_hz()), ("a", "g", 2.0), "{text}");
        }
        let past_midnight =
            "Date,Time,a\n2026-03-01,23:59:59.5,1\n2026-03-02,00:00:00.0,2\n2026-03-02,00:00:00.5,3\n";
        assert_eq!(only(past_midnight, None).samples(), [1.0, 2.0, 3.0]);
    }

    #[test]
    fn a_clock_in_four_columns_that_starts_at_midnight_shows_the_time_of_day() {
        let text: String = (0..9).map(|k| format!("0,0,0,{},0.5,{k}.5\n", 40 * k)).collect();
        let defaults = RecordDefaults {
            start_time: "2026-03-01T09:00:00Z".parse().unwrap(),
            time_of_day: TimeOfDay::FromStart,
            ..Default::default()
        };
        let record = decode_csv(text.as_bytes(), CsvLayout::default(), &defaults).unwrap().remove(0);
        assert_eq!(record.start_time().to_string(), "2026-03-02T00:00:00Z");
    }

    #[test]
    fn times_of_day_give_the_start_on_demand() {
        let start = |text: &str, time_of_day: TimeOfDay, start_time: &str| -> String {
            let defaults =
                RecordDefaults { start_time: start_time.parse().unwrap(), time_of_day, ..Default::default() };
            let records = decode_csv(text.as_bytes(), CsvLayout::default(), &defaults).unwrap();
            records[0].start_time().to_string()
        };
        let text = "at,x\n08:00:00.5,1\n08:00:00.6,2\n";
        for (time_of_day, start_time, expected) in [
            (TimeOfDay::Ignored, "2026-03-01T09:00:00Z", "2026-03-01T09:00:00Z"),
            (TimeOfDay::FromStart, "2026-03-01T09:00:00Z", "2026-03-02T08:00:00.5Z"),
            (TimeOfDay::FromStart, "2026-03-01T08:00:01Z", "2026-03-01T08:00:00.5Z"),
            (TimeOfDay::UpToStart, "2026-03-01T09:00:00Z", "2026-03-01T08:00:00.5Z"),
            (TimeOfDay::UpToStart, "2026-03-01T07:00:00Z", "2026-02-28T08:00:00.5Z"),
        ] {
            assert_eq!(start(text, time_of_day, start_time), expected, "{time_of_day:?} {start_time}");
        }
        let elapsed = "at,x\n00:00:00.0,1\n00:00:00.1,2\n";
        let given = "2026-03-01T09:00:00Z";
        assert_eq!(start(elapsed, TimeOfDay::FromStart, given), given);
    }

    #[test]
    fn times_of_day_may_pass_midnight() {
        let text = "at,x\n23:59:59.8,1\n23:59:59.9,2\n00:00:00.0,3\n00:00:00.1,4\n";
        let defaults = RecordDefaults {
            start_time: "2026-03-02T00:00:05Z".parse().unwrap(),
            time_of_day: TimeOfDay::UpToStart,
            ..Default::default()
        };
        let record = decode_csv(text.as_bytes(), CsvLayout::default(), &defaults).unwrap().remove(0);
        assert_eq!((record.samples().len(), record.sample_rate_hz()), (4, 10.0));
        assert_eq!(record.start_time().to_string(), "2026-03-01T23:59:59.8Z");
        let error = read("at,x\n08:00:00,1\n08:00:01,2\n07:59:59,3\n", None).unwrap_err();
        assert!(error.contains("its time is before that of the line above"), "{error}");
        let error = read("at,x\n23:59:58,1\n23:59:59,2\n00:00:09,3\n", None).unwrap_err();
        assert!(error.contains("samples are missing"), "{error}");
    }

    #[test]
    fn dates_give_the_start() {
        for first in ["2026-03-01T08:00:00.0Z", "2026-03-01 08:00:00.0", "01.03.2026 08:00:00,0"] {
            let second = first.replacen(".0", ".5", 1).replace(",0", ",5");
            let second = if first.starts_with("01") { "01.03.2026 08:00:00,5".to_owned() } else { second };
            let record = only(&format!("when;x\n{first};1\n{second};2\n"), None);
            assert_eq!(
                (record.start_time().to_string().as_str(), record.sample_rate_hz()),
                ("2026-03-01T08:00:00Z", 2.0),
                "{first}"
            );
        }
        let zoned = only("when;x\n01.03.2026 09:00:00+01:00;1\n01.03.2026 09:00:01+01:00;2\n", None);
        assert_eq!(zoned.start_time().to_string(), "2026-03-01T08:00:00Z");
        assert_eq!(only("at,x\n08:00:00.1,1\n08:00:00.2,2\n", None).start_time().as_second(), 0);
    }

    #[test]
    fn invalid_times_are_rejected_with_their_line() {
        for (text, rate_hz, expected) in [
            ("a\n1\n2\n", None, "the sampling rate is missing"),
            ("t,a\n0,1\n0.1,2\n0.05,3\n", None, "csv line 4: its time is before that of the line above"),
            (
                "t,a\n0,1\n1,1\n2,1\n3,1\n6,1\n7,1\n8,1\n",
                None,
                "csv line 6: 3 s after the line above, where the other lines are 1 s apart: samples are missing",
            ),
            ("a,b\n", None, "csv line 2: no samples below the header"),
            (
                "time,a\n3/1/2026 12:00:00 PM,1\n3/1/2026 12:00:01 PM,2\n",
                None,
                "\"3/1/2026 12:00:00 PM\", expected a time such as 2026-03-01 12:00:00 or 01.03.2026 12:00:00",
            ),
            ("t,a\n0,1\n0.1,2\n", Some(10.02), "the sampling rate is 10.02 Hz, expected 10 Hz"),
            ("fs=11\nt,a\n0,1\n0.1,2\n", None, "the sampling rate is 11 Hz, expected 10 Hz"),
            (
                "at,a\n08:00:00,1\n08:00:01,1\nnoon,1\n",
                None,
                "csv line 4, column \"at\": \"noon\", expected a time",
            ),
            ("t,a\n0,1\n1,1\nx,1\n", None, "csv line 4, column \"t\": \"x\""),
        ] {
            let error = read(text, rate_hz).unwrap_err();
            assert!(error.contains(expected), "{text:?}: {error}");
        }
        assert_eq!(only("t,a\n0,1\n0.1,2\n", Some(10.009)).sample_rate_hz(), 10.009);
    }

    #[test]
    fn coarse_times_give_the_rate() {
        let text: String = (0..20_000).map(|k| format!("{:.3},{k}\n", f64::from(k) / 12_800.0)).collect();
        let record = only(&format!("t,x\n{text}"), None);
        assert!((record.sample_rate_hz() / 12_800.0 - 1.0).abs() < 1e-3, "{}", record.sample_rate_hz());
        assert_eq!(record.samples().len(), 20_000);
    }

    #[test]
    fn the_rate_may_precede_the_header() {
        for line in [
            "Sample rate: 25600 Hz",
            "# fs = 25600",
            "Sampling Frequency (kHz),25.6",
            "Sampling frequency [kHz]: 25.6 nominal",
            "SampleRate;25600",
            "SampleRate,25600,Hz",
            "Sample rate: 25.6 [kHz]",
            "Sample rate: 25.6kHz",
            "Sample rate: 25.6 kS/s",
            "Sample rate: 25.6 ksps",
            "fs = 0.0256 MS/s",
        ] {
            assert_eq!(
                only(&format!("{line}\nOperator: Ada\nx\n1\n2\n"), None).sample_rate_hz(),
                25_600.0,
                "{line}"
            );
        }
    }

    #[test]
    fn a_rate_with_a_comma_before_three_digits_follows_the_decimal_sign_of_the_samples() {
        let read = |text: &str| decode_csv(text.as_bytes(), CsvLayout::default(), &RecordDefaults::default());
        for text in ["# Sample rate: 12,800 Hz\nx\n1.5\n2\n", "Abtastrate;12,800;kHz\nx;y\n1;2\n3;4\n"] {
            let error = read(text).unwrap_err().to_string();
            assert!(
                error.starts_with("the sampling rate before the header is a number with a comma"),
                "{error}"
            );
        }
        let decimal = read("Abtastrate;12,800;kHz\nx;y\n1,5;2\n3;4\n").unwrap();
        assert_eq!(decimal[0].sample_rate_hz(), 12_800.0);
        // A time column, or a rate that is given, needs no header.
        let timed = read("# Sample rate: 12,800 Hz\nt,x\n0,1\n0.5,2\n1,3\n").unwrap();
        assert_eq!(timed[0].sample_rate_hz(), 2.0);
        let layout = CsvLayout::new(Some(12_800.0), None, &[]).unwrap();
        let given = CsvPreview::of(b"# Sample rate: 12,800 Hz\nx\n1\n2\n", layout, 1).unwrap();
        assert_eq!(given.contents.unwrap().sample_rate_hz, Some(12_800.0));
    }

    #[test]
    fn a_numbered_name_is_not_given_twice() {
        for (header, names) in [("x,x_2,x", ["x", "x_2", "x_3"]), ("x,x,x_2", ["x", "x_2", "x_2_2"])] {
            let defaults = RecordDefaults { sample_rate_hz: Some(1.0), ..RecordDefaults::default() };
            let text = format!("{header}\n1,2,3\n4,5,6\n");
            let records = decode_csv(text.as_bytes(), CsvLayout::default(), &defaults).unwrap();
            assert_eq!(records.iter().map(Record::channel).collect::<Vec<_>>(), names);
        }
    }

    #[test]
    fn latin_1_and_duplicate_names_are_read() {
        let bytes = b"Gr\xf6\xdfe;Gr\xf6\xdfe\n1;2\n3;4\n";
        let defaults = RecordDefaults { sample_rate_hz: Some(1.0), ..RecordDefaults::default() };
        let records = decode_csv(bytes, CsvLayout::default(), &defaults).unwrap();
        assert_eq!(records.iter().map(Record::channel).collect::<Vec<_>>(), ["Größe", "Größe_2"]);
    }

    #[test]
    fn given_names_replace_those_of_the_header() {
        let defaults = RecordDefaults {
            sample_rate_hz: Some(1.0),
            channel_names: vec!["in".to_owned(), "out".to_owned()],
            unit: Some("g".to_owned()),
            ..RecordDefaults::default()
        };
        let records = decode_csv(b"a [m/s2],b\n1,2\n", CsvLayout::default(), &defaults).unwrap();
        assert_eq!(
            records.iter().map(|r| (r.channel(), r.unit())).collect::<Vec<_>>(),
            [("in", "m/s2"), ("out", "g")]
        );
    }

    #[test]
    fn columns_follow_the_layout() {
        let text = "n;in [g];out (m/s2);speed\n0;1;5;25\n1;2;6;25\n2;3;7;25\n3;4;8;25\n";
        let read = |layout: Result<CsvLayout, RecordingError>| {
            let records = decode_csv(text.as_bytes(), layout.unwrap(), &RecordDefaults::default());
            records.map_err(|error| error.to_string())
        };
        let error = read(Ok(CsvLayout::default())).unwrap_err();
        assert!(error.starts_with("csv line 1: column \"n\" rises by the same step"), "{error}");
        let records = read(CsvLayout::new(Some(2560.5), None, &[3, 2])).unwrap();
        let found: Vec<_> = records.iter().map(|r| (r.channel(), r.unit(), r.samples()[0])).collect();
        assert_eq!(found, [("in", "g", 1.0), ("out", "m/s2", 5.0)]);
        assert_eq!(records[0].sample_rate_hz(), 2560.5);
        let records = read(CsvLayout::new(None, Some(1), &[])).unwrap();
        assert_eq!((records.len(), records[0].sample_rate_hz()), (3, 1.0));
        assert_eq!(read(CsvLayout::new(Some(1.0), Some(0), &[])).unwrap().len(), 4);
        let error = read(CsvLayout::new(Some(1.0), None, &[5])).unwrap_err();
        assert_eq!(error, "columns is 5, expected numbers of columns that the file has");
        let error = read(CsvLayout::new(None, Some(9), &[])).unwrap_err();
        assert!(error.starts_with("time_column is 9, expected the number of a column"), "{error}");
    }

    #[test]
    fn time_columns_have_many_names() {
        for heading in
            ["Time - Voltage_1", "X (ms)", "t", "Zeitstempel", "elapsed", "Zeit / s", "time_ms", "date"]
        {
            let text = format!("{heading};a1\n0;0,5\n2;0,25\n4;-0,5\n6;0\n");
            let record = only(&text, None);
            assert_eq!((record.channel(), record.samples().len()), ("a1", 4), "{heading}");
        }
        // Numbers this large count from 1970.
        let record = only("time_ns,a1\n1772690868000000000,1\n1772690868500000000,2\n", None);
        assert_eq!(
            (record.start_time().to_string().as_str(), record.sample_rate_hz()),
            ("2026-03-05T06:07:48Z", 2.0)
        );
        assert_eq!(only("timestamp,a1\n1772690868000,1\n1772690868500,2\n", None).sample_rate_hz(), 2.0);
        for heading in ["t_oil", "time constant", "temperature [K]", "date_code"] {
            assert_eq!(read(&format!("{heading},a\n5,1\n3,2\n"), Some(1.0)).unwrap().len(), 2, "{heading}");
        }
    }

    proptest! {
        #[test]
        fn numbers_come_back(samples in prop::collection::vec(-1e30f32..1e30, 2..60), comma in any::<bool>()) {
            let written = |x: &f32| if comma { format!("0;{x}\n").replace('.', ",") } else { format!("0,{x}\n") };
            let text: String = samples.iter().map(written).collect();
            let records = read(&text, Some(1.0)).unwrap();
            prop_assert_eq!(records[1].samples(), &samples[..]);
        }

        #[test]
        fn no_bytes_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = decode_csv(&bytes, CsvLayout::default(), &RecordDefaults { sample_rate_hz: Some(1.0), ..RecordDefaults::default() });
        }

        #[test]
        fn no_text_panics(text in "[0-9a-c:;,. \\t\\n\"-]{0,120}") {
            let _ = decode_csv(text.as_bytes(), CsvLayout::default(), &RecordDefaults { sample_rate_hz: Some(1.0), ..RecordDefaults::default() });
        }
    }
}
