//! `flankwatch backup` and `flankwatch restore`: copies of a data folder.

use std::path::PathBuf;

use clap::Args;

use super::store_options::{StoreOptions, runtime};
use crate::cli::CliError;
use crate::cli::output::{counted, print};
use crate::store::{Copied, back_up, restore_backup};

/// Advice where the store belongs to a cluster.
const INSTEAD: &str = "back up PostgreSQL and the bucket with their own tools";

/// Arguments of `flankwatch backup`.
#[derive(Debug, Clone, Args)]
pub(in crate::cli) struct BackupArgs {
    /// Folder to write the backup to.
    #[arg(value_name = "TO")]
    to: PathBuf,
    #[command(flatten)]
    options: StoreOptions,
}

/// Arguments of `flankwatch restore`.
#[derive(Debug, Clone, Args)]
pub(in crate::cli) struct RestoreArgs {
    /// Folder of the backup.
    #[arg(value_name = "FROM")]
    from: PathBuf,
    #[command(flatten)]
    options: StoreOptions,
}

pub(in crate::cli) fn back_up_folder(args: &BackupArgs) -> Result<(), CliError> {
    let folder = args.options.folder(INSTEAD)?;
    let quarantined_for = args.options.resolve()?.0.service.work.quarantined_for;
    report(&runtime()?.block_on(back_up(&folder, &args.to, quarantined_for))?)
}

pub(in crate::cli) fn restore(args: &RestoreArgs) -> Result<(), CliError> {
    let folder = args.options.folder(INSTEAD)?;
    report(&runtime()?.block_on(restore_backup(&args.from, &folder))?)
}

fn report(copied: &Copied) -> Result<(), CliError> {
    let mut text = String::new();
    for failed in &copied.failed {
        text += &format!("failed to copy: {failed}\n");
    }
    text += &format!("{}, {} of them new\n", counted(copied.objects, "raw recording"), copied.new);
    if copied.unreferenced > 0 {
        text += &format!("{} moved into quarantine\n", counted(copied.unreferenced, "raw recording"));
    }
    if copied.streams > 0 {
        text += &format!("{}\n", counted(copied.streams, "live stream"));
    }
    print(&text)?;
    match copied.failed.len() {
        0 => Ok(()),
        found => Err(CliError::Findings(found as u64)),
    }
}
