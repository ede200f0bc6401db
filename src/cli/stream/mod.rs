//! `flankwatch stream`: send samples to a server while they are measured.
//!
//! One thread reads, so that a source never waits for the server; this one sends. What the server has
//! answered to be kept is forgotten here. Indices count from 1970 at the stream's rate, so that a sender that
//! was stopped leaves a gap of the right length, also where nobody remembers how far it had come.

mod sender;
mod source;
mod spool;

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use jiff::Timestamp;

use super::interrupt::interrupted;
use super::{CliError, output};
use crate::asset::AssetId;
use crate::recording::RawSample;
use crate::recording::stream::StreamFormat;
use sender::{Sender, Sent};
use source::Source;
use spool::{Block, Spool};

/// How long is tried to send what is left after Ctrl-C.
const LAST_TRY: Duration = Duration::from_secs(5);

/// How often is looked whether Ctrl-C was pressed, or samples have come.
const LOOK_INTERVAL: Duration = Duration::from_millis(100);

/// Arguments of `flankwatch stream`.
#[derive(Args)]
pub(super) struct StreamArgs {
    /// What is read: a file, or - for the standard input. WAV of any length, or bare samples with --sample
    /// and --rate
    #[arg(default_value = "-")]
    source: String,
    /// The asset that the samples belong to
    #[arg(long)]
    asset: String,
    /// The server
    #[arg(long, default_value = "http://127.0.0.1:8600")]
    url: String,
    /// Name of the stream among those of the asset
    #[arg(long, default_value = "main")]
    name: String,
    /// How bare samples are written: f32 or i16, little-endian, channels interleaved
    #[arg(long, value_name = "TYPE", requires = "rate")]
    sample: Option<String>,
    /// Sampling rate of bare samples in hertz
    #[arg(long, value_name = "HZ", requires = "sample")]
    rate: Option<f64>,
    /// Channels of bare samples
    #[arg(long, default_value_t = 1, requires = "sample")]
    channels: u32,
    /// Value of one count in the unit [default: 1 for f32, 1/32768 for i16]
    #[arg(long, allow_negative_numbers = true)]
    scale: Option<f64>,
    /// Unit of the samples [default: that of the asset]
    #[arg(long)]
    unit: Option<String>,
    /// Names of the channels in their order, with commas between them
    #[arg(long, value_delimiter = ',')]
    channel_names: Vec<String>,
    /// Time of the first sample; a file needs it [default: now]
    #[arg(long)]
    start_time: Option<Timestamp>,
    /// Go on at the end of a file: it grows
    #[arg(long)]
    follow: bool,
    /// Folder for samples that cannot be sent yet; without it 64 MiB are kept in memory
    #[arg(long, value_name = "DIR")]
    spool: Option<PathBuf>,
    /// Most bytes in that folder; beyond them the oldest samples go
    #[arg(long, value_name = "BYTES", default_value_t = 1 << 30)]
    spool_bytes: u64,
    /// Certificates (PEM) that the server's certificate rests on, in place of the public ones
    #[arg(long, value_name = "FILE")]
    ca: Option<PathBuf>,
    /// Token to show to the server [default: the variable FLANKWATCH_TOKEN]
    #[arg(long)]
    token: Option<String>,
}

/// What the reading thread and the sending one share.
struct Shared {
    waiting: Mutex<Waiting>,
    changed: Condvar,
}

struct Waiting {
    spool: Spool,
    /// The source is at its end; or why it cannot be read.
    end: Option<Result<(), CliError>>,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, waiting: MutexGuard<'a, Waiting>) -> MutexGuard<'a, Waiting> {
        self.changed.wait_timeout(waiting, LOOK_INTERVAL).unwrap_or_else(PoisonError::into_inner).0
    }
}

/// Runs the command until the source ends or Ctrl-C.
pub(super) fn run(args: &StreamArgs) -> Result<(), CliError> {
    let asset = AssetId::new(args.asset.clone()).map_err(|error| CliError::Argument(error.to_string()))?;
    let is_file = args.source != "-";
    if is_file && args.start_time.is_none() {
        let detail = "--start-time is missing, expected the time of the first sample of the file";
        return Err(CliError::Argument(detail.to_owned()));
    }
    let stop = interrupted();
    let mut source =
        Source::open(&args.source, args.bare_format()?, args.follow && is_file, Arc::clone(&stop))?;
    let start = args.start_time.unwrap_or_else(Timestamp::now);
    let begin = index_of(start, &source.format)?;
    let mut sender = Sender::new(args, &asset, &source.format)?;
    let mut begin_index = begin;
    if let Some(next) = sender.server_next() {
        if is_file {
            let sent = next.saturating_sub(begin);
            source.skip(&args.source, sent)?;
            begin_index += sent;
        } else if next > begin && args.start_time.is_none() {
            // The clock went back since the last run: nothing new may look like a repeat.
            begin_index = next;
        }
    }
    let spool = Spool::open(args.spool.clone().filter(|_| !is_file), args.spool_bytes, &sender.format)?;
    let shared =
        Arc::new(Shared { waiting: Mutex::new(Waiting { spool, end: None }), changed: Condvar::new() });
    let reading = Reading {
        shared: Arc::clone(&shared),
        given: args.start_time.map(|start| (begin, start)),
        next: begin_index,
        waits: is_file,
        stop: Arc::clone(&stop),
    };
    // A thread that waits for its source ends with the process.
    thread::spawn(move || reading.run(source));
    let ended = send_all(&shared, &mut sender, &stop);
    let lost = shared.lock().spool.save()?;
    if lost > 0 {
        eprintln!("{lost} bytes of samples are not sent and not kept: --spool keeps them for the next run");
    }
    ended?;
    output::print(&format!("{} samples of each channel sent to {}\n", sender.sent, sender.url))
}

