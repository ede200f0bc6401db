//! `flankwatch rebuild`: rebuilds the database from the raw recordings.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use clap::Args;
use jiff::Timestamp;

use super::store_options::{StoreOptions, runtime};
use crate::cli::CliError;
use crate::cli::output::{counted, print};
use crate::cli::service::serve_error::ServeError;
use crate::service::{Role, Service, ServiceFolders, SystemClock};
use crate::store::{Store, StoreSettings};

/// Arguments of `flankwatch rebuild`.
#[derive(Debug, Clone, Args)]
pub(in crate::cli) struct RebuildArgs {
    #[command(flatten)]
    options: StoreOptions,
    /// Move the database aside first and rebuild it from scratch
    #[arg(long)]
    anew: bool,
    /// Also import deleted records whose raw recordings still exist
    #[arg(long)]
    with_deleted: bool,
}

pub(in crate::cli) fn run(args: &RebuildArgs) -> Result<(), CliError> {
    let (resolved, settings) = args.options.resolve_existing()?;
    let config = resolved.service;
    if args.anew {
        match &settings {
            StoreSettings::Folder(folder) => set_aside(folder)?,
            #[cfg(feature = "postgres")]
            StoreSettings::Shared(_) => {
                return Err(CliError::Argument(
                    "--anew is for data folders only: give a cluster an empty database instead".to_owned(),
                ));
            }
        }
    }
    let rebuilt = runtime()?.block_on(async {
        let store = Store::open_to_rebuild(&settings).await?;
        let folders = ServiceFolders::in_data_folder(&config.data_dir);
        let service = Service::new(
            store.clone(),
            folders,
            &config.work,
            config.grid,
            Arc::new(SystemClock),
            Role::Standalone,
        )?;
        let progress = |done: usize, all: usize| {
            if done.is_multiple_of(1000) {
                tracing::info!(done, all, "importing records");
            }
        };
        let rebuilt = service.rebuild(args.with_deleted, progress).await;
        store.close().await;
        Ok::<_, CliError>(rebuilt?)
    })?;
    let mut text = String::new();
    for failure in &rebuilt.failures {
        text += &format!("failed to import: {failure}\n");
    }
    text += &format!(
        "imported {} and {}, updated {}, deleted {}; skipped {} existing, {} deleted, {} without a raw recording, \
         {} without an asset\n",
        counted(rebuilt.assets, "asset"),
        counted(rebuilt.records, "record"),
        counted(rebuilt.updated, "asset"),
        counted(rebuilt.removed_again, "record"),
        rebuilt.known,
        rebuilt.removed,
        rebuilt.without_raw,
        rebuilt.without_asset
    );
    print(&text)?;
    match rebuilt.failed {
        0 => Ok(()),
        failed => Err(CliError::Findings(failed)),
    }
}

/// Renames the database files, so that a new database is created; fails while a service uses them.
fn set_aside(folder: &Path) -> Result<(), CliError> {
    let lock = folder.join("lock");
    let file = fs::File::create(&lock).map_err(CliError::file(&lock))?;
    if file.try_lock().is_err() {
        let in_use = crate::store::StoreError::InUse(folder.to_path_buf());
        return Err(in_use.into());
    }
    let date = Timestamp::now().strftime("%Y%m%dT%H%M%SZ").to_string();
    for name in ["flankwatch.db", "flankwatch.db-wal", "flankwatch.db-shm"] {
        let path = folder.join(name);
        if path.exists() {
            let aside = folder.join(name.replace("flankwatch.db", &format!("flankwatch.{date}.db")));
            fs::rename(&path, &aside).map_err(CliError::file(&path))?;
        }
    }
    file.unlock().map_err(|source| ServeError::from(source).into())
}
