//! Where a service keeps everything, as the commands on its store are told.

use std::path::PathBuf;

use clap::Args;

use super::CliError;
use super::serve::{Resolved, ServeArgs};
use crate::store::StoreSettings;

/// The store that a command works on.
#[derive(Debug, Clone, Args)]
pub(super) struct StorePlace {
    /// The service's settings file (TOML); with the table `cluster` the store is that of the cluster.
    #[arg(long, value_name = "FILE", global = true)]
    config: Option<PathBuf>,
    /// The service's data folder [default: ./flankwatch-data].
    #[arg(long, value_name = "DIR", global = true)]
    data_dir: Option<PathBuf>,
}

impl StorePlace {
    /// The settings of the service, and where its store is.
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

    /// The data folder.
    ///
    /// Error: the store is that of a cluster; `instead` says what is done there.
    #[cfg_attr(not(feature = "postgres"), expect(unused_variables, reason = "there are no others"))]
    pub(super) fn folder(&self, instead: &str) -> Result<PathBuf, CliError> {
        match self.resolve()?.1 {
            StoreSettings::Folder(folder) => Ok(folder),
            #[cfg(feature = "postgres")]
            StoreSettings::Shared(_) => Err(CliError::Argument(format!(
                "the store is a cluster's, expected a data folder: {instead}"
            ))),
        }
    }
}

/// A runtime for a command that works on a store.
pub(super) fn runtime() -> Result<tokio::runtime::Runtime, CliError> {
    let built = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    Ok(built.map_err(super::serve::ServeError::from)?)
}
