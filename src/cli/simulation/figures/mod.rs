//! `flankwatch figures`: reproduces the paper's figures on one page and checks the paper's statements about
//! them.

mod page;
mod panel;

use std::path::PathBuf;

use clap::Args;

use super::library::progress_bar;
use super::pair_file;
use crate::cli::output_check::{OutputKind, check_apart, check_result};
use crate::cli::{CliError, output};
use crate::figures::{self, FigureSettings, FiguresError};
use crate::gear::ContactRule;

/// Arguments of `flankwatch figures`.
#[derive(Debug, Args)]
pub(in crate::cli) struct FiguresArgs {
    /// HTML file to write, self-contained
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// JSON file to write all numbers and checks to
    #[arg(long, value_name = "FILE")]
    data: Option<PathBuf>,
    /// Gear pair file (TOML) [default: the pair of Shen et al. 2022]
    #[arg(long, value_name = "FILE")]
    pair: Option<PathBuf>,
    /// Maximum wear depths of Wear01, Wear02 and Wear03 in µm
    #[arg(long, num_args = 3, value_names = ["SLIGHT", "MODERATE", "SEVERE"])]
    wear_um: Option<Vec<f64>>,
    /// Length of each simulated record in seconds
    #[arg(long, value_name = "S", default_value_t = FigureSettings::default().seconds)]
    seconds: f64,
    /// Sampling rate of each simulated record in Hz
    #[arg(long, value_name = "HZ", default_value_t = FigureSettings::default().sample_rate_hz)]
    rate: f64,
}

/// Checks the outputs before the simulation.
fn check_outputs(args: &FiguresArgs) -> Result<(), CliError> {
    let pair = args.pair.as_deref();
    check_apart("--out", &args.out, pair, "the gear pair file")?;
    check_result(&args.out, OutputKind::Page)?;
    let Some(data) = &args.data else { return Ok(()) };
    check_apart("--data", data, pair, "the gear pair file")?;
    check_apart("--data", data, [args.out.as_path()], "--out")?;
    check_result(data, OutputKind::Json)
}

/// Runs the command. A statement that fails its check is a result, not an error.
pub(in crate::cli) fn run(args: &FiguresArgs) -> Result<(), CliError> {
    let mut settings =
        FigureSettings { seconds: args.seconds, sample_rate_hz: args.rate, ..FigureSettings::default() };
    if let Some(&[slight, moderate, severe]) = args.wear_um.as_deref() {
        settings.wear_um = [slight, moderate, severe];
    }
    check_outputs(args)?;
    let mut pair = pair_file::read(args.pair.as_deref())?;
    // The figures show the paper's multi-tooth rule, whatever rule the pair file has.
    pair.dynamics.contact = ContactRule::Threshold;
    let bar = progress_bar(u64::from(settings.states), "wear states");
    let figures = figures::compute(&pair, &settings, &|done| bar.set_position(done as u64));
    let figures = figures.map_err(|error| match error {
        FiguresError::Gear(error) => {
            let [slight, moderate, severe] = settings.wear_um;
            CliError::wear("--wear-um", format!("{slight} {moderate} {severe} µm"), error)
        }
        FiguresError::Setting { field: "wear_um", value, expected } => {
            CliError::argument("--wear-um", value, expected)
        }
        error => error.into(),
    })?;
    bar.finish_and_clear();
    output::write_file(&args.out, page::html(&figures).as_bytes())?;
    if let Some(path) = &args.data {
        let json = serde_json::to_vec(&figures).map_err(CliError::file(path))?;
        output::write_file(path, &json)?;
    }
    let holding = figures.checks.iter().filter(|check| check.holds).count();
    let mut text = String::new();
    for check in &figures.checks {
        let verdict = if check.holds { "holds" } else { "fails" };
        text += &format!("Fig. {:<2}  {verdict}  {} {}\n", check.figure, check.statement, check.measured);
    }
    text += &format!(
        "{holding} of {} statements hold; figures in {}\n",
        figures.checks.len(),
        args.out.display()
    );
    output::print(&text)
}
