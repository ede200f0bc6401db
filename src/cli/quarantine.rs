//! `flankwatch quarantine`: raw recordings that nothing refers to, before they are removed.

use clap::{Args, Subcommand};

use super::CliError;
use super::output::print;
use super::store_place::{StorePlace, runtime};
use crate::store::Store;

/// List raw recordings in quarantine, and put them back.
#[derive(Debug, Clone, Args)]
pub(super) struct QuarantineArgs {
    #[command(subcommand)]
    action: Action,
    #[command(flatten)]
    place: StorePlace,
}

#[derive(Debug, Clone, Subcommand)]
enum Action {
    /// List what is in quarantine: since when, bytes, name
    List,
    /// Put raw recordings back; `flankwatch rebuild` then takes them in, before the next start puts them here
    /// again
    Restore {
        /// Their names, or how they begin.
        #[arg(required_unless_present = "all")]
        names: Vec<String>,
        /// All of them.
        #[arg(long)]
        all: bool,
    },
}

pub(super) fn run(args: &QuarantineArgs) -> Result<(), CliError> {
    let (_, settings) = args.place.resolve()?;
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
                    "{name} is not in quarantine, expected a name that is listed"
                )));
            }
            let wanted =
                quarantined.iter().filter(|one| *all || names.iter().any(|name| one.name.starts_with(name)));
            for one in wanted {
                objects.release(one)?;
                text += &format!("{}\n", one.name);
            }
        }
    }
    print(&text)
}
