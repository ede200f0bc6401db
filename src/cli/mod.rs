//! The command-line interface. A command's module parses its arguments, runs it and prints the result.

mod administration;
mod client;
mod completions;
mod error;
mod interrupt;
mod output;
mod output_check;
mod recordings;
mod service;
mod simulation;
mod time;

use std::io::{self, IsTerminal};
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use tracing::level_filters::LevelFilter;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use administration::{backup, cluster, dead_letters, quarantine, rebuild, token, verify};
use client::{export, records, replay, stream};
use recordings::{analyze, convert};
use service::{demo, serve, work};
use simulation::{evaluate, figures, library, model, simulate};

pub use error::CliError;

/// Condition monitoring of spur gears: estimates wear depth, with an interval, from vibration records.
#[derive(Parser)]
#[command(name = "flankwatch", version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run the service with a demonstration gearbox that wears towards its danger limit
    Demo(demo::DemoArgs),
    /// Run the service: HTTP API and dashboard
    Serve(serve::ServeArgs),
    /// Run a cluster worker, which analyses the records that the API nodes accept
    ///
    /// Any number of workers share the queue.
    #[command(hide = cfg!(not(feature = "nats")))]
    Work(work::WorkArgs),
    /// Show the status of a cluster: its queue and its workers
    #[command(hide = cfg!(not(feature = "nats")))]
    Cluster(cluster::ClusterArgs),
    /// List, show, retry or drop records that a cluster failed to store
    #[command(hide = cfg!(not(feature = "nats")))]
    DeadLetters(dead_letters::DeadLettersArgs),
    /// Compute indicators and wear of recordings, without a server
    Analyze(analyze::AnalyzeArgs),
    /// Send recordings to a server
    Replay(replay::ReplayArgs),
    /// Stream samples to a server as they are measured, from a pipe or a growing file
    Stream(stream::StreamArgs),
    /// Write the trend of an asset's indicators or wear on a server as a Parquet or CSV table
    Export(export::ExportArgs),
    /// Delete records from a server; their raw recordings move to quarantine
    ///
    /// The token needs the scope admin.
    Delete(records::RecordsArgs),
    /// Exclude records on a server from the asset's history, without deleting them
    Exclude(records::RecordsArgs),
    /// Include excluded records in the asset's history again
    Include(records::RecordsArgs),
    /// Set the records of a time range as the healthy baseline of an asset on a server
    Baseline(records::BaselineArgs),
    /// Simulate a run to failure with known wear
    Simulate(simulate::SimulateArgs),
    /// Evaluate the wear estimate on runs with known wear
    Evaluate(evaluate::EvaluateArgs),
    /// Compute mesh stiffness and transmission error of a gear pair over one mesh period
    Model(model::ModelArgs),
    /// Reproduce the figures of the model's paper and check its statements
    Figures(figures::FiguresArgs),
    /// Build, list and show libraries of simulated wear states
    Library(library::LibraryArgs),
    /// Convert recordings to MCAP or WAV
    Convert(convert::ConvertArgs),
    /// Create, list and revoke the API tokens of a service
    ///
    /// A running service applies a change at once, the nodes of a cluster within 2 s.
    Token(token::TokenArgs),
    /// Check the database against the raw recordings, also while the service is running
    ///
    /// Exits with an error if problems are found.
    Verify(verify::VerifyArgs),
    /// Back up a data folder, also while the service is running
    ///
    /// A backup into an earlier one copies only what is new.
    Backup(backup::BackupArgs),
    /// Restore a backup into a data folder that has no database
    Restore(backup::RestoreArgs),
    /// Rebuild the database from the raw recordings
    ///
    /// Imports every raw recording that the database lacks and recomputes derived data. The service must not
    /// be running.
    Rebuild(rebuild::RebuildArgs),
    /// List or restore unreferenced raw recordings before they are removed
    Quarantine(quarantine::QuarantineArgs),
    /// Print a shell completion script
    Completions(completions::CompletionsArgs),
    /// Write the manual pages
    #[command(hide = true)]
    Manual(completions::ManualArgs),
}

/// Returns the log levels by module from `FLANKWATCH_LOG` (`info,flankwatch::store=debug`), or the defaults.
fn log_filter() -> Result<Targets, CliError> {
    let Some(text) = std::env::var("FLANKWATCH_LOG").ok().filter(|text| !text.is_empty()) else {
        return Ok(Targets::new()
            .with_default(LevelFilter::WARN)
            .with_target("flankwatch", LevelFilter::INFO));
    };
    text.parse().map_err(|error| {
        CliError::Argument(format!(
            "FLANKWATCH_LOG is {text:?}, expected levels such as info,flankwatch::store=debug: {error}"
        ))
    })
}

/// Sends the log to standard error.
fn start_log() -> Result<(), CliError> {
    let is_colored =
        io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    let layer = tracing_subscriber::fmt::layer().with_writer(io::stderr).with_ansi(is_colored);
    tracing_subscriber::registry().with(layer).with(log_filter()?).init();
    Ok(())
}

/// Returns the commands; in every option, a number may be negative, so that its own error names it.
fn commands() -> clap::Command {
    fn with_negative_numbers(command: clap::Command) -> clap::Command {
        let numbers = |arg: clap::Arg| {
            let takes_values = arg.get_action().takes_values();
            if takes_values { arg.allow_negative_numbers(true) } else { arg }
        };
        command.mut_args(numbers).mut_subcommands(with_negative_numbers)
    }
    with_negative_numbers(Cli::command())
}

/// Parses this process's command line and runs the command.
pub fn run() -> ExitCode {
    let cli = Cli::from_arg_matches(&commands().get_matches()).unwrap_or_else(|error| error.exit());
    let outcome = start_log().and_then(|()| match &cli.command {
        Command::Demo(args) => demo::run(args),
        Command::Serve(args) => serve::run(args).map_err(CliError::from),
        Command::Work(args) => work::run(args).map_err(CliError::from),
        Command::Cluster(args) => cluster::run(args),
        Command::DeadLetters(args) => dead_letters::run(args),
        Command::Analyze(args) => analyze::run(args),
        Command::Replay(args) => replay::run(args),
        Command::Stream(args) => stream::run(args),
        Command::Export(args) => export::run(args),
        Command::Delete(args) => records::run(args, records::Change::Delete),
        Command::Exclude(args) => records::run(args, records::Change::Exclude),
        Command::Include(args) => records::run(args, records::Change::Include),
        Command::Baseline(args) => records::choose_baseline(args),
        Command::Simulate(args) => simulate::run(args),
        Command::Evaluate(args) => evaluate::run(args),
        Command::Model(args) => model::run(args),
        Command::Figures(args) => figures::run(args),
        Command::Library(args) => library::run(args),
        Command::Token(args) => token::run(args),
        Command::Verify(args) => verify::run(args),
        Command::Backup(args) => backup::back_up_folder(args),
        Command::Restore(args) => backup::restore(args),
        Command::Rebuild(args) => rebuild::run(args),
        Command::Quarantine(args) => quarantine::run(args),
        Command::Completions(args) => completions::complete(args, Cli::command()),
        Command::Manual(args) => completions::write_manual(args, Cli::command()),
        Command::Convert(args) => convert::run(args),
    });
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            output::print_stderr(&format!("error: {error}"));
            ExitCode::FAILURE
        }
    }
}
