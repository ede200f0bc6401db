//! Options that select the store a command works on.

use std::path::PathBuf;

use clap::Args;

use crate::cli::CliError;
use crate::cli::service::serve::{Resolved, ServeArgs};
use crate::store::StoreSettings;

/// The store that a command works on.
#[derive(Debug, Clone, Args)]
pub(super) struct StoreOptions {
    /// Settings file of the service (TOML); with the table `cluster`, the cluster's store is used.
    #[arg(long, value_name = "FILE", global = true)]
    config: Option<PathBuf>,
    /// Data folder of the service [default: ./flankwatch-data].
    #[arg(long, value_name = "DIR", global = true)]
    data_dir: Option<PathBuf>,
}

impl StoreOptions {
    /// Returns the settings of the service and of its store.
    pub(super) fn resolve(&self) -> Result<(Resolved, StoreSettings), CliError> {
        let serve = ServeArgs {
            config: self.config.clone(),
            data_dir: self.data_dir.clone(),
            ..ServeArgs::default()
        };
        let resolved = serve.resolve()?;
        #[cfg(feature = "postgres")]
        if let Some(cluster) = &resolved.cluster {
            let settings = StoreSettings::Shared(cluster.store.clone());
            return Ok((resolved, settings));
        }
        let settings = StoreSettings::Folder(resolved.service.data_dir.clone());
        Ok((resolved, settings))
    }

    /// Returns the same for a data folder that exists: a command does not create a store for a wrong name.
    pub(super) fn resolve_existing(&self) -> Result<(Resolved, StoreSettings), CliError> {
        let (resolved, settings) = self.resolve()?;
        match &settings {
            StoreSettings::Folder(folder) if !folder.is_dir() => Err(CliError::no_data_folder(folder)),
            _ => Ok((resolved, settings)),
        }
    }

    /// Returns the data folder.
    ///
    /// # Errors
    /// The store belongs to a cluster; the message gives the advice `instead`.
    #[cfg_attr(not(feature = "postgres"), expect(unused_variables, reason = "every store is a folder"))]
    pub(super) fn folder(&self, instead: &str) -> Result<PathBuf, CliError> {
        match self.resolve()?.1 {
            StoreSettings::Folder(folder) => Ok(folder),
            #[cfg(feature = "postgres")]
            StoreSettings::Shared(_) => Err(CliError::Argument(format!(
                "the store belongs to a cluster, expected a data folder: {instead}"
            ))),
        }
    }
}

/// Creates a runtime for a command that works on a store.
pub(super) fn runtime() -> Result<tokio::runtime::Runtime, CliError> {
    let built = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    Ok(built.map_err(crate::cli::service::serve_error::ServeError::from)?)
}
