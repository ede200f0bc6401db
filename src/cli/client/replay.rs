//! `flankwatch replay`: sends recordings to a server, record by record.

use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use jiff::Timestamp;

use super::server::{ServerArgs, asset_id, failure, refusal};
use crate::cli::recordings::reading_progress::ReadingProgress;
use crate::cli::recordings::recording_files::recording_files;
use crate::cli::recordings::recording_values::{RecordingValues, parse_rate};
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

/// Shortest wait whose reason is printed.
const REPORTED_WAIT: Duration = Duration::from_secs(2);

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
    /// Channels to send, by name or, in CSV, number of the column from 1 [default: all]
    #[arg(long, value_delimiter = ',', value_name = "A,B")]
    channels: Vec<String>,
    /// Sampling rate in Hz; required where a recording has none, overrides that of a WAV or FLAC header
    #[arg(long, value_name = "HZ", value_parser = parse_rate)]
    rate: Option<f64>,
    #[command(flatten)]
    values: RecordingValues,
    /// Split recordings other than MCAP into records of this length in seconds; a remainder below half of it
    /// is dropped
    #[arg(long, value_name = "S")]
    record_seconds: Option<f64>,
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
    let result = sender.send_files(&files, args, &mut progress);
    drop(progress);
    output::print(&format!("{} sent to {}\n", output::counted(sender.sent, "record"), sender.url))?;
    match result? {
        0 => Ok(()),
        failed => Err(CliError::SomeFailed { action: "sent completely", failed, all: files.len() }),
    }
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
    /// Sends all files; returns how many could not be read, or have a record that the server refuses. Only
    /// another error of the server ends it.
    fn send_files(
        &mut self,
        files: &[PathBuf],
        args: &ReplayArgs,
        progress: &mut ReadingProgress,
    ) -> Result<usize, CliError> {
        let mut next_start = args.values.start_time();
        let mut failed = 0;
        for path in files {
            progress.begin(path);
            match self.send_file(path, args, &mut next_start, progress) {
                Ok(()) => {}
                Err(error @ CliError::Server { .. }) => return Err(error),
                Err(error) => {
                    progress.print(&format!("error: {error}"));
                    failed += 1;
                }
            }
        }
        Ok(failed)
    }

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
        let cut = args.record_seconds.map(Cut::Seconds);
        let mut file = RecordingFile::open_channels(path, &args.channels, defaults, cut)
            .map_err(CliError::recording(path))?;
        if let Some(note) = args.values.note(path, args.rate, &file) {
            progress.print(&note);
        }
        while let Some(recorded) = file.next() {
            let recorded = recorded.map_err(CliError::recording(path))?;
            if !args.values.is_dated(recorded.record.start_time()) {
                let detail = "no time in the recording, expected --start-time or --time-from-name";
                return Err(CliError::file(path)(detail));
            }
            *next_start = args.values.next_start(*next_start, recorded.record.end_time());
            self.wait_until_due(recorded.record.start_time());
            self.send(path, &recorded, progress)?;
            progress.set_read(file.bytes_read());
        }
        *next_start = file.end_time().map_or(*next_start, |end| args.values.next_start(*next_start, end));
        Ok(())
    }

    /// Waits until the record is due at the replay's pace.
    fn wait_until_due(&mut self, start_time: Timestamp) {
        let Pace::Times(factor) = self.pace else { return };
        let (first_time, began) = *self.first.get_or_insert_with(|| (start_time, Instant::now()));
        let due = start_time.duration_since(first_time).as_secs_f64().max(0.0) / factor;
        thread::sleep(Duration::from_secs_f64(due.min(1e9)).saturating_sub(began.elapsed()));
    }

    fn send(&mut self, path: &Path, recorded: &Recorded, progress: &ReadingProgress) -> Result<(), CliError> {
        let body = encode_block(&recorded.record, BlockEncoding::Protobuf);
        let mut wait = Duration::from_millis(250);
        let record = format!("channel {} at {}", recorded.record.channel(), recorded.record.start_time());
        let failed = |reason: String| {
            let reason = format!("{}: {record}: {reason}", path.display());
            CliError::Server { url: self.url.clone(), reason }
        };
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
                    if matches!(status, 413 | 422) {
                        return Err(CliError::file(path)(format!("{record}: {reason}")));
                    }
                    if !matches!(status, 429 | 502 | 503 | 504 | 507) {
                        return Err(failed(reason));
                    }
                    retry_after = seconds.map(Duration::from_secs);
                    reason
                }
                Err(error) => match failure(&error) {
                    (reason, true) => reason,
                    (reason, false) => return Err(failed(reason)),
                },
            };
            if attempts == MAX_ATTEMPTS {
                return Err(failed(format!(
                    "{reason} (gave up after {MAX_ATTEMPTS} attempts; run again to resume)"
                )));
            }
            let pause = retry_after.map_or(wait, |after| after.min(MAX_RETRY_AFTER));
            // A server that is busy for a moment is not worth a line.
            if pause >= REPORTED_WAIT {
                let seconds = pause.as_secs();
                progress.print(&format!("note: {}: {reason}; next attempt in {seconds} s", self.url));
            }
            thread::sleep(pause);
            wait = (wait * 2).min(MAX_WAIT);
        }
    }
}
