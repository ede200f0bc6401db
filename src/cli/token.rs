//! `flankwatch token`: who may use a service.

use clap::{Args, Subcommand};
use jiff::Timestamp;

use super::CliError;
use super::output::print;
use super::store_place::{StorePlace, runtime};
use crate::http::{Scope, Token, Tokens};
use crate::store::StoreSettings;

/// Make, list and revoke the tokens of a service; a running one sees the change at once, those of a cluster
/// within 2 s.
#[derive(Debug, Clone, Args)]
pub(super) struct TokenArgs {
    #[command(subcommand)]
    action: Action,
    #[command(flatten)]
    place: StorePlace,
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
    let (_, settings) = args.place.resolve()?;
    runtime()?.block_on(async {
        let tokens = match &settings {
            StoreSettings::Folder(folder) => Tokens::of(folder),
            #[cfg(feature = "postgres")]
            StoreSettings::Shared(_) => Tokens::shared(crate::store::Store::open(&settings).await?),
        };
        match &args.action {
            Action::Create { name, scope } => {
                let token = tokens.create(name, *scope, Timestamp::now()).await?;
                print(&format!("{token}\n"))
            }
            Action::List => print(&listed(&tokens.list().await?.unwrap_or_default())),
            Action::Revoke { id } => Ok(tokens.revoke(id, Timestamp::now()).await?),
        }
    })
}

fn listed(tokens: &[Token]) -> String {
    let line = |token: &Token| {
        format!("{}  {:5}  {:.0}  {}\n", token.id, token.scope.name(), token.created_at, token.name)
    };
    tokens.iter().map(line).collect()
}
