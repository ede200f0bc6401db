//! `flankwatch cluster`: status of a cluster.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

use crate::cli::CliError;

/// Arguments of `flankwatch cluster`.
#[derive(Debug, Clone, Args)]
pub(in crate::cli) struct ClusterArgs {
    #[command(subcommand)]
    action: Action,
    #[command(flatten)]
    options: ClusterOptions,
}

#[derive(Debug, Clone, Subcommand)]
enum Action {
    /// Show the queue, the workers that respond, and the number of dead letters
    Status,
}

/// The cluster that a command works on, and its output format.
#[derive(Debug, Clone, Args)]
pub(super) struct ClusterOptions {
    /// Settings file (TOML) with the table `cluster`.
    #[arg(long, value_name = "FILE", global = true)]
    config: Option<PathBuf>,
    /// Output format.
    #[arg(long, value_enum, global = true, default_value_t = Format::Table)]
    pub(super) format: Format,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Format {
    /// Aligned columns
    Table,
    /// One JSON object
    Json,
}

#[cfg(not(feature = "nats"))]
pub(in crate::cli) fn run(args: &ClusterArgs) -> Result<(), CliError> {
    let Action::Status = args.action;
    args.options.refuse("flankwatch cluster")
}

#[cfg(not(feature = "nats"))]
impl ClusterOptions {
    /// Returns the error that this program was built without clusters.
    pub(super) fn refuse(&self, command: &'static str) -> Result<(), CliError> {
        // The settings file is not read.
        let _ = &self.config;
        Err(crate::settings::SettingError::WithoutFeature { field: command, feature: "cluster" }.into())
    }
}

#[cfg(feature = "nats")]
mod with_cluster {
    use jiff::Timestamp;

    use super::{Action, CliError, ClusterArgs, ClusterOptions, Format};
    use crate::cli::administration::store_options;
    use crate::cli::output::print;
    use crate::cli::service::serve::ServeArgs;
    use crate::cli::service::serve_error::ServeError;
    use crate::cluster::{Cluster, ClusterError};
    use crate::service::QueueOverview;

    impl ClusterOptions {
        /// Connects to the cluster and runs `work` with it.
        pub(in crate::cli::administration) fn with<T>(
            &self,
            work: impl AsyncFnOnce(Cluster) -> Result<T, ClusterError>,
        ) -> Result<T, CliError> {
            let serve = ServeArgs { config: self.config.clone(), ..ServeArgs::default() };
            let settings = serve.resolve()?.cluster.ok_or(ServeError::NoClusterTable)?;
            let runtime = store_options::runtime()?;
            let done = runtime.block_on(async { work(Cluster::connect(settings.nats).await?).await });
            Ok(done.map_err(ServeError::from)?)
        }
    }

    pub(in crate::cli) fn run(args: &ClusterArgs) -> Result<(), CliError> {
        let Action::Status = args.action;
        let overview = args.options.with(async |cluster| cluster.overview().await)?;
        match args.options.format {
            Format::Table => print(&table(&overview, Timestamp::now())),
            Format::Json => print(&format!("{:#}\n", serde_json::json!(overview))),
        }
    }

    fn table(overview: &QueueOverview, now: Timestamp) -> String {
        let oldest = overview.oldest_at.map_or(String::new(), |at| {
            let age = now.duration_since(at).as_secs().max(0);
            format!(", the oldest for {}", duration(age))
        });
        let mut text = format!(
            "records in the queue  {}, {} in progress{oldest}\ndead letters          {}\nleftover messages     {}\npartitions unowned    {}\nworkers               {}\n",
            overview.records,
            overview.in_progress,
            overview.dead_letters,
            overview.leftovers,
            overview.partitions_unowned,
            overview.workers.len()
        );
        if !overview.workers.is_empty() {
            let longest =
                overview.workers.iter().map(|worker| worker.name.chars().count()).max().unwrap_or_default();
            text += &format!(
                "\n{:longest$}  {:>8}  {:>10}  {:>11}  {:>12}\n",
                "worker", "version", "partitions", "in progress", "stored"
            );
            for worker in &overview.workers {
                let in_progress = format!("{}/{}", worker.in_progress, worker.at_once);
                text += &format!(
                    "{:longest$}  {:>8}  {:>10}  {in_progress:>11}  {:>12}\n",
                    worker.name,
                    worker.version,
                    worker.partitions.len(),
                    worker.stored
                );
            }
        }
        text
    }

    /// Formats seconds in their two largest units.
    fn duration(seconds: i64) -> String {
        match seconds {
            0..60 => format!("{seconds} s"),
            60..3600 => format!("{} min {} s", seconds / 60, seconds % 60),
            3600..86400 => format!("{} h {} min", seconds / 3600, seconds % 3600 / 60),
            _ => format!("{} d {} h", seconds / 86400, seconds % 86400 / 3600),
        }
    }

    #[cfg(test)]
    mod tests {
        use super::*;
        use crate::service::WorkerOverview;

        #[test]
        fn the_status_fits_80_columns() {
            let now: Timestamp = "2026-01-02T00:00:00Z".parse().unwrap();
            let overview = QueueOverview {
                records: 12,
                in_progress: 4,
                oldest_at: Some("2026-01-01T22:58:30Z".parse().unwrap()),
                leftovers: 0,
                dead_letters: 3,
                partitions_unowned: 0,
                workers: vec![WorkerOverview {
                    name: "worker-5f4d9c7b8-x2x7q-00c0ffee".to_owned(),
                    version: "0.1.0".to_owned(),
                    in_progress: 4,
                    at_once: 16,
                    stored: 123_456,
                    partitions: (0..64).collect(),
                    states_read: 7,
                }],
            };
            let text = table(&overview, now);
            assert!(text.contains("12, 4 in progress, the oldest for 1 h 1 min"), "{text}");
            assert!(text.contains("4/16"), "{text}");
            assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
            assert!(table(&QueueOverview::default(), now).contains("0, 0 in progress\n"));
        }
    }
}

#[cfg(feature = "nats")]
pub(in crate::cli) use with_cluster::run;
