//! `flankwatch analyze`: indicators and wear of recordings, without a server.

mod analysis;
mod csv;
mod envelope;
mod record;
mod table;
mod verdict;

use std::fs;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use jiff::Timestamp;

use self::analysis::Analysis;
use self::envelope::EnvelopeArg;
use self::table::Column;
use super::recording_values::RecordingValues;
use super::{CliError, output, recording_files::recording_files};
use crate::asset::AssetSpec;
use crate::library::EnsembleSettings;

/// Arguments of `flankwatch analyze`.
#[derive(Args)]
pub(super) struct AnalyzeArgs {
    /// WAV, FLAC, MCAP, CSV (.csv.gz too), MATLAB (.mat, v5) or NumPy (.npy) recordings in time order, or
    /// folders of them and patterns such as `day-*.wav`, which are taken in the order of names
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Sampling rate in hertz of CSV and MATLAB files that do not say it, and of NumPy arrays
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    #[command(flatten)]
    values: RecordingValues,
    /// The machine: tooth numbers, nominal speed, gear pair. Without it, indicators that need no speed
    #[arg(long)]
    asset: Option<PathBuf>,
    /// How to print
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
    /// Further columns of the table: indicators by name, `channel`, `file`, `angle`
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    columns: Vec<String>,
    /// Write a report for a browser or a printer
    #[arg(long)]
    report: Option<PathBuf>,
    /// Cut recordings into records of this length in seconds; a rest of less than half of it is left out
    #[arg(long)]
    record_seconds: Option<f64>,
    /// Time of the first sample of the first recording that does not say; later ones follow on it
    #[arg(long, default_value = "1970-01-01T00:00:00Z")]
    start_time: Timestamp,
    /// Rotational frequency of the driving shaft in hertz, where the recording does not say
    #[arg(long)]
    shaft_speed_hz: Option<f64>,
    /// Torque on the driving shaft in N·m, where the recording does not say
    #[arg(long)]
    torque_nm: Option<f64>,
    /// Envelope spectrum of each record, in JSON, in the asset's band (asset), around the strongest mesh
    /// harmonic (mesh), in the band that the fast kurtogram finds (kurtogram), or from LOW to HIGH hertz
    #[arg(long, value_name = "asset|mesh|kurtogram|LOW,HIGH")]
    envelope: Option<EnvelopeArg>,
    /// Folder of the service's data; libraries are kept in its `libraries`
    #[arg(long, default_value = "flankwatch-data")]
    data_dir: PathBuf,
    /// Pairs like the described one that the estimate is made with; 0 for the described pair alone
    #[arg(long, default_value_t = EnsembleSettings::default().members)]
    members: usize,
}

/// How results are printed.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Aligned columns for people
    Table,
    /// One array, an object a record
    Json,
    /// A line a record
    Csv,
}

/// Runs the command.
pub(super) fn run(args: &AnalyzeArgs) -> Result<(), CliError> {
    let asset = args.asset.as_deref().map(read_asset).transpose()?;
    let columns = Column::chosen(&args.columns, asset.as_ref())?;
    let mut analysis = Analysis::new(args, asset);
    let mut next_start = args.start_time;
    let mut failed = 0;
    let files = recording_files(&args.files)?;
    for path in &files {
        if let Err(error) = analysis.take_file(path, &mut next_start) {
            eprintln!("error: {error}");
            failed += 1;
        }
    }
    analysis.estimate_wear()?;
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
    if failed > 0 {
        return Err(CliError::SomeFailed { failed, all: files.len() });
    }
    Ok(())
}

fn read_asset(path: &Path) -> Result<AssetSpec, CliError> {
    let text = fs::read_to_string(path).map_err(CliError::io(path))?;
    AssetSpec::from_toml(&text).map_err(|source| CliError::Asset { path: path.to_owned(), source })
}
