//! `flankwatch token`: creates, lists and revokes API tokens.

use clap::{Args, Subcommand};
use jiff::Timestamp;

use super::store_options::{StoreOptions, runtime};
use crate::asset::{from_json_name, json_name};
use crate::cli::CliError;
use crate::cli::output::print;
use crate::http::Tokens;
use crate::store::{Scope, StoreSettings, Token};

/// Arguments of `flankwatch token`.
#[derive(Debug, Clone, Args)]
pub(in crate::cli) struct TokenArgs {
    #[command(subcommand)]
    action: Action,
    #[command(flatten)]
    options: StoreOptions,
}

#[derive(Debug, Clone, Subcommand)]
enum Action {
    /// Create a token and print it; only its hash is stored, so it cannot be printed again
    Create {
        /// Name that says what the token is for.
        name: String,
        /// read: view; write: also send records, run replays, act on alarms and report maintenance; admin:
        /// also manage assets and tokens, and delete records.
        #[arg(long, default_value = "read", value_parser = from_json_name::<Scope>)]
        scope: Scope,
    },
    /// List the tokens, without their secrets
    List,
    /// Revoke a token
    Revoke {
        /// Identifier of the token, as listed.
        id: String,
    },
}

pub(in crate::cli) fn run(args: &TokenArgs) -> Result<(), CliError> {
    let (_, settings) = args.options.resolve_existing()?;
    runtime()?.block_on(async {
        let tokens = match &settings {
            StoreSettings::Folder(folder) => Tokens::of(folder),
            #[cfg(feature = "postgres")]
            StoreSettings::Shared(_) => Tokens::shared(crate::store::Store::open(&settings).await?),
        };
        match &args.action {
            Action::Create { name, scope } => {
                if name.trim().is_empty() {
                    return Err(CliError::argument(
                        "NAME",
                        "empty",
                        "a name that says what the token is for",
                    ));
                }
                let token = tokens.create(name, *scope, Timestamp::now()).await?;
                print(&format!("{token}\n"))
            }
            Action::List => print(&table(&tokens.list().await?.unwrap_or_default())),
            Action::Revoke { id } => Ok(tokens.revoke(id, Timestamp::now()).await?),
        }
    })
}

fn table(tokens: &[Token]) -> String {
    let line = |id: &str, scope: &str, created: String, name: &str| {
        format!("{id:<8}  {scope:5}  {created:<20}  {name}\n")
    };
    let mut text = line("id", "scope", "created".to_owned(), "name");
    for token in tokens {
        text += &line(&token.id, &json_name(&token.scope), format!("{:.0}", token.created_at), &token.name);
    }
    text
}
