//! The commands: each module reads its arguments, calls the rooms, and prints.

mod analyze;
mod backup;
mod cluster;
mod completions;
mod convert;
mod dead_letters;
mod demo;
mod ensemble;
mod error;
mod evaluate;
mod figures;
mod interrupt;
mod library;
mod model;
mod mqtt;
#[cfg(feature = "nats")]
mod node;
mod output;
mod pair_file;
mod quarantine;
mod rebuild;
mod recorded_runs;
mod recording_files;
mod recording_values;
mod records;
mod replay;
mod serve;
#[cfg(feature = "postgres")]
mod shared_store;
mod simulate;
mod store_place;
mod stream;
mod token;
mod verify;
mod work;

use std::io::{self, IsTerminal};
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use tracing::level_filters::LevelFilter;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

pub use error::CliError;

/// Condition monitoring for spur gears: vibration records in, wear depth with an honest interval out.
#[derive(Parser)]
#[command(name = "flankwatch", version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Serve with a sample gearbox and a simulated run towards its danger limit, replayed fast
    Demo(demo::DemoArgs),
    /// Run the service: HTTP API and dashboard
    Serve(serve::ServeArgs),
    /// Analyse what the API nodes of a cluster take
    Work(work::WorkArgs),
    /// How a cluster is: its queue and its workers
    Cluster(cluster::ClusterArgs),
    /// Records of a cluster that could not be stored
    DeadLetters(dead_letters::DeadLettersArgs),
    /// Indicators and wear of recordings, without a server
    Analyze(analyze::AnalyzeArgs),
    /// Send recordings to a server
    Replay(replay::ReplayArgs),
    /// Send samples to a server while they are measured, from a pipe or a growing file
    Stream(stream::StreamArgs),
    /// Delete records of an asset on a server; raw recordings go into quarantine
    Delete(records::RecordsArgs),
    /// Take records of an asset on a server out of its histories; they stay stored
    Exclude(records::RecordsArgs),
    /// Have excluded records of an asset on a server count again
    Include(records::RecordsArgs),
    /// Make the records of a range the healthy baseline of an asset on a server
    Baseline(records::BaselineArgs),
    /// Simulate a run to failure with the true wear known
    Simulate(simulate::SimulateArgs),
    /// What the wear estimate is worth on simulated runs whose true wear is known
    Evaluate(evaluate::EvaluateArgs),
    /// Mesh stiffness and transmission error of a worn pair over one mesh period
    Model(model::ModelArgs),
    /// The figures of the model's paper from this model, with its statements checked
    Figures(figures::FiguresArgs),
    /// Build, list and show libraries of simulated wear states
    Library(library::LibraryArgs),
    /// Turn other recordings into MCAP or WAV
    Convert(convert::ConvertArgs),
    /// Make, list and revoke the tokens of a service
    Token(token::TokenArgs),
    /// Compare the database with the raw recordings
    Verify(verify::VerifyArgs),
    /// Copy a data folder while the service works on it
    Backup(backup::BackupArgs),
    /// Put a backup into a data folder
    Restore(backup::RestoreArgs),
    /// Make the database again from the raw recordings
    Rebuild(rebuild::RebuildArgs),
    /// Raw recordings that nothing refers to, before they are removed
    Quarantine(quarantine::QuarantineArgs),
    /// Print a script that completes commands and options in a shell
    Completions(completions::CompletionsArgs),
    /// Write the manual pages
    #[command(hide = true)]
    Manual(completions::ManualArgs),
}

/// What is logged: levels by module as `FLANKWATCH_LOG` says (`info,flankwatch::store=debug`).
fn logged() -> Targets {
    let asked = std::env::var("FLANKWATCH_LOG").ok().filter(|text| !text.is_empty());
    let usual =
        || Targets::new().with_default(LevelFilter::WARN).with_target("flankwatch", LevelFilter::INFO);
    asked.and_then(|text| text.parse().ok()).unwrap_or_else(usual)
}

/// Runs the command line of this process.
pub fn run() -> ExitCode {
    let cli = Cli::parse();
    let lines =
        tracing_subscriber::fmt::layer().with_writer(io::stderr).with_ansi(io::stderr().is_terminal());
    tracing_subscriber::registry().with(lines).with(logged()).init();
    let outcome = match &cli.command {
        Command::Demo(args) => demo::run(args),
        Command::Serve(args) => serve::run(args).map_err(CliError::from),
        Command::Work(args) => work::run(args).map_err(CliError::from),
        Command::Cluster(args) => cluster::run(args),
        Command::DeadLetters(args) => dead_letters::run(args),
        Command::Analyze(args) => analyze::run(args),
        Command::Replay(args) => replay::run(args),
        Command::Stream(args) => stream::run(args),
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
        Command::Convert(args) => convert::run(args).map_err(CliError::from),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
