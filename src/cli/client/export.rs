//! `flankwatch export`: writes the trends of an asset on a server as a table.

use std::io::Read;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use jiff::Timestamp;

use super::server::{self, ServerArgs, asset_id, check_range, success, success_body};
use crate::cli::output_check::{OutputKind, check_result};
use crate::cli::time::parse_time;
use crate::cli::{CliError, output};
use crate::http::{CHANNEL, PARQUET, REDUCED, ROWS};

/// Maximum number of rows, the same as that of the API.
const MAX_ROWS: usize = 200_000;

/// Arguments of `flankwatch export`.
#[derive(Args)]
pub(in crate::cli) struct ExportArgs {
    /// Which trend
    #[arg(value_enum)]
    trend: ExportedTrend,
    /// File to write: .parquet or .csv; it replaces such a table only
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Identifier of the asset
    #[arg(long, value_name = "ID")]
    asset: String,
    /// The channel [default: the one that represents the asset]
    #[arg(long)]
    channel: Option<String>,
    /// Names of the indicators [default: all]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    names: Vec<String>,
    /// Only records that start at or after this time
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    from: Option<Timestamp>,
    /// Only records that start before this time
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    to: Option<Timestamp>,
    #[command(flatten)]
    server: ServerArgs,
}

/// What is exported.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ExportedTrend {
    /// Indicators, one row per record
    Indicators,
    /// The wear estimate, one row per record
    Wear,
}

impl ExportedTrend {
    fn path(self) -> &'static str {
        match self {
            Self::Indicators => "indicators",
            Self::Wear => "wear/history",
        }
    }
}

/// Runs the command. The server writes the table, as for any client of its API.
pub(in crate::cli) fn run(args: &ExportArgs) -> Result<(), CliError> {
    let (media_type, kind) = format_of(&args.output)?;
    check_result(&args.output, kind)?;
    if args.trend == ExportedTrend::Wear && !args.names.is_empty() {
        let names = args.names.join(",");
        return Err(CliError::Argument(format!(
            "--names is {names}, expected no names of indicators for wear"
        )));
    }
    check_range(args.from, args.to)?;
    let agent = args.server.agent(server::TIMEOUT)?;
    let asset_url = args.server.address(&format!("assets/{}", asset_id(&args.asset)?));
    let url = format!("{asset_url}/{}", args.trend.path());
    let mut request = agent.get(&url).header("accept", media_type).query("max_points", MAX_ROWS.to_string());
    for (name, value) in [
        ("names", Some(args.names.join(",")).filter(|names| !names.is_empty())),
        ("channel", args.channel.clone()),
        ("from", args.from.map(|time| time.to_string())),
        ("to", args.to.map(|time| time.to_string())),
    ] {
        if let Some(value) = value {
            request = request.query(name, value);
        }
    }
    let mut response = success(&url, args.server.authorized(request).call())?;
    let failed = |reason: String| CliError::Server { url: url.clone(), reason };
    if response.headers().contains_key(REDUCED) {
        let expected = "a shorter range: use --from and --to";
        return Err(failed(format!("the trend has more than {MAX_ROWS} records, expected {expected}")));
    }
    let mut table = Vec::new();
    let read = response.body_mut().as_reader().read_to_end(&mut table);
    read.map_err(|error| failed(error.to_string()))?;
    output::write_file(&args.output, &table)?;
    let header = |name| response.headers().get(name).map(|value| String::from_utf8_lossy(value.as_bytes()));
    let rows = header(ROWS).and_then(|rows| rows.parse().ok()).unwrap_or_default();
    let mut text = output::counted(rows, "record");
    if let Some(channel) = header(CHANNEL) {
        text += &format!(" of channel {channel:?} in {}", args.output.display());
        let asset = success_body(&asset_url, args.server.authorized(agent.get(&asset_url)).call())?;
        let asset: serde_json::Value = serde_json::from_str(&asset).unwrap_or_default();
        let channels =
            asset["summary"]["channels"].as_array().into_iter().flatten().filter_map(|name| name.as_str());
        let others: Vec<&str> = channels.filter(|name| *name != channel).collect();
        if args.channel.is_none() && !others.is_empty() {
            text += &format!(" (other channels: {}; see --channel)", others.join(", "));
        }
    } else {
        text += &format!(" in {}", args.output.display());
    }
    output::print(&format!("{text}\n"))
}

/// Returns the media type and the kind of the table, by the extension of OUT.
fn format_of(path: &Path) -> Result<(&'static str, OutputKind), CliError> {
    match path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).as_deref() {
        Some("parquet") => Ok((PARQUET, OutputKind::Parquet)),
        Some("csv") => Ok(("text/csv", OutputKind::CsvTrend)),
        _ => Err(CliError::Argument(format!(
            "OUT is {}, expected a name that ends in .parquet or .csv",
            path.display()
        ))),
    }
}
