//! `flankwatch stream`: sends samples to a server as they are measured.
//!
//! A second thread reads, so that the source never waits for the server; the main thread sends. A block is
//! dropped once the server has acknowledged it. Sample indices count from 1970 at the stream's rate: a sender
//! that was stopped leaves a gap of the right length without storing its position.

#[cfg(all(feature = "alsa", target_os = "linux"))]
mod capture;
mod sender;
#[cfg(all(feature = "alsa", target_os = "linux"))]
mod sound_card;
mod source;
mod spool;

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use clap::{ArgGroup, Args};
use jiff::Timestamp;

use super::server::{ServerArgs, asset_id};
use crate::asset::DEFAULT_STREAM;
use crate::cli::interrupt::interrupted;
use crate::cli::time::parse_time;
use crate::cli::{CliError, output};
use crate::recording::stream::StreamFormat;
use crate::recording::{RawSample, RecordingError};
use sender::{SendOutcome, Sender};
use source::{SampleSource, Source, SourceBlock};
use spool::{Block, Spool};

/// Time to send the remaining blocks after Ctrl-C.
const STOP_TIMEOUT: Duration = Duration::from_secs(5);

/// Interval at which Ctrl-C and new samples are polled.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Arguments of `flankwatch stream`.
#[derive(Args)]
#[command(group = ArgGroup::new("without header").args(["sample", "alsa"]).multiple(true))]
pub(in crate::cli) struct StreamArgs {
    /// File to read, or - for standard input: WAV of any length, or raw samples with --sample and --rate
    #[arg(default_value = "-")]
    source: String,
    /// Identifier of the asset that the samples belong to
    #[arg(long, value_name = "ID")]
    asset: String,
    #[command(flatten)]
    server: ServerArgs,
    /// Name of the stream, unique within the asset
    #[arg(long, default_value = DEFAULT_STREAM)]
    name: String,
    /// Sound card to read instead of a file or pipe, by its name in ALSA, such as hw:1; with --rate
    #[arg(long, value_name = "DEVICE", requires = "rate", conflicts_with_all = ["source", "start_time", "follow"])]
    alsa: Option<String>,
    /// Type of raw samples: f32 or i16, little-endian, channels interleaved
    #[arg(long, value_name = "TYPE", requires = "rate")]
    sample: Option<String>,
    /// Sampling rate of raw samples or of a sound card in Hz
    #[arg(long, value_name = "HZ", requires = "without header")]
    rate: Option<f64>,
    /// Number of channels of raw samples or of a sound card
    #[arg(long, default_value_t = 1, requires = "without header")]
    channels: u32,
    /// Value of one count in the unit [default: 1 for f32, 1/32768 for i16]
    #[arg(long, value_name = "FACTOR", allow_negative_numbers = true)]
    scale: Option<f64>,
    /// Unit of the samples [default: that of the asset]
    #[arg(long)]
    unit: Option<String>,
    /// Names of the channels, comma-separated, in order
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    channel_names: Vec<String>,
    /// Name or number of the channel that is the signal of a tachometer on the driving shaft
    #[arg(long, value_name = "NAME", requires = "tachometer_level")]
    tachometer_channel: Option<String>,
    /// Level at which a pulse of the tachometer begins, in the unit of the samples
    #[arg(long, value_name = "VALUE", requires = "tachometer_channel", allow_negative_numbers = true)]
    tachometer_level: Option<f64>,
    /// By how much its signal falls below the level between two pulses [default: half the level]
    #[arg(long, value_name = "VALUE", requires = "tachometer_channel")]
    tachometer_hysteresis: Option<f64>,
    /// Its pulses per revolution [default: 1]
    #[arg(long, value_name = "N", requires = "tachometer_channel")]
    pulses_per_revolution: Option<u32>,
    /// Time of the first sample; required for a file [default: now]
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    start_time: Option<Timestamp>,
    /// Continue at the end of the file as it grows
    #[arg(long)]
    follow: bool,
    /// Folder to buffer samples in while the server is unreachable [default: 64 MiB in memory]
    #[arg(long, value_name = "DIR")]
    spool: Option<PathBuf>,
    /// Maximum size of the spool folder in bytes; above it the oldest samples are dropped
    #[arg(long, value_name = "BYTES", default_value_t = 1 << 30)]
    spool_bytes: u64,
}

/// State shared by the reading and the sending thread.
struct Shared {
    buffer: Mutex<Buffer>,
    changed: Condvar,
}

