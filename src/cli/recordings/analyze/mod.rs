//! `flankwatch analyze`: computes indicators and wear of recordings, without a server.

mod analysis;
mod csv;
mod envelope;
mod record;
mod table;
mod verdict;

use std::fs;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use self::analysis::Analysis;
use self::envelope::EnvelopeArg;
use self::table::Column;
use super::reading_progress::ReadingProgress;
use super::recording_files::recording_files;
use super::recording_values::{RecordingValues, parse_rate};
use crate::asset::AssetSpec;
use crate::cli::output_check::{OutputKind, check_apart, check_result};
use crate::cli::simulation::ensemble::parse_members;
use crate::cli::{CliError, output};
use crate::library::EnsembleSettings;

/// Arguments of `flankwatch analyze`.
#[derive(Args)]
pub(in crate::cli) struct AnalyzeArgs {
    /// Recordings in time order, folders or patterns such as `day-*.wav`
    ///
    /// Reads WAV, FLAC, MCAP, CSV (also .csv.gz), MATLAB (.mat, v5) and NumPy (.npy). The files of folders
    /// and patterns are read in order of their names.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Channels to analyse, by name or, in CSV, number of the column from 1 [default: all]
    #[arg(long, value_delimiter = ',', value_name = "A,B")]
    channels: Vec<String>,
    /// Sampling rate in Hz; required where a recording has none, overrides that of a WAV or FLAC header
    #[arg(long, value_name = "HZ", value_parser = parse_rate)]
    rate: Option<f64>,
    #[command(flatten)]
    values: RecordingValues,
    /// Asset file (TOML): tooth counts, nominal speed, gear pair [default: only indicators that need no
    /// speed]
    #[arg(long, value_name = "FILE")]
    asset: Option<PathBuf>,
    /// Output format
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
    /// Additional table columns: names of indicators, `channel`, `file` or `angle`
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    columns: Vec<String>,
    /// Write an HTML report to this file
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Split recordings other than MCAP into records of this length in seconds; a remainder below half of it
    /// is dropped
    #[arg(long, value_name = "S")]
    record_seconds: Option<f64>,
    /// Rotational frequency of the driving shaft in Hz, for recordings without one
    #[arg(long, value_name = "HZ")]
    shaft_speed_hz: Option<f64>,
    /// Torque on the driving shaft in N·m, for recordings without one
    #[arg(long, value_name = "NM")]
    torque_nm: Option<f64>,
    /// Add the 8 highest lines of each record's envelope spectrum to the JSON output, in this band
    ///
    /// asset: the band of the asset file; mesh: around the strongest mesh harmonic; kurtogram: the band with
    /// the highest spectral kurtosis; LOW,HIGH: limits in Hz.
    #[arg(long, value_name = "asset|mesh|kurtogram|LOW,HIGH")]
    envelope: Option<EnvelopeArg>,
    /// Data folder; libraries are cached in its folder `libraries`
    #[arg(long, value_name = "DIR", default_value = "flankwatch-data")]
    data_dir: PathBuf,
    /// Number of varied gear pairs (ensemble members) to estimate with, up to 10240; 0 uses only the
    /// described pair
    #[arg(long, default_value_t = EnsembleSettings::default().members, value_parser = parse_members)]
    members: usize,
}

/// Output formats.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Aligned columns
    Table,
    /// One JSON array with an object per record
    Json,
    /// One line per record
    Csv,
}

/// Runs the command.
pub(in crate::cli) fn run(args: &AnalyzeArgs) -> Result<(), CliError> {
    let asset = args.asset.as_deref().map(read_asset).transpose()?;
    let columns = Column::parse(&args.columns, asset.as_ref())?;
    let files = recording_files(&args.files)?;
    check_options(args, &files)?;
    let mut analysis = Analysis::new(args, asset);
    let mut next_start = args.values.start_time();
    let mut failed = 0;
    let mut progress = ReadingProgress::new(&files);
    for path in &files {
        progress.begin(path);
        if let Err(error) = analysis.analyze_file(path, &mut next_start, &progress) {
            progress.print(&format!("error: {error}"));
            failed += 1;
        }
    }
    drop(progress);
    // What is computed already is printed all the same.
    let estimated = analysis.estimate_wear();
    output::print(&match args.format {
        Format::Table => table::table(&analysis.records, &columns),
        Format::Json => {
            serde_json::to_string_pretty(&analysis.records).expect("records hold finite numbers and strings")
                + "\n"
        }
        Format::Csv => csv::csv(&analysis.records),
    })?;
    if let Some(path) = &args.report {
        output::write_file(path, analysis.report().html().as_bytes())?;
    }
    estimated?;
    if failed > 0 {
        return Err(CliError::SomeFailed { action: "read", failed, all: files.len() });
    }
    Ok(())
}

/// Rejects options that have no effect, and a report that cannot be written.
fn check_options(args: &AnalyzeArgs, files: &[PathBuf]) -> Result<(), CliError> {
    if !args.columns.is_empty() && args.format != Format::Table {
        let detail = "--columns is given with another format, expected --format table";
        return Err(CliError::Argument(detail.to_owned()));
    }
    if args.envelope.is_some() && args.format != Format::Json {
        let detail = "--envelope is given with another format, expected --format json";
        return Err(CliError::Argument(detail.to_owned()));
    }
    let Some(report) = &args.report else { return Ok(()) };
    let inputs = files.iter().chain(&args.asset).map(PathBuf::as_path);
    check_apart("--report", report, inputs, "the recordings and the asset file")?;
    check_result(report, OutputKind::Page)
}

fn read_asset(path: &Path) -> Result<AssetSpec, CliError> {
    let text = fs::read_to_string(path).map_err(CliError::file(path))?;
    AssetSpec::from_toml(&text).map_err(CliError::file(path))
}