impl StreamArgs {
    /// The format of bare samples; none for WAV.
    fn bare_format(&self) -> Result<Option<StreamFormat>, CliError> {
        let Some((sample, rate_hz)) = self.sample.as_deref().zip(self.rate) else { return Ok(None) };
        let format = sample
            .parse()
            .and_then(|sample: RawSample| StreamFormat::new(sample, rate_hz, self.channels, self.scale));
        format.map(Some).map_err(|error| CliError::Argument(error.to_string()))
    }
}

/// The index of a sample that is measured at a time.
fn index_of(time: Timestamp, format: &StreamFormat) -> Result<u64, CliError> {
    let index = time.as_nanosecond() as f64 / 1e9 * format.sample_rate_hz();
    if (0.0..crate::recording::stream::MAX_INDEX as f64).contains(&index) {
        return Ok(index.round() as u64);
    }
    Err(CliError::Argument(format!("--start-time is {time}, expected a time after 1970 and before 2200")))
}

/// Sends until the source is at its end and everything is sent, or Ctrl-C.
fn send_all(shared: &Shared, sender: &mut Sender, stop: &AtomicBool) -> Result<(), CliError> {
    let mut stopped_at: Option<Instant> = None;
    loop {
        if stop.load(Ordering::Relaxed) {
            let since = stopped_at.get_or_insert_with(Instant::now);
            if since.elapsed() > LAST_TRY {
                return Ok(());
            }
        }
        let mut waiting = shared.lock();
        let Some(block) = waiting.spool.front()? else {
            match waiting.end.take() {
                Some(ended) => return ended,
                None if stopped_at.is_some() => return Ok(()),
                None => drop(shared.wait(waiting)),
            }
            continue;
        };
        drop(waiting);
        match sender.send(&block)? {
            Sent::Kept => {
                let mut waiting = shared.lock();
                // Another block is the oldest where there was no room for this one any more.
                if waiting.spool.front()?.is_some_and(|oldest| oldest.first == block.first) {
                    waiting.spool.pop()?;
                }
                if sender.was_away() && waiting.spool.is_empty() {
                    sender.caught_up();
                }
                shared.changed.notify_all();
            }
            Sent::Later(wait) => {
                let until = Instant::now() + wait;
                while Instant::now() < until && !stop.load(Ordering::Relaxed) {
                    thread::sleep(LOOK_INTERVAL.min(until - Instant::now().min(until)));
                }
            }
        }
    }
}

/// The thread that reads.
struct Reading {
    shared: Arc<Shared>,
    /// The index and time of the first sample, where the time is given.
    given: Option<(u64, Timestamp)>,
    next: u64,
    /// The source waits for the server: a file does.
    waits: bool,
    stop: Arc<AtomicBool>,
}

impl Reading {
    fn run(mut self, mut source: Source) {
        let ended = self.read_all(&mut source);
        self.shared.lock().end = Some(ended);
        self.shared.changed.notify_all();
    }

    fn read_all(&mut self, source: &mut Source) -> Result<(), CliError> {
        let format = source.format.clone();
        while !self.stop.load(Ordering::Relaxed)
            && let Some(bytes) = source.next()?
        {
            let frames = (bytes.len() / format.frame_bytes()) as u64;
            let (from, time) = match self.given {
                Some((begin, time)) => (self.next - begin, time),
                // The last sample is of now.
                None => (0, Timestamp::now() - seconds(&format, frames)),
            };
            let time = time + seconds(&format, from);
            let time_ns = i64::try_from(time.as_nanosecond()).unwrap_or_default();
            let block = Block { first: self.next, time_ns, bytes };
            self.next += frames;
            let mut waiting = self.shared.lock();
            while self.waits && waiting.spool.is_full() && !self.stop.load(Ordering::Relaxed) {
                waiting = self.shared.wait(waiting);
            }
            let was_on_disk = waiting.spool.is_on_disk();
            let given_up = waiting.spool.push(block)?;
            if given_up > 0 {
                let frames = given_up / format.frame_bytes() as u64;
                eprintln!("no room: the oldest {frames} samples that were not sent are given up");
            } else if !was_on_disk && waiting.spool.is_on_disk() {
                eprintln!("samples wait on the disk until they can be sent");
            }
            self.shared.changed.notify_all();
        }
        Ok(())
    }
}

fn seconds(format: &StreamFormat, frames: u64) -> jiff::SignedDuration {
    jiff::SignedDuration::from_secs_f64(format.seconds(frames))
}