struct Buffer {
    spool: Spool,
    /// Set when the source ends, or with the error that ended reading.
    end: Option<Result<(), CliError>>,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Buffer> {
        self.buffer.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, buffer: MutexGuard<'a, Buffer>) -> MutexGuard<'a, Buffer> {
        self.changed.wait_timeout(buffer, POLL_INTERVAL).unwrap_or_else(PoisonError::into_inner).0
    }
}

/// Runs the command until the source ends or Ctrl-C.
pub(in crate::cli) fn run(args: &StreamArgs) -> Result<(), CliError> {
    let asset = asset_id(&args.asset)?;
    let is_file = args.alsa.is_none() && args.source != "-";
    if is_file && args.start_time.is_none() {
        let detail = "--start-time is missing, expected the time of the first sample of the file";
        return Err(CliError::Argument(detail.to_owned()));
    }
    if !is_file && args.follow {
        let detail = "--follow is given without a file, expected a file that grows";
        return Err(CliError::Argument(detail.to_owned()));
    }
    if is_file && args.spool.is_some() {
        let detail =
            "--spool is given with a file, expected standard input or --alsa: a file is read again instead";
        return Err(CliError::Argument(detail.to_owned()));
    }
    let stop = interrupted();
    let mut source = match &args.alsa {
        Some(device) => Input::Device(sound_card(device, args, Arc::clone(&stop))?),
        None => Input::Bytes(Box::new(Source::open(
            &args.source,
            args.raw_format()?,
            args.follow,
            Arc::clone(&stop),
        )?)),
    };
    let start = args.start_time.unwrap_or_else(Timestamp::now);
    let format = source.format().clone();
    let begin = index_of(start, &format)?;
    let mut sender = Sender::new(args, &asset, &format)?;
    let mut begin_index = begin;
    if let Some(next) = sender.open()? {
        if let Input::Bytes(source) = &mut source
            && is_file
        {
            let stored = next.saturating_sub(begin);
            if stored > source.skip(&args.source, stored)? {
                return Err(continues_after(args, next, &format));
            }
            begin_index += stored;
            sender.repeated = stored;
        } else if next > begin && args.start_time.is_none() {
            // The clock was set back since the last run: new samples must not look like repeated ones.
            begin_index = next;
        }
    }
    let spool = Spool::open(args.spool.clone(), args.spool_bytes, &sender.format)?;
    if args.start_time.is_none() {
        // The same for those of the last run that are not sent yet.
        begin_index = begin_index.max(spool.end_on_disk(format.frame_bytes()));
    }
    let shared =
        Arc::new(Shared { buffer: Mutex::new(Buffer { spool, end: None }), changed: Condvar::new() });
    let reader = Reader {
        shared: Arc::clone(&shared),
        start: args.start_time.map(|start| (begin, start)),
        next: begin_index,
        blocks_when_full: is_file,
        stop: Arc::clone(&stop),
    };
    // Not joined: a thread that waits for its source ends with the process.
    thread::spawn(move || reader.run(source.into_source()));
    let mut result = send_all(&shared, &mut sender, &stop);
    let lost = shared.lock().spool.save()?;
    if lost > 0 {
        output::print_stderr(&format!(
            "lost {lost} bytes of unsent samples: use --spool to keep them for the next run"
        ));
    }
    let repeated = match sender.repeated {
        0 => String::new(),
        repeated => format!(", which had {repeated} already"),
    };
    output::print(&format!("{} samples of each channel sent to {}{repeated}\n", sender.sent, sender.url))?;
    if let Some(refused) = sender.refused() {
        match result {
            Ok(()) => result = Err(sender.failed(refused)),
            Err(_) => output::print_stderr(&refused),
        }
    }
    result?;
    let next = sender.next.filter(|next| sender.sent == 0 && *next > begin + sender.repeated);
    match next.filter(|_| sender.repeated > 0) {
        Some(next) => Err(continues_after(args, next, &format)),
        None => Ok(()),
    }
}

/// The error for samples of a time that the stream has passed.
fn continues_after(args: &StreamArgs, next: u64, format: &StreamFormat) -> CliError {
    let to = Timestamp::UNIX_EPOCH + seconds(format, next);
    CliError::Argument(format!(
        "stream {} already continues to {to}, expected a later --start-time or another --name",
        args.name
    ))
}

impl StreamArgs {
    /// Returns the format of raw samples; `None` for WAV.
    fn raw_format(&self) -> Result<Option<StreamFormat>, CliError> {
        let Some((sample, rate_hz)) = self.sample.as_deref().zip(self.rate) else { return Ok(None) };
        let format = sample
            .parse()
            .and_then(|sample: RawSample| StreamFormat::new(sample, rate_hz, self.channels, self.scale));
        format.map(Some).map_err(|error| match error {
            RecordingError::Field { field, value, expected } => CliError::option(field, value, expected),
            error => CliError::Argument(error.to_string()),
        })
    }
}

/// What the samples are read from.
enum Input {
    /// A pipe or a file.
    Bytes(Box<Source>),
    /// A sound card.
    Device(Box<dyn SampleSource>),
}

impl Input {
    fn format(&self) -> &StreamFormat {
        match self {
            Self::Bytes(source) => source.format(),
            Self::Device(source) => source.format(),
        }
    }

