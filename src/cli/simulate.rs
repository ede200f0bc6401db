//! `flankwatch simulate`: a synthetic run to failure with the true wear known.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufWriter, Cursor};
use std::path::{Path, PathBuf};

use clap::Args;
use indicatif::ProgressBar;
use jiff::Timestamp;
use rayon::prelude::*;

use super::library::progress_bar;
use super::{CliError, output, pair_file};
use crate::recording::{McapCompression, McapOptions, McapWriter, WavWriter};
use crate::signal::Record;
use crate::simulation::{Run, RunPlan, SimulatedRecord};

/// Records simulated side by side before they are written in order.
const BATCH: u32 = 8;

/// Arguments of `flankwatch simulate`.
#[derive(Args)]
pub(super) struct SimulateArgs {
    /// An MCAP file (`RUN.mcap`), or a folder of WAV files, one a record (`RUN.wav`)
    #[arg(long)]
    out: PathBuf,
    /// The gear pair; the pair of Shen et al. 2022 where not given
    #[arg(long)]
    pair: Option<PathBuf>,
    /// Number of records
    #[arg(long, default_value_t = 300)]
    records: u32,
    /// Length of each record in seconds
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Sampling rate in hertz
    #[arg(long, default_value_t = 20_000.0)]
    rate: f64,
    /// Seed of the transmission path, the noise and the operating points
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Greatest wear depth of the last record in µm; 245 at module 6 mm, in proportion to the module, where
    /// not given
    #[arg(long)]
    max_wear_um: Option<f64>,
    /// Wear grows with time to this power
    #[arg(long, default_value_t = 1.5)]
    wear_exponent: f64,
    /// Ratio of the healthy vibration to the sensor noise in dB
    #[arg(long, default_value_t = 10.0)]
    snr_db: f64,
    /// The speed of each record lies within this fraction of nominal
    #[arg(long, default_value_t = 0.005)]
    speed_variation: f64,
    /// The torque of each record lies within this fraction of nominal
    #[arg(long, default_value_t = 0.02)]
    torque_variation: f64,
    /// Time of the first sample
    #[arg(long, default_value = "2026-01-01T00:00:00Z")]
    start_time: Timestamp,
    /// Seconds from one record's start to the next one's
    #[arg(long, default_value_t = 60.0)]
    interval: f64,
    /// Asset in the MCAP topics
    #[arg(long, default_value = "simulated")]
    asset: String,
}

/// Runs the command.
pub(super) fn run(args: &SimulateArgs) -> Result<(), CliError> {
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
    })?;
    let bar = progress_bar(u64::from(args.records), "records");
    match args.out.extension().and_then(|extension| extension.to_str()) {
        Some("mcap") => write_mcap(args, &run, &bar)?,
        Some("wav") => write_wav_folder(args, &run, &bar)?,
        _ => {
            return Err(CliError::Argument(format!(
                "--out is {}, expected a name that ends in .mcap or .wav",
                args.out.display()
            )));
        }
    }
    bar.finish_and_clear();
    output::print(&format!("{} records of {} s in {}\n", args.records, args.seconds, args.out.display()))
}

/// Simulates every record in parallel batches and hands them on in order.
fn for_each_record(
    run: &Run,
    mut take: impl FnMut(u32, SimulatedRecord) -> Result<(), CliError>,
) -> Result<(), CliError> {
    let records = run.plan().records;
    for first in (0..records).step_by(BATCH as usize) {
        let batch: Vec<_> = (first..records.min(first + BATCH))
            .into_par_iter()
            .map(|index| (index, run.record(index)))
            .collect();
        for (index, record) in batch {
            take(index, record?)?;
        }
    }
    Ok(())
}

fn write_mcap(args: &SimulateArgs, run: &Run, bar: &ProgressBar) -> Result<(), CliError> {
    let temporary = args.out.with_extension("mcap.part");
    let file = File::create(&temporary).map_err(CliError::io(&temporary))?;
    // The noise of a vibration does not compress: zstd takes 7 % off, and twice as long to read back as the
    // SHA-256 of what it gives.
    let options = McapOptions { compression: McapCompression::None };
    let mut writer =
        McapWriter::new(BufWriter::new(file), options).map_err(CliError::recording(&args.out))?;
    let mut truth = BTreeMap::new();
    for index in 0..args.records {
        truth.insert(run.start_time(index).as_nanosecond().to_string(), run.wear_um(index).to_string());
    }
    writer.metadata("reference_wear", truth).map_err(CliError::recording(&args.out))?;
    let pair = toml::to_string(&run.plan().pair)
        .map_err(|error| CliError::Argument(format!("the gear pair cannot be written: {error}")))?;
    writer
        .metadata("gear_pair", BTreeMap::from([("toml".to_owned(), pair)]))
        .map_err(CliError::recording(&args.out))?;
    let acquisition = [
        ("source", "flankwatch simulate".to_owned()),
        ("seed", args.seed.to_string()),
        ("snr_db", args.snr_db.to_string()),
    ];
    let acquisition = acquisition.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
    writer.metadata("acquisition", acquisition).map_err(CliError::recording(&args.out))?;
    let topic = format!("/{}/{}/waveform", args.asset, run.plan().channel);
    for_each_record(run, |_, simulated| {
        writer.write(&topic, &simulated.record).map_err(CliError::recording(&args.out))?;
        bar.inc(1);
        Ok(())
    })?;
    let file = writer.finish().map_err(CliError::recording(&args.out))?;
    let file = file
        .into_inner()
        .map_err(|error| CliError::Io { path: temporary.clone(), source: error.into_error() })?;
    file.sync_all().and_then(|()| fs::rename(&temporary, &args.out)).map_err(CliError::io(&args.out))
}

fn write_wav_folder(args: &SimulateArgs, run: &Run, bar: &ProgressBar) -> Result<(), CliError> {
    fs::create_dir_all(&args.out).map_err(CliError::io(&args.out))?;
    let mut truth = "file,start_time,wear_um\n".to_owned();
    for_each_record(run, |index, simulated| {
        let name = format!("record-{index:05}.wav");
        let path: &Path = &args.out.join(&name);
        write_wav(path, &simulated.record)?;
        truth += &format!("{name},{},{}\n", simulated.record.start_time(), simulated.wear_um);
        bar.inc(1);
        Ok(())
    })?;
    output::write_file(&args.out.join("reference_wear.csv"), truth.as_bytes())
}

fn write_wav(path: &Path, record: &Record) -> Result<(), CliError> {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer =
        WavWriter::new(&mut bytes, 1, record.sample_rate_hz()).map_err(CliError::recording(path))?;
    for &sample in record.samples() {
        writer.write_frame(&[sample]).map_err(CliError::recording(path))?;
    }
    writer.finish().map_err(CliError::recording(path))?;
    output::write_file(path, bytes.get_ref())
}
