//! `flankwatch token`: who may use a service.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use jiff::Timestamp;

use super::CliError;
use super::output::print;
use super::serve::ServeArgs;
use crate::http::{Scope, Token, Tokens};

/// Make, list and revoke the tokens of a service; a running one sees the change at once, those of a cluster
/// within 2 s.
#[derive(Debug, Clone, Args)]
pub(super) struct TokenArgs {
    #[command(subcommand)]
    action: Action,
    /// The service's settings file (TOML); with the table `cluster` the tokens are those of the cluster.
    #[arg(long, value_name = "FILE", global = true)]
    config: Option<PathBuf>,
    /// The service's data folder [default: ./flankwatch-data].
    #[arg(long, value_name = "DIR", global = true)]
    data_dir: Option<PathBuf>,
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
    let serve =
        ServeArgs { config: args.config.clone(), data_dir: args.data_dir.clone(), ..ServeArgs::default() };
    let resolved = serve.resolve()?;
    #[cfg(feature = "cluster")]
    if let Some(cluster) = resolved.cluster {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(super::serve::ServeError::from)?;
        return runtime.block_on(in_cluster(&args.action, cluster.store));
    }
    let tokens = Tokens::of(&resolved.service.data_dir);
    match &args.action {
        Action::Create { name, scope } => {
            let token = tokens.create(name, *scope, Timestamp::now())?;
            print(&format!("{token}\n"))
        }
        Action::List => print(&listed(&tokens.list()?.unwrap_or_default())),
        Action::Revoke { id } => Ok(tokens.revoke(id)?),
    }
}

#[cfg(feature = "cluster")]
async fn in_cluster(action: &Action, settings: crate::store::SharedSettings) -> Result<(), CliError> {
    let store = super::node::open_once(settings).await?;
    let tokens = crate::http::SharedTokens::of(store.clone());
    let done = match action {
        Action::Create { name, scope } => {
            let token = tokens.create(name, *scope, Timestamp::now()).await?;
            print(&format!("{token}\n"))
        }
        Action::List => print(&listed(&tokens.list().await?.unwrap_or_default())),
        Action::Revoke { id } => Ok(tokens.revoke(id, Timestamp::now()).await?),
    };
    store.close().await;
    done
}

fn listed(tokens: &[Token]) -> String {
    let line = |token: &Token| {
        format!("{}  {:5}  {:.0}  {}\n", token.id, token.scope.name(), token.created_at, token.name)
    };
    tokens.iter().map(line).collect()
}
