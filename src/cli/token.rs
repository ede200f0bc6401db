//! `flankwatch token`: who may use a service.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use jiff::Timestamp;

use super::CliError;
use super::output::print;
use crate::http::{Scope, Tokens};

/// Make, list and revoke the tokens of a service; a running one sees the change at once.
#[derive(Debug, Clone, Args)]
pub(super) struct TokenArgs {
    #[command(subcommand)]
    action: Action,
    /// The service's data folder.
    #[arg(long, value_name = "DIR", default_value = "flankwatch-data", global = true)]
    data_dir: PathBuf,
}

#[derive(Debug, Clone, Subcommand)]
enum Action {
    /// Make a token and print it; it is kept hashed and cannot be printed again
    Create {
        /// What it is for.
        name: String,
        /// read: look; write: also send records and acknowledge; admin: also make and delete assets.
        #[arg(long, default_value = "read")]
        scope: Scope,
    },
    /// List the tokens without their secrets
    List,
    /// Take a token back
    Revoke {
        /// Its identifier, as listed.
        id: String,
    },
}

pub(super) fn run(args: &TokenArgs) -> Result<(), CliError> {
    let tokens = Tokens::of(&args.data_dir);
    match &args.action {
        Action::Create { name, scope } => {
            let token = tokens.create(name, *scope, Timestamp::now())?;
            print(&format!("{token}\n"))
        }
        Action::List => {
            let mut text = String::new();
            for token in tokens.list()?.unwrap_or_default().iter() {
                text.push_str(&format!(
                    "{}  {:5}  {:.0}  {}\n",
                    token.id,
                    token.scope.name(),
                    token.created_at,
                    token.name
                ));
            }
            print(&text)
        }
        Action::Revoke { id } => Ok(tokens.revoke(id)?),
    }
}
