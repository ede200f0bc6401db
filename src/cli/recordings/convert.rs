//! `flankwatch convert`: converts recordings to MCAP or WAV.

mod source;

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use clap::Args;
use jiff::Timestamp;

use super::reading_progress::ReadingProgress;
use super::recording_files::recording_files;
use super::recording_values::{RecordingValues, parse_rate};
use crate::asset::AssetId;
use crate::cli::CliError;
use crate::cli::output::{PartialFile, counted, print_stderr};
use crate::cli::output_check::{check_apart, check_new};
use crate::recording::{
    Cut, Frames, McapOptions, McapWriter, RecordBlocks, RecordDefaults, RecordingError, TimeOfDay, WavWriter,
};
use crate::signal::OperatingPoint;
use source::Source;

/// Frames between two steps of the progress bar.
const FRAMES_PER_STEP: u64 = 1 << 14;

/// Arguments of `flankwatch convert`.
#[derive(Debug, Clone, Args)]
pub(in crate::cli) struct ConvertArgs {
    /// Recordings to read: WAV, FLAC, CSV (may be .csv.gz), MATLAB v5 or NumPy files, folders or patterns
    #[arg(value_name = "IN", required = true)]
    pub inputs: Vec<PathBuf>,
    /// File to write: .mcap, or .wav with 32-bit floating-point samples
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// Sampling rate in Hz; required where a recording has none, overrides that of a WAV or FLAC header
    #[arg(long, value_name = "HZ", value_parser = parse_rate)]
    pub rate: Option<f64>,
    /// Unit of the samples, such as m/s2 or g; required for MCAP where the recording does not state it
    #[arg(long)]
    pub unit: Option<String>,
    /// Asset that the recording belongs to: the first part of its MCAP topics [default: gearbox]
    #[arg(long, value_name = "ID")]
    pub asset: Option<String>,
    /// Channels to convert, in this order, by name or, in CSV, number of the column from 1 [default: all]
    #[arg(long, value_delimiter = ',', value_name = "A,B")]
    pub channels: Vec<String>,
    /// Rotational frequency of the driving shaft in Hz
    #[arg(long, value_name = "HZ", allow_negative_numbers = true)]
    pub shaft_speed_hz: Option<f64>,
    /// Torque on the driving shaft in N·m
    #[arg(long, value_name = "NM", allow_negative_numbers = true)]
    pub torque_nm: Option<f64>,
    /// Length of the MCAP records in seconds [default: one record up to 2 minutes, above that 10]
    ///
    /// A remainder below half a record is dropped.
    #[arg(long, value_name = "S")]
    pub record_seconds: Option<f64>,
    #[command(flatten)]
    values: RecordingValues,
    /// Replace OUT if it exists
    #[arg(long)]
    pub force: bool,
}

/// Converts recordings, in bounded memory. The output appears under its name only when it is complete.
pub(in crate::cli) fn run(args: &ConvertArgs) -> Result<(), CliError> {
    let target = Target::of(&args.output)?;
    check_new(&args.output, args.force)?;
    let asset = args.asset.as_deref().unwrap_or("gearbox");
    let asset = AssetId::new(asset).map_err(|error| CliError::Argument(format!("--asset: {error}")))?;
    if args.unit.as_deref() == Some("") {
        return Err(CliError::argument("--unit", "empty", "the samples' unit, such as m/s2 (1 for none)"));
    }
    let inputs = recording_files(&args.inputs)?;
    check_apart("OUT", &args.output, inputs.iter().map(PathBuf::as_path), "the recordings")?;
    if target == Target::Wav {
        for (option, is_given) in [
            ("--asset", args.asset.is_some()),
            ("--shaft-speed-hz", args.shaft_speed_hz.is_some()),
            ("--torque-nm", args.torque_nm.is_some()),
            ("--record-seconds", args.record_seconds.is_some()),
        ] {
            if is_given {
                let output = args.output.display();
                return Err(CliError::Argument(format!("{option} is given for {output}, expected an .mcap")));
            }
        }
    }
    let partial = PartialFile::create(&args.output)?;
    let mut progress = ReadingProgress::new(&inputs);
    let written = match target {
        Target::Mcap => write_mcap(args, &asset, &inputs, &partial.file, &mut progress),
        Target::Wav => write_wav(args, &inputs, &partial.file, &mut progress),
    }?;
    drop(progress);
    partial.complete()?;
    print_stderr(&format!("{}: {written}", args.output.display()));
    Ok(())
}

/// The output format, by the extension of OUT.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Target {
    Mcap,
    Wav,
}

impl Target {
    fn of(path: &Path) -> Result<Self, CliError> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        match extension.as_deref() {
            Some("mcap") => Ok(Self::Mcap),
            Some("wav") => Ok(Self::Wav),
            _ => Err(CliError::argument("OUT", path.display(), "a name that ends in .mcap or .wav")),
        }
    }
}

