//! `flankwatch simulate`: simulates a run to failure with known wear.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{BufWriter, Cursor, Write};
use std::path::{Path, PathBuf};

use clap::Args;
use indicatif::ProgressBar;
use jiff::Timestamp;
use rayon::prelude::*;

use super::library::progress_bar;
use super::pair_file;
use crate::cli::client::server::asset_id;
use crate::cli::output_check::{check_apart, check_new, check_place};
use crate::cli::time::parse_time;
use crate::cli::{CliError, output};
use crate::recording::{McapCompression, McapOptions, McapWriter, WavWriter};
use crate::signal::Record;
use crate::simulation::{Run, RunPlan, SimulatedRecord, SimulationError};

/// The file with the true wear depths, beside the records of a run.
pub(in crate::cli) const TRUTH_FILE_NAME: &str = "truth.csv";

/// The asset in the topics of a run by default.
const ASSET: &str = "simulated";

/// Number of records simulated in parallel before they are written in order.
const BATCH: u32 = 8;

/// Arguments of `flankwatch simulate`.
#[derive(Args)]
pub(in crate::cli) struct SimulateArgs {
    /// Output: an MCAP file (`RUN.mcap`), or a folder with a WAV file per record and a truth.csv (`RUN.wav`)
    #[arg(long)]
    out: PathBuf,
    /// Gear pair file (TOML) [default: the pair of Shen et al. 2022]
    #[arg(long, value_name = "FILE")]
    pair: Option<PathBuf>,
    /// Number of records
    #[arg(long, default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    records: u32,
    /// Length of each record in seconds
    #[arg(long, value_name = "S", default_value_t = 10.0)]
    seconds: f64,
    /// Sampling rate in Hz
    #[arg(long, value_name = "HZ", default_value_t = 20_000.0)]
    rate: f64,
    /// Random seed of the transmission path, the noise and the operating points
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Maximum wear depth of the last record in µm [default: 245 at module 6 mm, proportional to the module]
    #[arg(long, value_name = "UM")]
    max_wear_um: Option<f64>,
    /// Exponent of wear growth: wear is proportional to time to this power
    #[arg(long, value_name = "POWER", default_value_t = 1.5)]
    wear_exponent: f64,
    /// Signal-to-noise ratio of the healthy vibration to the sensor noise in dB
    #[arg(long, value_name = "DB", default_value_t = 10.0)]
    snr_db: f64,
    /// Maximum deviation of each record's speed, as a fraction of nominal
    #[arg(long, value_name = "FRACTION", default_value_t = 0.005)]
    speed_variation: f64,
    /// Maximum deviation of each record's torque, as a fraction of nominal
    #[arg(long, value_name = "FRACTION", default_value_t = 0.02)]
    torque_variation: f64,
    /// Time of the first sample
    #[arg(long, value_name = "TIME", default_value = "2026-01-01T00:00:00Z", value_parser = parse_time)]
    start_time: Timestamp,
    /// Time between the starts of two records in seconds
    #[arg(long, value_name = "S", default_value_t = 60.0)]
    interval: f64,
    /// Asset identifier in the MCAP topics [default: simulated]
    #[arg(long, value_name = "ID")]
    asset: Option<String>,
    /// Replace the file or the records of the folder if they exist
    #[arg(long)]
    force: bool,
}

/// Runs the command.
pub(in crate::cli) fn run(args: &SimulateArgs) -> Result<(), CliError> {
    check_output(args)?;
    let pair = pair_file::read(args.pair.as_deref())?;
    let run = Run::new(RunPlan {
        max_wear_um: args.max_wear_um.unwrap_or_else(|| pair.usual_wear_um()),
        pair,
        records: args.records,
        seconds: args.seconds,
        sample_rate_hz: args.rate,
        wear_exponent: args.wear_exponent,
        start_time: args.start_time,
        interval_s: args.interval,
        snr_db: args.snr_db,
        speed_variation: args.speed_variation,
        torque_variation: args.torque_variation,
        seed: args.seed,
        channel: "gearbox/x".to_owned(),
    });
    let run = run.map_err(|error| match error {
        SimulationError::Plan { field, value, expected } => CliError::option(field, value, expected),
        SimulationError::Gear(error) => {
            let depth = args
                .max_wear_um
                .map_or_else(|| "the default".to_owned(), |depth_um| format!("{depth_um} µm"));
            CliError::wear("--max-wear-um", depth, error)
        }
        error => error.into(),
    })?;
    let bar = progress_bar(u64::from(args.records), "records");
    if args.out.extension().is_some_and(|extension| extension == "mcap") {
        write_mcap(args, &run, &bar)?;
    } else {
        write_wav_folder(args, &run, &bar)?;
    }
    bar.finish_and_clear();
    let records = output::counted(args.records.into(), "record");
    output::print(&format!("{records} of {} s in {}\n", args.seconds, args.out.display()))
}

