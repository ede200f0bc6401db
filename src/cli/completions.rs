//! `flankwatch completions` and `flankwatch manual`: what a shell and `man` know of the commands.

use std::path::PathBuf;

use clap::Args;
use clap_complete::Shell;

use super::CliError;
use super::output::print;

/// Print a script that completes the commands and their options in a shell
#[derive(Debug, Clone, Args)]
pub(super) struct CompletionsArgs {
    /// The shell.
    shell: Shell,
}

/// Write the manual pages, one for each command
#[derive(Debug, Clone, Args)]
pub(super) struct ManualArgs {
    /// Folder to write into; made where it is missing.
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

pub(super) fn complete(args: &CompletionsArgs, mut program: clap::Command) -> Result<(), CliError> {
    let name = program.get_name().to_owned();
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, name, &mut script);
    print(&String::from_utf8_lossy(&script))
}

pub(super) fn write_manual(args: &ManualArgs, program: clap::Command) -> Result<(), CliError> {
    std::fs::create_dir_all(&args.folder)
        .and_then(|()| clap_mangen::generate_to(program, &args.folder))
        .map_err(CliError::io(&args.folder))
}
