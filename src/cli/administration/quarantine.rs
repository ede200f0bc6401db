//! `flankwatch quarantine`: lists and restores unreferenced raw recordings before they are removed.

use clap::{Args, Subcommand};

use super::store_options::{StoreOptions, runtime};
use crate::cli::CliError;
use crate::cli::output::print;
use crate::store::Store;

/// Arguments of `flankwatch quarantine`.
#[derive(Debug, Clone, Args)]
pub(in crate::cli) struct QuarantineArgs {
    #[command(subcommand)]
    action: Action,
    #[command(flatten)]
    options: StoreOptions,
}

#[derive(Debug, Clone, Subcommand)]
enum Action {
    /// List the raw recordings in quarantine: time, bytes, name
    List,
    /// Move raw recordings out of quarantine
    ///
    /// Run `flankwatch rebuild` afterwards, before the service starts: a start moves unreferenced recordings
    /// to quarantine again.
    Restore {
        /// Names of the raw recordings, or prefixes of names.
        #[arg(required_unless_present = "all", conflicts_with = "all")]
        names: Vec<String>,
        /// Restore all raw recordings in quarantine.
        #[arg(long)]
        all: bool,
    },
}

pub(in crate::cli) fn run(args: &QuarantineArgs) -> Result<(), CliError> {
    let (_, settings) = args.options.resolve_existing()?;
    let runtime = runtime()?;
    let objects = {
        let _entered = runtime.enter();
        Store::open_objects(&settings)?
    };
    let quarantined = objects.quarantined()?;
    let mut text = String::new();
    match &args.action {
        Action::List => {
            for one in &quarantined {
                text += &format!("{}  {:>12}  {}\n", one.since, one.bytes, one.name);
            }
        }
        Action::Restore { names, all } => {
            if let Some(name) =
                names.iter().find(|name| !quarantined.iter().any(|one| one.name.starts_with(*name)))
            {
                return Err(CliError::Argument(format!(
                    "{name} is not in quarantine, expected a name or prefix as listed"
                )));
            }
            let selected =
                quarantined.iter().filter(|one| *all || names.iter().any(|name| one.name.starts_with(name)));
            for one in selected {
                objects.release(one)?;
                text += &format!("{}\n", one.name);
            }
        }
    }
    print(&text)
}
