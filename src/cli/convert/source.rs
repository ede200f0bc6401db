//! The recording to convert, frame by frame.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};

use super::{ConvertArgs, ConvertError, argument};
use crate::recording::{CsvFrames, Format, RecordDefaults, RecordingError, WavFrames};

/// Frames of the input, with the chosen channels only.
pub(super) struct Source {
    frames: Frames,
    pub(super) sample_rate_hz: f64,
    pub(super) channels: Vec<String>,
    /// An upper bound of the number of frames.
    pub(super) frames_at_most: u64,
    /// All channels of a WAV frame, and which of them are wanted.
    whole_frame: Vec<f32>,
    chosen: Vec<usize>,
}

enum Frames {
    Csv(CsvFrames<BufReader<File>>),
    Wav(WavFrames<BufReader<File>>),
}

impl Source {
    pub(super) fn open(args: &ConvertArgs) -> Result<Self, ConvertError> {
        let path = &args.input;
        let input = |source: RecordingError| ConvertError::Input {
            path: path.clone(),
            source,
        };
        let cannot_open = |source| {
            input(RecordingError::Open {
                path: path.clone(),
                source,
            })
        };
        let mut file = File::open(path).map_err(cannot_open)?;
        let bytes = file.metadata().map_err(cannot_open)?.len();
        let mut beginning = Vec::new();
        Read::by_ref(&mut file).take(16).read_to_end(&mut beginning).map_err(cannot_open)?;
        file.seek(SeekFrom::Start(0)).map_err(cannot_open)?;
        match Format::detect(&beginning) {
            Ok(Format::Mcap) => Err(argument("IN", path.display(), "CSV or WAV: it is an MCAP recording already")),
            Ok(Format::Wav) => {
                let frames = WavFrames::new(BufReader::new(file)).map_err(input)?;
                frames.check_length(bytes).map_err(input)?;
                let format = frames.format();
                let names = RecordDefaults::default().names_of(format.channels);
                let chosen = choose(&names, &args.channels)?;
                Ok(Self {
                    frames_at_most: frames.frames_at_most(bytes),
                    sample_rate_hz: args.rate.unwrap_or(format.sample_rate_hz.into()),
                    channels: chosen.iter().map(|&k| names[k].clone()).collect(),
                    whole_frame: vec![0.0; names.len()],
                    chosen,
                    frames: Frames::Wav(frames),
                })
            }
            // A header may begin with anything that is text, the byte order mark and letters of any language included.
            Err(RecordingError::Text { .. } | RecordingError::UnknownFormat { .. }) if looks_like_text(&beginning) => {
                let Some(sample_rate_hz) = args.rate else {
                    return Err(argument("--rate", "missing", "the sampling rate in hertz, which CSV does not have"));
                };
                if args.unit.is_none() {
                    return Err(argument(
                        "--unit",
                        "missing",
                        "the samples' unit (for example m/s2), which CSV does not have",
                    ));
                }
                let lines = count_lines(&mut file).map_err(cannot_open)?;
                let frames = CsvFrames::new(BufReader::new(file), &args.channels).map_err(input)?;
                Ok(Self {
                    frames_at_most: lines,
                    sample_rate_hz,
                    channels: frames.channels().to_vec(),
                    whole_frame: Vec::new(),
                    chosen: Vec::new(),
                    frames: Frames::Csv(frames),
                })
            }
            Err(error) => Err(input(error)),
        }
    }

    pub(super) fn next_frame(&mut self, frame: &mut [f32]) -> Result<bool, RecordingError> {
        match &mut self.frames {
            Frames::Csv(frames) => frames.next_frame(frame),
            Frames::Wav(frames) => {
                let more = frames.next_frame(&mut self.whole_frame)?;
                for (sample, &k) in frame.iter_mut().zip(&self.chosen) {
                    *sample = self.whole_frame[k];
                }
                Ok(more)
            }
        }
    }
}

/// Indices of the wanted channels among a WAV's.
fn choose(names: &[String], wanted: &[String]) -> Result<Vec<usize>, ConvertError> {
    if wanted.is_empty() {
        return Ok((0..names.len()).collect());
    }
    let find = |name: &String| {
        names
            .iter()
            .position(|own| own == name)
            .ok_or_else(|| argument("--channels", name, "numbers of the WAV's channels, counted from 1"))
    };
    wanted.iter().map(find).collect()
}

fn looks_like_text(beginning: &[u8]) -> bool {
    beginning.iter().all(|&byte| byte >= b' ' || byte.is_ascii_whitespace())
}

/// Counts line ends, an upper bound of a CSV's frames, and goes back to the beginning.
fn count_lines(file: &mut File) -> std::io::Result<u64> {
    let mut buffer = vec![0; 1 << 16];
    let mut lines = 1;
    loop {
        let read = file.read(&mut buffer)?;
        if read == 0 {
            file.seek(SeekFrom::Start(0))?;
            return Ok(lines);
        }
        lines += buffer[..read].iter().filter(|&&byte| byte == b'\n').count() as u64;
    }
}
