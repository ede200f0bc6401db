//! `flankwatch work`: runs a cluster worker.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;

use super::serve_error::ServeError;

/// Arguments of `flankwatch work`.
#[derive(Debug, Clone, Args)]
pub(in crate::cli) struct WorkArgs {
    /// Settings file (TOML) with the table `cluster`, the same as for the API nodes.
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
    /// Folder for the library cache and temporary files [default: ./flankwatch-data].
    #[arg(long, value_name = "DIR")]
    pub data_dir: Option<PathBuf>,
    /// Address to serve /healthz, /readyz and /metrics on [default: not served].
    #[arg(long, value_name = "ADDR")]
    pub health: Option<SocketAddr>,
}

#[cfg(not(feature = "nats"))]
pub(in crate::cli) fn run(_args: &WorkArgs) -> Result<(), ServeError> {
    Err(crate::settings::SettingError::WithoutFeature { field: "flankwatch work", feature: "cluster" }.into())
}

/// Works until Ctrl-C or SIGTERM.
#[cfg(feature = "nats")]
pub(in crate::cli) fn run(args: &WorkArgs) -> Result<(), ServeError> {
    use std::io::Write;
    use std::time::Duration;

    use super::node;
    use super::serve::{ServeArgs, shutdown_signal};

    let serve = ServeArgs {
        config: Some(args.config.clone()),
        data_dir: args.data_dir.clone(),
        ..ServeArgs::default()
    };
    let mut resolved = serve.resolve()?;
    let notifications = resolved.notifications()?;
    let settings = resolved.cluster.ok_or(ServeError::NoClusterTable)?;
    let grace = resolved.service.http.grace;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let ended = runtime.block_on(async {
        let started = tokio::select! {
            started = node::start_worker(resolved.service, settings, notifications, args.health) => started?,
            stopped = shutdown_signal() => return Ok(stopped?),
        };
        let mut out = std::io::stdout();
        match started.health() {
            Some(address) => writeln!(out, "working, health at http://{address}")?,
            None => writeln!(out, "working")?,
        }
        out.flush()?;
        shutdown_signal().await?;
        tracing::info!("stopping");
        started.stop(grace).await;
        Ok(())
    });
    runtime.shutdown_timeout(Duration::from_secs(1));
    ended
}