    fn into_source(self) -> Box<dyn SampleSource> {
        match self {
            Self::Bytes(source) => source,
            Self::Device(source) => source,
        }
    }
}

#[cfg(all(feature = "alsa", target_os = "linux"))]
fn sound_card(
    device: &str,
    args: &StreamArgs,
    stop: Arc<AtomicBool>,
) -> Result<Box<dyn SampleSource>, CliError> {
    let sample = args.sample.as_deref().map(str::parse::<RawSample>).transpose();
    let wanted = sound_card::WantedFormat {
        sample: sample.map_err(|error| CliError::Argument(error.to_string()))?,
        rate_hz: args.rate.unwrap_or_default(),
        channels: args.channels,
        scale: args.scale,
    };
    Ok(Box::new(sound_card::SoundCard::open(device, &wanted, stop)?))
}

#[cfg(not(all(feature = "alsa", target_os = "linux")))]
fn sound_card(device: &str, _: &StreamArgs, _: Arc<AtomicBool>) -> Result<Box<dyn SampleSource>, CliError> {
    Err(CliError::Argument(format!(
        "--alsa is {device}, but this program was built without the feature alsa, which Linux alone has: \
         pipe the samples of arecord instead"
    )))
}

/// Returns the index of the sample measured at a time.
fn index_of(time: Timestamp, format: &StreamFormat) -> Result<u64, CliError> {
    let index = time.as_nanosecond() as f64 / 1e9 * format.sample_rate_hz();
    if (0.0..crate::recording::stream::MAX_INDEX as f64).contains(&index) {
        return Ok(index.round() as u64);
    }
    Err(CliError::Argument(format!("--start-time is {time}, expected a time after 1970 and before 2200")))
}

/// Sends until the source has ended and everything is sent, or until [`STOP_TIMEOUT`] after Ctrl-C.
fn send_all(shared: &Shared, sender: &mut Sender, stop: &AtomicBool) -> Result<(), CliError> {
    let mut stopped_at: Option<Instant> = None;
    loop {
        if stop.load(Ordering::Relaxed) {
            let since = stopped_at.get_or_insert_with(Instant::now);
            if since.elapsed() > STOP_TIMEOUT {
                return Ok(());
            }
        }
        let mut buffer = shared.lock();
        let Some(block) = buffer.spool.front()? else {
            match buffer.end.take() {
                Some(result) => return result,
                None if stopped_at.is_some() => return Ok(()),
                None => drop(shared.wait(buffer)),
            }
            continue;
        };
        drop(buffer);
        match sender.send(&block)? {
            SendOutcome::Stored => {
                let mut buffer = shared.lock();
                // The spool may have dropped this block meanwhile: then another one is the oldest.
                if buffer.spool.front()?.is_some_and(|oldest| oldest.first == block.first) {
                    buffer.spool.pop()?;
                }
                if sender.is_behind() && buffer.spool.is_empty() {
                    sender.caught_up();
                }
                shared.changed.notify_all();
            }
            SendOutcome::RetryAfter(wait) => {
                let until = Instant::now() + wait;
                while Instant::now() < until && !stop.load(Ordering::Relaxed) {
                    thread::sleep(POLL_INTERVAL.min(until - Instant::now().min(until)));
                }
            }
        }
    }
}

/// The reading thread.
struct Reader {
    shared: Arc<Shared>,
    /// Index and time of the first sample, if --start-time is given.
    start: Option<(u64, Timestamp)>,
    /// Index of the next sample.
    next: u64,
    /// Whether reading waits while the spool is full, as for a file, instead of dropping the oldest samples.
    blocks_when_full: bool,
    stop: Arc<AtomicBool>,
}

impl Reader {
    fn run(mut self, mut source: Box<dyn SampleSource>) {
        let result = self.read_all(&mut *source);
        self.shared.lock().end = Some(result);
        self.shared.changed.notify_all();
    }

    fn read_all(&mut self, source: &mut dyn SampleSource) -> Result<(), CliError> {
        let format = source.format().clone();
        let mut is_first = true;
        while !self.stop.load(Ordering::Relaxed)
            && let Some(SourceBlock { lost, time, bytes }) = source.next()?
        {
            // Before the first one, the device is only being started.
            if lost > 0 && !is_first {
                output::print_stderr(&format!(
                    "lost {lost} samples of each channel: the device was read too late"
                ));
            }
            is_first = false;
            self.next += lost;
            let frames = (bytes.len() / format.frame_bytes()) as u64;
            let time = match self.start {
                Some((begin, start)) => start + seconds(&format, self.next - begin),
                None => time,
            };
            let time_ns = i64::try_from(time.as_nanosecond()).unwrap_or_default();
            let block = Block { first: self.next, time_ns, bytes };
            self.next += frames;
            let mut buffer = self.shared.lock();
            while self.blocks_when_full && buffer.spool.is_full() && !self.stop.load(Ordering::Relaxed) {
                buffer = self.shared.wait(buffer);
            }
            let was_on_disk = buffer.spool.is_on_disk();
            let dropped_bytes = buffer.spool.push(block)?;
            if dropped_bytes > 0 {
                let frames = dropped_bytes / format.frame_bytes() as u64;
                output::print_stderr(&format!("buffer full: dropped the oldest {frames} unsent samples"));
            } else if !was_on_disk && buffer.spool.is_on_disk() {
                output::print_stderr("buffering samples on disk until they can be sent");
            }
            self.shared.changed.notify_all();
        }
        Ok(())
    }
}

fn seconds(format: &StreamFormat, frames: u64) -> jiff::SignedDuration {
    jiff::SignedDuration::from_secs_f64(format.seconds(frames))
}
