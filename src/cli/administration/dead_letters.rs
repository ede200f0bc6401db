//! `flankwatch dead-letters`: records that a cluster failed to store.

use clap::{Args, Subcommand};

use super::cluster::ClusterOptions;
use crate::cli::CliError;

/// Arguments of `flankwatch dead-letters`.
#[derive(Debug, Clone, Args)]
pub(in crate::cli) struct DeadLettersArgs {
    #[command(subcommand)]
    action: Action,
    #[command(flatten)]
    options: ClusterOptions,
}

#[derive(Debug, Clone, Subcommand)]
enum Action {
    /// List dead letters: number, time, asset, reason
    List,
    /// Show one dead letter in full
    Show {
        /// Number of the dead letter, as listed.
        number: u64,
    },
    /// Put records back into the queue, so that workers try them again
    Retry(Selection),
    /// Delete dead letters; raw recordings that nothing else refers to move to quarantine
    Drop(Selection),
}

/// The dead letters that a command works on.
#[derive(Debug, Clone, Args)]
struct Selection {
    /// Numbers of the dead letters, as listed.
    #[arg(required_unless_present = "all", conflicts_with = "all")]
    numbers: Vec<u64>,
    /// Select all dead letters.
    #[arg(long)]
    all: bool,
}

#[cfg(not(feature = "nats"))]
pub(in crate::cli) fn run(args: &DeadLettersArgs) -> Result<(), CliError> {
    args.options.refuse("flankwatch dead-letters")
}

#[cfg(feature = "nats")]
pub(in crate::cli) use with_cluster::run;

#[cfg(feature = "nats")]
mod with_cluster {
    use std::io::{self, IsTerminal};

    use serde_json::json;

    use super::{Action, CliError, DeadLettersArgs, Selection};
    use crate::cli::administration::cluster::Format;
    use crate::cli::output::{counted, print};
    use crate::cluster::{Cluster, ClusterError, DeadLetter};

    /// Width of a line in characters where `COLUMNS` is not set.
    const DEFAULT_WIDTH: usize = 80;

    pub(in crate::cli) fn run(args: &DeadLettersArgs) -> Result<(), CliError> {
        let format = args.options.format;
        match &args.action {
            Action::List => {
                let letters = args.options.with(async |cluster| cluster.dead_letters().await)?;
                match format {
                    Format::Table => print(&table(&letters, width())),
                    Format::Json => print(&format!("{:#}\n", json!({ "items": letters }))),
                }
            }
            Action::Show { number } => {
                let letter = args.options.with(async |cluster| cluster.dead_letter(*number).await)?;
                match format {
                    Format::Table => print(&description(&letter)),
                    Format::Json => print(&format!("{:#}\n", json!(letter))),
                }
            }
            Action::Retry(selection) => {
                let done = for_each(args, selection, async |cluster, number| {
                    cluster.retry_dead_letter(number).await
                })?;
                report(format, "retried", &done)
            }
            Action::Drop(selection) => {
                let done = for_each(args, selection, async |cluster, number| {
                    cluster.drop_dead_letter(number).await
                })?;
                report(format, "dropped", &done)
            }
        }
    }

    /// Calls `work` with each selected dead letter; returns their numbers.
    fn for_each(
        args: &DeadLettersArgs,
        selection: &Selection,
        work: impl AsyncFn(&Cluster, u64) -> Result<(), ClusterError>,
    ) -> Result<Vec<u64>, CliError> {
        args.options.with(async |cluster| {
            let numbers = if selection.all {
                cluster.dead_letters().await?.iter().map(|letter| letter.number).collect()
            } else {
                selection.numbers.clone()
            };
            for number in &numbers {
                work(&cluster, *number).await?;
            }
            Ok(numbers)
        })
    }

    fn report(format: Format, done: &str, numbers: &[u64]) -> Result<(), CliError> {
        match format {
            Format::Table => print(&format!("{} {done}\n", counted(numbers.len() as u64, "dead letter"))),
            Format::Json => print(&format!("{:#}\n", json!({ done: numbers }))),
        }
    }

    /// The width of a terminal's lines; what is piped or written to a file is not truncated.
    fn width() -> usize {
        if !io::stdout().is_terminal() {
            return usize::MAX;
        }
        let columns = std::env::var("COLUMNS").ok().and_then(|columns| columns.parse().ok());
        columns.unwrap_or(DEFAULT_WIDTH)
    }

    fn table(letters: &[DeadLetter], width: usize) -> String {
        let asset = |letter: &DeadLetter| {
            letter.record.as_ref().map_or("-".to_owned(), |record| record.asset_id.to_string())
        };
        let longest = letters.iter().map(|letter| asset(letter).len()).max().unwrap_or_default().clamp(5, 24);
        let mut text = format!("{:>8}  {:20}  {:longest$}  reason\n", "number", "since", "asset");
        for letter in letters {
            let line = format!(
                "{:>8}  {:20.0}  {:longest$}  {}",
                letter.number,
                letter.put_at,
                truncate(&asset(letter), longest),
                letter.reason
            );
            text += &format!("{}\n", truncate(&line, width));
        }
        text
    }

    /// Truncates a text to `max` characters, the last of which is then an ellipsis.
    fn truncate(text: &str, max: usize) -> String {
        if text.chars().count() <= max {
            return text.to_owned();
        }
        text.chars().take(max.saturating_sub(1)).chain(['…']).collect()
    }

    fn description(letter: &DeadLetter) -> String {
        let mut text = format!(
            "number      {}\nsince       {}\nreason      {}\nmessage     {} bytes\n",
            letter.number, letter.put_at, letter.reason, letter.message_bytes
        );
        match &letter.record {
            None => text += "record      unreadable message\n",
            Some(record) => {
                text += &format!(
                    "segment     {}\nasset       {}\nchannel     {}\nstart time  {}\nreceived    {}\nraw object  {} ({} bytes, {})\n",
                    record.id.0,
                    record.asset_id,
                    record.channel,
                    record.start_time,
                    record.received_at,
                    record.raw.sha256,
                    record.raw.bytes,
                    record.raw.media_type
                );
            }
        }
        text
    }

    #[cfg(test)]
    mod tests {
        use super::*;

        #[test]
        fn the_list_fits_80_columns() {
            let letter = DeadLetter {
                number: 17,
                reason: "segment ab of pump: raw object cd is damaged: its bytes hash to ef (tried 5 times)"
                    .to_owned(),
                put_at: "2026-01-01T00:00:00.5Z".parse().unwrap(),
                message_bytes: 250,
                record: None,
            };
            let text = table(std::slice::from_ref(&letter), 80);
            assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
            assert!(
                text.contains("17  2026-01-01T00:00:01Z") || text.contains("17  2026-01-01T00:00:00Z"),
                "{text}"
            );
            assert!(text.trim_end().ends_with('…'), "{text}");
            let whole = table(std::slice::from_ref(&letter), usize::MAX);
            assert!(whole.ends_with("its bytes hash to ef (tried 5 times)\n"), "{whole}");
            assert!(description(&letter).contains("tried 5 times"));
        }
    }
}
