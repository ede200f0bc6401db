//! `flankwatch completions` and `flankwatch manual`: shell completions and manual pages.

use std::path::PathBuf;

use clap::Args;
use clap_complete::Shell;

use super::CliError;
use super::output::print;

/// Arguments of `flankwatch completions`.
#[derive(Debug, Clone, Args)]
pub(super) struct CompletionsArgs {
    /// Shell to complete in.
    shell: Shell,
}

/// Arguments of `flankwatch manual`.
#[derive(Debug, Clone, Args)]
pub(super) struct ManualArgs {
    /// Folder to write to, created if missing.
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
        .map_err(CliError::file(&args.folder))
}
