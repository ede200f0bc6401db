//! Reads the recording to convert, frame by frame.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};

use jiff::Timestamp;

use super::{ConvertArgs, ConvertError, argument};
use crate::recording::{CsvFrames, CsvTiming, Format, RecordDefaults, RecordingError, WavFrames};

/// Frames of the input, reduced to the selected channels.
pub(super) struct Source {
    frames: Frames,
    pub(super) sample_rate_hz: f64,
    /// Time of the first sample, if the recording has one.
    pub(super) start_time: Option<Timestamp>,
    pub(super) channels: Vec<String>,
    /// Units by channel, for channels whose unit the recording has.
    pub(super) channel_units: BTreeMap<String, String>,
    /// Upper bound of the number of frames.
    pub(super) frames_at_most: u64,
    /// Buffer for all channels of a WAV frame.
    whole_frame: Vec<f32>,
    /// Indices of the selected channels in a WAV frame.
    selected: Vec<usize>,
}

enum Frames {
    Csv(Box<CsvFrames<BufReader<File>>>),
    Wav(WavFrames<BufReader<File>>),
}

impl Source {
    pub(super) fn open(args: &ConvertArgs) -> Result<Self, ConvertError> {
        let path = &args.input;
        let input = |source: RecordingError| ConvertError::Input { path: path.clone(), source };
        let cannot_open = |source| input(RecordingError::Open { path: path.clone(), source });
        let mut file = File::open(path).map_err(cannot_open)?;
        let bytes = file.metadata().map_err(cannot_open)?.len();
        let mut beginning = Vec::new();
        Read::by_ref(&mut file).take(16).read_to_end(&mut beginning).map_err(cannot_open)?;
        file.seek(SeekFrom::Start(0)).map_err(cannot_open)?;
        match Format::detect(&beginning) {
            Ok(Format::Mcap) => {
                Err(argument("IN", path.display(), "CSV or WAV: this is already an MCAP recording"))
            }
            Ok(Format::Wav) => {
                let frames = WavFrames::new(BufReader::new(file)).map_err(input)?;
                frames.check_length(bytes).map_err(input)?;
                let format = frames.format();
                let names = RecordDefaults::default().names_of(format.channels);
                let selected = select(&names, &args.channels)?;
                Ok(Self {
                    frames_at_most: frames.frames_at_most(bytes),
                    sample_rate_hz: args.rate.unwrap_or(format.sample_rate_hz.into()),
                    start_time: None,
                    channel_units: BTreeMap::new(),
                    channels: selected.iter().map(|&k| names[k].clone()).collect(),
                    whole_frame: vec![0.0; names.len()],
                    selected,
                    frames: Frames::Wav(frames),
                })
            }
            Ok(Format::Csv) => {
                let frames = CsvFrames::new(BufReader::new(&file), &args.channels).map_err(input)?;
                if args.rate.is_none() && !frames.has_rate() {
                    let expected = "the sampling rate in hertz: neither a time column nor a line before the header gives it";
                    return Err(argument("--rate", "missing", expected));
                }
                if args.unit.is_none() && frames.units().iter().any(Option::is_none) {
                    let expected =
                        "the samples' unit (such as m/s2): the header does not give it for every column";
                    return Err(argument("--unit", "missing", expected));
                }
                let timing = CsvTiming::scan(frames).map_err(input)?;
                let sample_rate_hz = timing.sample_rate_hz(args.rate).map_err(input)?;
                file.seek(SeekFrom::Start(0)).map_err(cannot_open)?;
                let frames = CsvFrames::new(BufReader::new(file), &args.channels).map_err(input)?;
                let units = frames.channels().iter().zip(frames.units());
                Ok(Self {
                    frames_at_most: timing.frames,
                    sample_rate_hz,
                    start_time: timing.start_time,
                    channel_units: units
                        .filter_map(|(channel, unit)| Some((channel.clone(), unit.as_ref()?.to_string())))
                        .collect(),
                    channels: frames.channels().to_vec(),
                    whole_frame: Vec::new(),
                    selected: Vec::new(),
                    frames: Frames::Csv(Box::new(frames)),
                })
            }
            Ok(other @ (Format::Flac | Format::Npy | Format::Mat)) => {
                let is = format!("{}, {}", path.display(), other.name());
                Err(argument("IN", is, "CSV or WAV; `analyze` and `replay` read the others"))
            }
            Err(error) => Err(input(error)),
        }
    }

    pub(super) fn next_frame(&mut self, frame: &mut [f32]) -> Result<bool, RecordingError> {
        match &mut self.frames {
            Frames::Csv(frames) => frames.next_frame(frame),
            Frames::Wav(frames) => {
                let more = frames.next_frame(&mut self.whole_frame)?;
                for (sample, &k) in frame.iter_mut().zip(&self.selected) {
                    *sample = self.whole_frame[k];
                }
                Ok(more)
            }
        }
    }
}

/// Returns the indices of the requested channels among those of a WAV; all where none is requested.
fn select(names: &[String], requested: &[String]) -> Result<Vec<usize>, ConvertError> {
    if requested.is_empty() {
        return Ok((0..names.len()).collect());
    }
    let find = |name: &String| {
        names
            .iter()
            .position(|other| other == name)
            .ok_or_else(|| argument("--channels", name, "numbers of the WAV's channels, counted from 1"))
    };
    requested.iter().map(find).collect()
}
