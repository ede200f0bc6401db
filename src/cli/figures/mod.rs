//! `flankwatch figures`: the paper's figures from this model on one page, with what its text says about them
//! held against it.

mod page;
mod panel;

use std::path::PathBuf;

use clap::Args;

use super::library::progress_bar;
use super::{CliError, output, pair_file};
use crate::figures::{self, FigureSettings};
use crate::gear::ContactRule;

/// Arguments of `flankwatch figures`.
#[derive(Debug, Args)]
pub(super) struct FiguresArgs {
    /// The page, an HTML file that needs no other
    #[arg(long)]
    out: PathBuf,
    /// All numbers and checks as JSON
    #[arg(long)]
    data: Option<PathBuf>,
    /// The gear pair; the pair of Shen et al. 2022 where not given
    #[arg(long)]
    pair: Option<PathBuf>,
    /// Greatest wear depths of Wear01, Wear02 and Wear03 in µm
    #[arg(long, num_args = 3, value_names = ["SLIGHT", "MODERATE", "SEVERE"])]
    wear_um: Option<Vec<f64>>,
    /// Length of each simulated record in seconds
    #[arg(long, default_value_t = FigureSettings::default().seconds)]
    seconds: f64,
    /// Sampling rate of each simulated record in hertz
    #[arg(long, default_value_t = FigureSettings::default().sample_rate_hz)]
    rate: f64,
}

/// Runs the command. A statement that does not hold is a result, not a failure.
pub(super) fn run(args: &FiguresArgs) -> Result<(), CliError> {
    let mut settings =
        FigureSettings { seconds: args.seconds, sample_rate_hz: args.rate, ..FigureSettings::default() };
    if let Some(&[slight, moderate, severe]) = args.wear_um.as_deref() {
        settings.wear_um = [slight, moderate, severe];
    }
    let mut pair = pair_file::read(args.pair.as_deref())?;
    // The figures are about the paper's own multi-tooth rule, whatever the pair file asks for otherwise.
    pair.dynamics.contact = ContactRule::Threshold;
    let bar = progress_bar(u64::from(settings.states), "wear states");
    let figures = figures::compute(&pair, &settings, &|done| bar.set_position(done as u64))?;
    bar.finish_and_clear();
    output::write_file(&args.out, page::html(&figures).as_bytes())?;
    if let Some(path) = &args.data {
        let json = serde_json::to_vec(&figures)
            .map_err(|error| CliError::Io { path: path.clone(), source: error.into() })?;
        output::write_file(path, &json)?;
    }
    let holding = figures.checks.iter().filter(|check| check.holds).count();
    let mut text = String::new();
    for check in &figures.checks {
        let verdict = if check.holds { "holds   " } else { "does not" };
        text += &format!("Fig. {:<2}  {verdict}  {} {}\n", check.figure, check.statement, check.measured);
    }
    text += &format!(
        "{holding} of {} statements hold; figures in {}\n",
        figures.checks.len(),
        args.out.display()
    );
    output::print(&text)
}