/// Checks the options before the simulation.
fn check_output(args: &SimulateArgs) -> Result<(), CliError> {
    if args.interval <= 0.0 {
        return Err(CliError::argument("--interval", args.interval, "a time above 0 s"));
    }
    if args.records > 1 && args.interval < args.seconds {
        let expected = format!("at least --seconds ({} s), as records must not overlap", args.seconds);
        return Err(CliError::argument("--interval", format!("{} s", args.interval), expected));
    }
    match (args.out.extension().and_then(|extension| extension.to_str()), &args.asset) {
        (Some("mcap"), asset) => {
            asset_id(asset.as_deref().unwrap_or(ASSET))?;
            check_apart("--out", &args.out, args.pair.as_deref(), "the gear pair file")?;
            check_new(&args.out, args.force)
        }
        (Some("wav"), None) => check_folder(args),
        (Some("wav"), Some(_)) => {
            let out = args.out.display();
            Err(CliError::Argument(format!("--asset is given for {out}, expected an .mcap")))
        }
        _ => Err(CliError::argument("--out", args.out.display(), "a name that ends in .mcap or .wav")),
    }
}

/// Simulates the records in parallel batches and passes them to `write` in order.
fn for_each_record(
    run: &Run,
    mut write: impl FnMut(u32, SimulatedRecord) -> Result<(), CliError>,
) -> Result<(), CliError> {
    let records = run.plan().records;
    for first in (0..records).step_by(BATCH as usize) {
        let batch: Vec<_> = (first..records.min(first + BATCH))
            .into_par_iter()
            .map(|index| (index, run.record(index)))
            .collect();
        for (index, record) in batch {
            write(index, record?)?;
        }
    }
    Ok(())
}

fn write_mcap(args: &SimulateArgs, run: &Run, bar: &ProgressBar) -> Result<(), CliError> {
    let partial = output::PartialFile::create(&args.out)?;
    // Vibration noise does not compress: zstd saves 7 %, and decompressing takes twice as long as hashing the
    // result with SHA-256.
    let options = McapOptions { compression: McapCompression::None };
    let mut writer =
        McapWriter::new(BufWriter::new(&partial.file), options).map_err(CliError::file(&args.out))?;
    let mut truth = BTreeMap::new();
    for index in 0..args.records {
        truth.insert(run.start_time(index).as_nanosecond().to_string(), run.wear_um(index).to_string());
    }
    writer.metadata("reference_wear", truth).map_err(CliError::file(&args.out))?;
    let pair = toml::to_string(&run.plan().pair)
        .map_err(|error| CliError::Argument(format!("failed to write the gear pair: {error}")))?;
    writer
        .metadata("gear_pair", BTreeMap::from([("toml".to_owned(), pair)]))
        .map_err(CliError::file(&args.out))?;
    let acquisition = [
        ("source", "flankwatch simulate".to_owned()),
        ("seed", args.seed.to_string()),
        ("snr_db", args.snr_db.to_string()),
    ];
    let acquisition = acquisition.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
    writer.metadata("acquisition", acquisition).map_err(CliError::file(&args.out))?;
    let asset = args.asset.as_deref().unwrap_or(ASSET);
    let topic = format!("/{asset}/{}/waveform", run.plan().channel);
    for_each_record(run, |_, simulated| {
        writer.write(&topic, &simulated.record).map_err(CliError::file(&args.out))?;
        bar.inc(1);
        Ok(())
    })?;
    writer.finish().map_err(CliError::file(&args.out))?.flush().map_err(CliError::file(&args.out))?;
    partial.complete()
}

fn wav_name(index: u32) -> String {
    format!("record-{index:05}.wav")
}

/// Refuses a folder with a WAV file that the run does not replace, as it would count as a record of the run;
/// without --force, also one with records that it replaces.
fn check_folder(args: &SimulateArgs) -> Result<(), CliError> {
    if !args.out.exists() {
        return check_place(&args.out);
    }
    let replaced: BTreeSet<PathBuf> = (0..args.records).map(|index| args.out.join(wav_name(index))).collect();
    for entry in fs::read_dir(&args.out).map_err(CliError::file(&args.out))? {
        let path = entry.map_err(CliError::file(&args.out))?.path();
        if path.extension().is_some_and(|extension| extension == "wav") && !replaced.contains(&path) {
            return Err(CliError::Argument(format!(
                "--out is {} and has {} already, expected a folder without records of another run",
                args.out.display(),
                path.file_name().unwrap_or_default().display()
            )));
        }
    }
    replaced.iter().try_for_each(|path| check_new(path, args.force))
}

fn write_wav_folder(args: &SimulateArgs, run: &Run, bar: &ProgressBar) -> Result<(), CliError> {
    fs::create_dir_all(&args.out).map_err(CliError::file(&args.out))?;
    let mut truth = "file,start_time,wear_um\n".to_owned();
    for_each_record(run, |index, simulated| {
        let name = wav_name(index);
        let path: &Path = &args.out.join(&name);
        write_wav(path, &simulated.record)?;
        truth += &format!("{name},{},{}\n", simulated.record.start_time(), simulated.wear_um);
        bar.inc(1);
        Ok(())
    })?;
    output::write_file(&args.out.join(TRUTH_FILE_NAME), truth.as_bytes())
}

fn write_wav(path: &Path, record: &Record) -> Result<(), CliError> {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = WavWriter::new(&mut bytes, 1, record.sample_rate_hz()).map_err(CliError::file(path))?;
    for &sample in record.samples() {
        writer.write_frame(&[sample]).map_err(CliError::file(path))?;
    }
    writer.finish().map_err(CliError::file(path))?;
    output::write_file(path, bytes.get_ref())
}
