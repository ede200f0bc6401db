//! `flankwatch verify`: checks the database against the raw recordings.

use std::time::Duration;

use clap::Args;

use super::store_options::{StoreOptions, runtime};
use crate::cli::CliError;
use crate::cli::output::{counted, print};
use crate::store::Store;

/// How long a running service may take from storing a raw recording to storing its rows.
const PATIENCE: Duration = Duration::from_secs(2);

/// Arguments of `flankwatch verify`.
#[derive(Debug, Clone, Args)]
pub(in crate::cli) struct VerifyArgs {
    #[command(flatten)]
    options: StoreOptions,
    /// Check only that raw recordings exist and have their size, not their hashes
    #[arg(long)]
    without_hashes: bool,
}

pub(in crate::cli) fn run(args: &VerifyArgs) -> Result<(), CliError> {
    let (_, settings) = args.options.resolve()?;
    let audit = runtime()?.block_on(async {
        let store = Store::open_to_read(&settings).await?;
        let audit = store.audit(!args.without_hashes, PATIENCE).await;
        store.close().await;
        audit
    })?;
    let mut text = String::new();
    for finding in &audit.findings {
        text += &format!("{finding}\n");
    }
    text += &format!(
        "{}, {} of {}, {} in quarantine",
        counted(audit.records, "record"),
        counted(audit.objects, "raw recording"),
        counted(audit.bytes, "byte"),
        audit.quarantined
    );
    if audit.unreferenced > 0 {
        text += &format!(", {} unreferenced (younger than cluster.objects.orphan_age_s)", audit.unreferenced);
    }
    text += "\n";
    print(&text)?;
    match audit.found {
        0 => Ok(()),
        found => Err(CliError::Findings(found)),
    }
}
