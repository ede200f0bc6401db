//! `flankwatch delete`, `exclude`, `include` and `baseline`: corrections of an asset's records on a server.

use clap::Args;
use jiff::Timestamp;

use super::server::{self, ServerArgs, asset_id, check_range, success_body};
use crate::asset::BaselineSpec;
use crate::cli::time::parse_time;
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
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    from: Option<Timestamp>,
    /// Only records that start before this time
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
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
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    from: Timestamp,
    /// End of the range: records that start before this time
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    to: Timestamp,
    /// Name of the person who chose the baseline
    #[arg(long, value_name = "NAME")]
    by: String,
    #[command(flatten)]
    server: ServerArgs,
}

pub(in crate::cli) fn choose_baseline(args: &BaselineArgs) -> Result<(), CliError> {
    check_range(Some(args.from), Some(args.to))?;
    let agent = args.server.agent(server::TIMEOUT)?;
    let asset = asset_id(&args.asset)?;
    let records_url = args.server.address(&format!("assets/{asset}/segments"));
    let request = agent.get(&records_url).query("limit", "1");
    let request = request.query("from", args.from.to_string()).query("to", args.to.to_string());
    let found = success_body(&records_url, args.server.authorized(request).call())?;
    let found: serde_json::Value = serde_json::from_str(&found).unwrap_or_default();
    if found["items"].as_array().is_some_and(Vec::is_empty) {
        return Err(CliError::Argument(format!(
            "asset {asset} has no record from {} to {}, expected a range with records",
            args.from, args.to
        )));
    }
    let url = args.server.address(&format!("assets/{asset}/maintenance"));
    let event = serde_json::json!({
        "time": args.from, "until": args.to, "kind": "baseline_chosen", "by": args.by,
    });
    let request = args.server.authorized(agent.post(&url)).content_type("application/json");
    let response = success_body(&url, request.send(event.to_string()))?;
    let response: serde_json::Value = serde_json::from_str(&response).unwrap_or_default();
    let records = response["records"].as_u64().unwrap_or_default();
    let least = u64::from(BaselineSpec::MIN_RECORDS);
    if records < least {
        output::print_stderr(&format!(
            "warning: a baseline needs at least {least} records: more are collected after the range"
        ));
    }
    output::print(&format!(
        "{} from {} to {} chosen as the baseline; the server is recomputing the history\n",
        output::counted(records, "record"),
        args.from,
        args.to
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
    check_range(args.from, args.to)?;
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
    let response: Option<serde_json::Value> = serde_json::from_str(&body).ok();
    let (name, done) = match change {
        Change::Delete => ("deleted", "deleted"),
        Change::Exclude => ("changed", "excluded"),
        Change::Include => ("changed", "included"),
    };
    let count = response.and_then(|response| response[name].as_u64()).unwrap_or(1);
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