/// Returns the values that a recording may lack; it begins at `start_time`.
fn defaults_of(args: &ConvertArgs, path: &Path, start_time: Timestamp) -> Result<RecordDefaults, CliError> {
    let mut defaults = RecordDefaults {
        start_time,
        time_of_day: TimeOfDay::FromStart,
        sample_rate_hz: args.rate,
        unit: args.unit.clone(),
        operating_point: OperatingPoint {
            shaft_speed_hz: args.shaft_speed_hz,
            torque_nm: args.torque_nm,
            ..OperatingPoint::default()
        },
        ..RecordDefaults::default()
    };
    args.values.apply(path, &mut defaults)?;
    Ok(defaults)
}

/// Writes one message per record and channel; returns a summary.
fn write_mcap(
    args: &ConvertArgs,
    asset: &AssetId,
    inputs: &[PathBuf],
    file: &File,
    progress: &mut ReadingProgress,
) -> Result<String, CliError> {
    let output = CliError::file(&args.output);
    let mut writer = McapWriter::new(BufWriter::new(file), McapOptions::default()).map_err(&output)?;
    let mut next_start = args.values.start_time();
    let (mut records, mut channels, mut cut_seconds) = (0_u64, Vec::<String>::new(), None);
    for path in inputs {
        let input = CliError::recording(path);
        progress.begin(path);
        let defaults = defaults_of(args, path, next_start)?;
        let source = Source::open(path, args, &defaults)?;
        let gives_unit = defaults.unit.is_some() || defaults.sensitivity_mv_per_g.is_some();
        if let Some(channel) = source.channel_without_unit().filter(|_| !gives_unit) {
            let expected =
                format!("the samples' unit, such as m/s2: {path:?} does not give that of {channel:?}");
            return Err(CliError::argument("--unit", "missing", expected));
        }
        for channel in source.channels() {
            if !channels.contains(channel) {
                channels.push(channel.clone());
            }
        }
        let mut blocks =
            RecordBlocks::new(source, &defaults, args.record_seconds.map(Cut::Seconds)).map_err(&input)?;
        cut_seconds = cut_seconds.or(blocks.default_cut_seconds());
        while let Some(record) = blocks.next() {
            let record = record.map_err(&input)?;
            let topic = format!("/{asset}/{}/waveform", record.channel());
            writer.write(&topic, &record).map_err(&output)?;
            records += 1;
            progress.set_read(blocks.frames().bytes_read());
        }
        next_start = next_start.max(blocks.end_time());
    }
    let mut inner = writer.finish().map_err(&output)?;
    inner.flush().map_err(|error| output(error.into()))?;
    let note = cut_seconds
        .map_or(String::new(), |seconds| format!(" of {seconds} s (change with --record-seconds)"));
    Ok(format!("{}{note}, {}", counted(records, "record"), channels_text(&channels)))
}

/// Writes the selected channels of one recording, interleaved; returns a summary.
fn write_wav(
    args: &ConvertArgs,
    inputs: &[PathBuf],
    file: &File,
    progress: &mut ReadingProgress,
) -> Result<String, CliError> {
    let [path] = inputs else {
        let expected = "a name that ends in .mcap for several recordings: a WAV has one".to_owned();
        return Err(CliError::argument("OUT", args.output.display(), expected));
    };
    let output = CliError::file(&args.output);
    let input = CliError::recording(path);
    progress.begin(path);
    let defaults = defaults_of(args, path, args.values.start_time())?;
    let mut source = Source::open(path, args, &defaults)?;
    let channels = source.channels().to_vec();
    let mut writer =
        WavWriter::new(BufWriter::new(file), channels.len(), source.sample_rate_hz()).map_err(&output)?;
    let units = source.units_and_scales(&defaults).map_err(&input)?;
    let mut frame = vec![0.0; channels.len()];
    let mut frames = 0_u64;
    while source.next_frame(&mut frame).map_err(&input)? {
        for (sample, (_, scale)) in frame.iter_mut().zip(&units) {
            *sample = scale.map_or(*sample, |scale| (f64::from(*sample) * scale) as f32);
        }
        if let Some(k) = frame.iter().position(|sample| !sample.is_finite()) {
            return Err(input(RecordingError::field(
                "a sample",
                format!("{} (channel {:?}, sample {frames})", frame[k], channels[k]),
                "a finite number",
            )));
        }
        writer.write_frame(&frame).map_err(&output)?;
        frames += 1;
        if frames.is_multiple_of(FRAMES_PER_STEP) {
            progress.set_read(source.bytes_read());
        }
    }
    if frames == 0 {
        return Err(input(RecordingError::field("the number of samples", 0, "at least 1")));
    }
    writer.finish().map_err(&output)?;
    Ok(format!("{}, {}", counted(frames, "sample"), channels_text(&channels)))
}

fn channels_text(channels: &[String]) -> String {
    format!("channel{} {}", if channels.len() == 1 { "" } else { "s" }, channels.join(", "))
}

#[cfg(test)]
mod tests;
