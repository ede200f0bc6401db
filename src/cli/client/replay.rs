//! `flankwatch replay`: sends recordings to a server, record by record.

use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use jiff::Timestamp;

use super::server::{ServerArgs, asset_id, refusal};
use crate::cli::recordings::reading_progress::ReadingProgress;
use crate::cli::recordings::recording_files::recording_files;
use crate::cli::recordings::recording_values::RecordingValues;
use crate::cli::{CliError, output};
use crate::recording::{
    BlockEncoding, Cut, RecordDefaults, Recorded, RecordingFile, TimeOfDay, encode_block,
};
use crate::service::Pace;

/// Maximum attempts to send a record while the server is busy or unreachable.
const MAX_ATTEMPTS: u32 = 8;

/// Timeout of a request.
const TIMEOUT: Duration = Duration::from_secs(120);

/// Maximum wait between two attempts where the server sends no `Retry-After`.
const MAX_WAIT: Duration = Duration::from_secs(30);

/// Maximum wait by `Retry-After`.
const MAX_RETRY_AFTER: Duration = Duration::from_secs(600);

/// Arguments of `flankwatch replay`.
#[derive(Args)]
pub(in crate::cli) struct ReplayArgs {
    /// Recordings in time order, folders or patterns such as `day-*.wav`
    ///
    /// Reads WAV, FLAC, MCAP, CSV (also .csv.gz), MATLAB (.mat, v5) and NumPy (.npy). The files of folders
    /// and patterns are read in order of their names.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Identifier of the asset that the recordings belong to
    #[arg(long, value_name = "ID")]
    asset: String,
    #[command(flatten)]
    server: ServerArgs,
    /// Replay speed: realtime, max, or a factor such as 10x
    #[arg(long, default_value = "max")]
    pace: Pace,
    /// Sampling rate in Hz of NumPy arrays, and of CSV and MATLAB files without one
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    #[command(flatten)]
    values: RecordingValues,
    /// Split recordings other than MCAP into records of this length in seconds; a remainder below half of it
    /// is dropped
    #[arg(long, value_name = "S")]
    record_seconds: Option<f64>,
    /// Time of the first sample, for recordings without one; later recordings follow on
    #[arg(long, value_name = "TIME", default_value = "1970-01-01T00:00:00Z")]
    start_time: Timestamp,
}

/// Runs the command. The server ignores records that it has already, so an interrupted replay is resumed by
/// running it again.
pub(in crate::cli) fn run(args: &ReplayArgs) -> Result<(), CliError> {
    let asset = asset_id(&args.asset)?;
    let mut sender = Sender {
        server: &args.server,
        agent: args.server.agent(TIMEOUT)?,
        url: args.server.address(&format!("assets/{asset}/segments")),
        pace: args.pace,
        first: None,
        sent: 0,
    };
    let files = recording_files(&args.files)?;
    let mut progress = ReadingProgress::new(&files);
    let mut next_start = args.start_time;
    for path in &files {
        progress.begin(path);
        sender.send_file(path, args, &mut next_start, &progress)?;
    }
    drop(progress);
    output::print(&format!("{} sent to {}\n", output::counted(sender.sent, "record"), sender.url))
}

struct Sender<'a> {
    server: &'a ServerArgs,
    agent: ureq::Agent,
    url: String,
    pace: Pace,
    first: Option<(Timestamp, Instant)>,
    sent: u64,
}

impl Sender<'_> {
    fn send_file(
        &mut self,
        path: &Path,
        args: &ReplayArgs,
        next_start: &mut Timestamp,
        progress: &ReadingProgress,
    ) -> Result<(), CliError> {
        let mut defaults = RecordDefaults {
            start_time: *next_start,
            time_of_day: TimeOfDay::FromStart,
            sample_rate_hz: args.rate,
            // The server knows the asset's unit.
            unit: Some(String::new()),
            ..RecordDefaults::default()
        };
        args.values.apply(path, &mut defaults)?;
        let mut file = RecordingFile::open(path, defaults, args.record_seconds.map(Cut::Seconds))
            .map_err(CliError::file(path))?;
        while let Some(recorded) = file.next() {
            let recorded = recorded.map_err(CliError::file(path))?;
            *next_start = (*next_start).max(recorded.record.end_time());
            self.wait_until_due(recorded.record.start_time());
            self.send(&recorded, progress)?;
            progress.set_read(file.bytes_read());
        }
        *next_start = file.end_time().map_or(*next_start, |end| end.max(*next_start));
        Ok(())
    }

    /// Waits until the record is due at the replay's pace.
    fn wait_until_due(&mut self, start_time: Timestamp) {
        let Pace::Times(factor) = self.pace else { return };
        let (first_time, began) = *self.first.get_or_insert_with(|| (start_time, Instant::now()));
        let due = start_time.duration_since(first_time).as_secs_f64().max(0.0) / factor;
        thread::sleep(Duration::from_secs_f64(due.min(1e9)).saturating_sub(began.elapsed()));
    }

    fn send(&mut self, recorded: &Recorded, progress: &ReadingProgress) -> Result<(), CliError> {
        let body = encode_block(&recorded.record, BlockEncoding::Protobuf);
        let mut wait = Duration::from_millis(250);
        let failed = |reason: String| CliError::Server { url: self.url.clone(), reason };
        let mut attempts = 0;
        loop {
            attempts += 1;
            let mut retry_after = None;
            let request = self.agent.post(&self.url).content_type("application/x-protobuf");
            let mut request = self.server.authorized(request);
            if let Some(depth) = recorded.reference_wear_um {
                request = request.query("reference_wear_um", depth.to_string());
            }
            // In a block this time means none, and the server would take the time of receipt.
            if recorded.record.start_time() == Timestamp::UNIX_EPOCH {
                request = request.query("start_time", Timestamp::UNIX_EPOCH.to_string());
            }
            let reason = match request.send(&body) {
                Ok(response) if response.status().is_success() => {
                    self.sent += 1;
                    return Ok(());
                }
                Ok(mut response) => {
                    let status = response.status().as_u16();
                    let header = response.headers().get("retry-after");
                    let seconds = header.and_then(|value| value.to_str().ok()?.parse().ok());
                    let reason = refusal(status, &response.body_mut().read_to_string().unwrap_or_default());
                    if !matches!(status, 429 | 502 | 503 | 504 | 507) {
                        return Err(failed(reason));
                    }
                    retry_after = seconds.map(Duration::from_secs);
                    reason
                }
                Err(error) => error.to_string(),
            };
            if attempts == MAX_ATTEMPTS {
                return Err(failed(format!(
                    "{reason} (gave up after {MAX_ATTEMPTS} attempts with {} records sent; run again to resume)",
                    self.sent
                )));
            }
            // A server that is busy for a moment is not worth a line.
            if attempts == 2 {
                progress.print(&format!("note: {}: {reason}; still trying", self.url));
            }
            thread::sleep(retry_after.map_or(wait, |after| after.min(MAX_RETRY_AFTER)));
            wait = (wait * 2).min(MAX_WAIT);
        }
    }
}
