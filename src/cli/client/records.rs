//! `flankwatch delete`, `exclude`, `include` and `baseline`: corrections of an asset's records on a server.

use clap::Args;
use jiff::Timestamp;

use super::server::{self, ServerArgs, asset_id, success_body};
use crate::cli::{CliError, output};

/// Arguments that select records of an asset: a time range or one segment.
#[derive(Args)]
#[command(group(clap::ArgGroup::new("which").required(true).multiple(true).args(["segment", "from", "to"])))]
pub(in crate::cli) struct RecordsArgs {
    /// Identifier of the asset
    #[arg(long, value_name = "ID", required_unless_present = "segment")]
    asset: Option<String>,
    /// One record, by its segment identifier
    #[arg(long, conflicts_with_all = ["asset", "channel", "from", "to"])]
    segment: Option<String>,
    /// Only records of this channel
    #[arg(long)]
    channel: Option<String>,
    /// Only records that start at or after this time
    #[arg(long, value_name = "TIME")]
    from: Option<Timestamp>,
    /// Only records that start before this time
    #[arg(long, value_name = "TIME")]
    to: Option<Timestamp>,
    #[command(flatten)]
    server: ServerArgs,
}

/// Arguments of `flankwatch baseline`.
#[derive(Args)]
pub(in crate::cli) struct BaselineArgs {
    /// Identifier of the asset
    #[arg(long, value_name = "ID")]
    asset: String,
    /// Start of the range: records that start at or after this time
    #[arg(long, value_name = "TIME")]
    from: Timestamp,
    /// End of the range: records that start before this time
    #[arg(long, value_name = "TIME")]
    to: Timestamp,
    /// Name of the person who chose the baseline
    #[arg(long, value_name = "NAME", default_value = "")]
    by: String,
    #[command(flatten)]
    server: ServerArgs,
}

pub(in crate::cli) fn choose_baseline(args: &BaselineArgs) -> Result<(), CliError> {
    let agent = args.server.agent(server::TIMEOUT)?;
    let url = args.server.address(&format!("assets/{}/maintenance", asset_id(&args.asset)?));
    let event = serde_json::json!({
        "time": args.from, "until": args.to, "kind": "baseline_chosen", "by": args.by,
    });
    let request = args.server.authorized(agent.post(&url)).content_type("application/json");
    success_body(&url, request.send(event.to_string()))?;
    output::print(&format!(
        "the records from {} to {} are now the baseline; the server is recomputing the history\n",
        args.from, args.to
    ))
}

/// A change of the selected records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::cli) enum Change {
    /// Deletes the records.
    Delete,
    /// Keeps the records but excludes them from the history.
    Exclude,
    /// Includes the records in the history again.
    Include,
}

pub(in crate::cli) fn run(args: &RecordsArgs, change: Change) -> Result<(), CliError> {
    let agent = args.server.agent(server::TIMEOUT)?;
    let url = match (&args.segment, &args.asset) {
        (Some(segment), _) => {
            if !segment.bytes().all(|byte| byte.is_ascii_alphanumeric()) {
                return Err(CliError::Argument(format!(
                    "--segment is {segment:?}, expected the identifier of a segment"
                )));
            }
            args.server.address(&format!("segments/{segment}"))
        }
        (None, asset) => {
            let asset = asset_id(asset.as_deref().unwrap_or_default())?;
            args.server.address(&format!("assets/{asset}/segments"))
        }
    };
    let result = match change {
        Change::Delete => args.complete(agent.delete(&url)).call(),
        Change::Exclude => args.complete(agent.post(format!("{url}/exclude"))).send_empty(),
        Change::Include => args.complete(agent.post(format!("{url}/include"))).send_empty(),
    };
    let body = success_body(&url, result)?;
    let answer: Option<serde_json::Value> = serde_json::from_str(&body).ok();
    let (name, done) = match change {
        Change::Delete => ("deleted", "deleted"),
        Change::Exclude => ("changed", "excluded"),
        Change::Include => ("changed", "included"),
    };
    let count = answer.and_then(|answer| answer[name].as_u64()).unwrap_or(1);
    let records = if count == 1 { "record" } else { "records" };
    output::print(&format!("{count} {records} {done}\n"))
}

impl RecordsArgs {
    /// Adds the range and the token to a request.
    fn complete<B>(&self, mut request: ureq::RequestBuilder<B>) -> ureq::RequestBuilder<B> {
        for (name, value) in [
            ("channel", self.channel.clone()),
            ("from", self.from.map(|time| time.to_string())),
            ("to", self.to.map(|time| time.to_string())),
        ] {
            if let Some(value) = value {
                request = request.query(name, value);
            }
        }
        self.server.authorized(request)
    }
}
