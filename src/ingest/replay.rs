//! Replays: a recording from the replay folder fed through the service as if it happened now.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use tokio::sync::watch;

use super::batch::{BatchSummary, KeptBatch, RecordStream};
use super::{Announcement, Ingest, IngestError, replay_folder};
use crate::asset::{AssetId, AssetSpec};
use crate::recording::{RecordDefaults, RecordingFile};
use crate::signal::OperatingPoint;

/// Ended replays that are remembered.
const MOST_REMEMBERED: usize = 1000;

/// How often a running replay's progress is saved.
const SAVED_EVERY: Duration = Duration::from_secs(1);

/// How fast a recording is replayed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Pace {
    /// As fast as it can be processed.
    Max,
    /// This many times as fast as it was recorded.
    Times(f64),
}

impl FromStr for Pace {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "max" => Ok(Self::Max),
            "realtime" => Ok(Self::Times(1.0)),
            _ => match text.strip_suffix('x').map(str::parse::<f64>) {
                Some(Ok(times)) if times > 0.0 && times <= 1e6 => Ok(Self::Times(times)),
                _ => Err(format!(
                    "pace is {text:?}, expected \"max\", \"realtime\" or a number above 0 and at most 1000000 with an x, such as \"10x\""
                )),
            },
        }
    }
}

impl TryFrom<String> for Pace {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Pace> for String {
    fn from(pace: Pace) -> Self {
        match pace {
            Pace::Max => "max".into(),
            Pace::Times(1.0) => "realtime".into(),
            Pace::Times(times) => format!("{times}x"),
        }
    }
}

/// What is to be replayed.
#[derive(Debug, Clone, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ReplayRequest {
    /// The asset whose records they become.
    pub asset: AssetId,
    /// The recording, relative to the replay folder.
    #[schema(example = "run.mcap")]
    pub file: String,
    /// How fast: `max`, `realtime` or a factor such as `10x`.
    #[serde(default = "Pace::max")]
    #[schema(value_type = String, example = "max", pattern = r"^(max|realtime|[0-9.]+x)$")]
    pub pace: Pace,
}

impl Pace {
    fn max() -> Self {
        Self::Max
    }
}

/// What a replay is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ReplayState {
    /// Under way.
    Running,
    /// Came to the end of the recording.
    Finished,
    /// Was stopped.
    Stopped,
    /// Could not go on.
    Failed,
}

/// A replay and how far it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Replay {
    /// Identifier.
    pub id: String,
    /// The asset whose records they become.
    pub asset: AssetId,
    /// The recording, relative to the replay folder.
    pub file: String,
    /// How fast: `max`, `realtime` or a factor such as `10x`.
    #[schema(value_type = String, example = "max")]
    pub pace: Pace,
    /// What it is doing.
    pub state: ReplayState,
    /// Why it failed; or why the first record that was refused was refused.
    pub error: Option<String>,
    /// Records in the recording, known at its end.
    pub records_total: Option<u64>,
    /// Records that are done, the refused ones too.
    pub records_done: u64,
    /// Records stored.
    pub stored: u64,
    /// Records that were stored before.
    pub repeated: u64,
    /// Records that could not be used.
    pub refused: u64,
    /// When it began.
    pub started_at: Timestamp,
    /// When it ended.
    pub finished_at: Option<Timestamp>,
    /// Start of the earliest record done.
    pub first_start_time: Option<Timestamp>,
    /// Start of the latest record done.
    pub last_start_time: Option<Timestamp>,
    /// Length of all records done, in seconds.
    pub record_seconds_done: f64,
    /// Length of all records done over the time it took.
    pub times_real_time: Option<f64>,
}

/// All replays that are remembered.
#[derive(Debug, Default)]
pub(super) struct Replays {
    held: Mutex<Held>,
    /// The service ends: replays that are stopped now go on at the next start.
    is_ending: AtomicBool,
}

#[derive(Debug, Default)]
struct Held {
    given_out: u64,
    by_number: BTreeMap<u64, (Arc<Replay>, watch::Sender<bool>)>,
}

impl Replays {
    fn lock(&self) -> MutexGuard<'_, Held> {
        // Entries are replaced whole, so a panic elsewhere cannot have left half of one.
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Ingest {
    /// Starts a replay.
    ///
    /// Errors: no such asset, a file outside the replay folder, too many recordings being read; a process that hands records over has no
    /// replay folder.
    pub async fn start_replay(&self, request: ReplayRequest) -> Result<Arc<Replay>, IngestError> {
        if self.is_entrance() {
            return Err(IngestError::ReplayFile {
                file: request.file,
                reason: "is in no folder that all API nodes have: `flankwatch replay` sends recordings to them",
            });
        }
        let spec = self.hearers(&request.asset).await?.asset.spec;
        let path = replay_folder::find(&self.inner.folders.recordings, &request.file)?;
        let turn = self.recording_turn()?;
        let started_at = self.inner.clock.now();
        let replay = Replay {
            id: String::new(),
            asset: request.asset,
            file: request.file,
            pace: request.pace,
            state: ReplayState::Running,
            error: None,
            records_total: None,
            records_done: 0,
            stored: 0,
            repeated: 0,
            refused: 0,
            started_at,
            finished_at: None,
            first_start_time: None,
            last_start_time: None,
            record_seconds_done: 0.0,
            times_real_time: None,
        };
        let (number, replay, forgotten) = {
            let mut held = self.inner.replays.lock();
            let number = held.given_out + 1;
            held.given_out = number;
            let replay = Replay {
                id: number.to_string(),
                ..replay
            };
            (number, replay, number.saturating_sub(MOST_REMEMBERED as u64))
        };
        self.save_replay(number, &replay).await;
        if let Err(error) = self.inner.store.forget_replays_before(forgotten).await {
            tracing::warn!(%error, "old replays not forgotten");
        }
        Ok(self.run_in_background(number, replay, spec, path, turn))
    }

    /// Goes on with the replays that were running when the process before ended, and remembers those that were over.
    pub(super) async fn resume_replays(&self) -> Result<(), IngestError> {
        for (number, text) in self.inner.store.saved_replays().await? {
            let replay: Replay = match serde_json::from_str(&text) {
                Ok(replay) => replay,
                Err(error) => {
                    tracing::warn!(replay = number, %error, "stored replay cannot be read");
                    continue;
                }
            };
            {
                let mut held = self.inner.replays.lock();
                held.given_out = held.given_out.max(number);
                let over = (Arc::new(replay.clone()), watch::channel(false).0);
                held.by_number.insert(number, over);
            }
            if replay.state == ReplayState::Running {
                tracing::info!(replay = number, file = replay.file, done = replay.records_done, "replay goes on");
                self.resume_replay(number, replay).await;
            }
        }
        Ok(())
    }

    async fn resume_replay(&self, number: u64, mut replay: Replay) {
        let found = async {
            let spec = self.hearers(&replay.asset).await?.asset.spec;
            let path = replay_folder::find(&self.inner.folders.recordings, &replay.file)?;
            Ok::<_, IngestError>((spec, path, self.recording_turn()?))
        };
        match found.await {
            Ok((spec, path, turn)) => {
                self.run_in_background(number, replay, spec, path, turn);
            }
            Err(error) => {
                tracing::warn!(replay = number, %error, "replay cannot go on");
                replay.state = ReplayState::Failed;
                replay.error = Some(error.to_string());
                replay.finished_at = Some(self.inner.clock.now());
                self.save_replay(number, &replay).await;
                if let Some((held, _)) = self.inner.replays.lock().by_number.get_mut(&number) {
                    *held = Arc::new(replay);
                }
            }
        }
    }

    fn run_in_background(
        &self,
        number: u64,
        replay: Replay,
        spec: AssetSpec,
        path: PathBuf,
        turn: tokio::sync::OwnedSemaphorePermit,
    ) -> Arc<Replay> {
        let (stop, stopped) = watch::channel(false);
        let first = Arc::new(replay.clone());
        {
            let mut held = self.inner.replays.lock();
            held.by_number.insert(number, (Arc::clone(&first), stop));
            while held.by_number.len() > MOST_REMEMBERED {
                let ended = held.by_number.iter().find(|(_, (replay, _))| replay.state != ReplayState::Running);
                let Some(number) = ended.map(|(number, _)| *number) else { break };
                held.by_number.remove(&number);
            }
        }
        let defaults = RecordDefaults {
            channel: spec.sensor.channel,
            start_time: replay.started_at,
            unit: spec.sensor.unit,
            operating_point: OperatingPoint::default(),
        };
        let done = usize::try_from(replay.records_done).unwrap_or(usize::MAX);
        let records = RecordStream::spawn(move || Ok(RecordingFile::open(&path, defaults, None)?.skip(done)));
        let ingest = self.clone();
        tokio::spawn(async move {
            let _turn = turn;
            ingest.run_replay(number, replay, records, stopped).await;
        });
        first
    }

    async fn save_replay(&self, number: u64, replay: &Replay) {
        // A recording in the folder of one of several processes is that one's own affair.
        if self.inner.store.is_shared() {
            return;
        }
        let text = match serde_json::to_string(replay) {
            Ok(text) => text,
            Err(error) => {
                tracing::warn!(replay = number, %error, "replay not saved");
                return;
            }
        };
        if let Err(error) = self.inner.store.save_replay(number, &text).await {
            tracing::warn!(replay = number, %error, "replay not saved");
        }
    }

    /// All replays, the latest first.
    pub fn replays(&self) -> Vec<Arc<Replay>> {
        let held = self.inner.replays.lock();
        held.by_number.values().rev().map(|(replay, _)| Arc::clone(replay)).collect()
    }

    /// A replay.
    ///
    /// Error: [`IngestError::ReplayUnknown`].
    pub fn replay(&self, id: &str) -> Result<Arc<Replay>, IngestError> {
        let unknown = || IngestError::ReplayUnknown(id.to_string());
        let number: u64 = id.parse().map_err(|_| unknown())?;
        let held = self.inner.replays.lock();
        held.by_number
            .get(&number)
            .map(|(replay, _)| Arc::clone(replay))
            .ok_or_else(unknown)
    }

    /// Stops a replay and waits until it has; one that has ended is left as it is.
    pub async fn stop_replay(&self, id: &str) -> Result<Arc<Replay>, IngestError> {
        self.replay(id)?;
        let ended = {
            let held = self.inner.replays.lock();
            let entry = id.parse().ok().and_then(|number: u64| held.by_number.get(&number));
            entry.map(|(_, stop)| {
                stop.send_replace(true);
                stop.clone()
            })
        };
        if let Some(ended) = ended {
            // The replay drops its end of the channel when it is over.
            ended.closed().await;
        }
        self.replay(id)
    }

    /// Whether the service ends.
    pub(super) fn is_ending(&self) -> bool {
        self.inner.replays.is_ending.load(Ordering::SeqCst)
    }

    /// Stops all replays, for the end of the service: they go on at its next start.
    pub async fn stop_replays(&self) {
        self.inner.replays.is_ending.store(true, Ordering::SeqCst);
        for replay in self.replays() {
            if let Err(error) = self.stop_replay(&replay.id).await {
                tracing::warn!(replay = replay.id, %error, "replay not stopped");
            }
        }
    }

    async fn run_replay(&self, number: u64, mut replay: Replay, mut records: RecordStream, mut stopped: watch::Receiver<bool>) {
        let began = tokio::time::Instant::now();
        let mut summary = BatchSummary {
            records: replay.records_done,
            stored: replay.stored,
            repeated: replay.repeated,
            refused_count: replay.refused,
            first_start_time: replay.first_start_time,
            last_start_time: replay.last_start_time,
            record_seconds: replay.record_seconds_done,
            ..BatchSummary::default()
        };
        let seconds_before = summary.record_seconds;
        let mut first_start = None;
        let mut saved = began;
        let mut before: Option<Box<KeptBatch<'_>>> = None;
        let (asset, pace) = (replay.asset.clone(), replay.pace);
        let end = loop {
            // While one batch waits for the disk, the next one is read and analysed.
            let next = async {
                let batch = tokio::select! {
                    _ = stopped.wait_for(|stopped| *stopped) => return Ok(Next::Stopped),
                    batch = async {
                        match pace {
                            Pace::Max => records.next_batch().await,
                            Pace::Times(times) => paced(&mut records, times, began, &mut first_start).await,
                        }
                    } => batch,
                };
                if batch.is_empty() {
                    return Ok(Next::End);
                }
                self.keep_batch(&asset, batch).await.map(|batch| Next::Batch(Box::new(batch)))
            };
            let store = async {
                if before.is_none() {
                    return Ok(());
                }
                self.store_batch(before.take().map(|batch| *batch), &mut summary).await?;
                show(&mut replay, &summary, seconds_before, began.elapsed());
                self.announce_replay(number, &replay);
                if saved.elapsed() > SAVED_EVERY {
                    saved = tokio::time::Instant::now();
                    self.save_replay(number, &replay).await;
                }
                Ok::<_, IngestError>(())
            };
            let (next, stored) = tokio::join!(next, store);
            match stored.and(next) {
                Ok(Next::Batch(batch)) => before = Some(batch),
                Ok(Next::Stopped) => break Ok(ReplayState::Stopped),
                Ok(Next::End) => {
                    break match summary.refused.first() {
                        Some(refused) if summary.refused_count == summary.records => Err(refused.reason.clone()),
                        _ => Ok(ReplayState::Finished),
                    };
                }
                Err(error) => break Err(error.to_string()),
            }
        };
        if matches!(end, Ok(ReplayState::Stopped)) && self.is_ending() {
            // Still running, for the next start.
            self.save_replay(number, &replay).await;
            return;
        }
        match end {
            Ok(state) => replay.state = state,
            Err(error) => {
                tracing::warn!(replay = replay.id, %error, "replay failed");
                replay.state = ReplayState::Failed;
                replay.error = Some(error);
            }
        }
        if replay.state == ReplayState::Finished {
            replay.records_total = Some(summary.records);
        }
        replay.finished_at = Some(self.inner.clock.now());
        show(&mut replay, &summary, seconds_before, began.elapsed());
        self.save_replay(number, &replay).await;
        self.announce_replay(number, &replay);
    }

    fn announce_replay(&self, number: u64, replay: &Replay) {
        let shown = Arc::new(replay.clone());
        if let Some((held, _)) = self.inner.replays.lock().by_number.get_mut(&number) {
            *held = Arc::clone(&shown);
        }
        self.announce(Announcement::ReplayChanged(shown));
    }
}

/// What comes next in a replay.
enum Next<'a> {
    /// Records.
    Batch(Box<KeptBatch<'a>>),
    /// Nothing: the recording is over.
    End,
    /// Nothing: the replay is to stop.
    Stopped,
}

/// Puts into a replay what became of its records so far.
fn show(replay: &mut Replay, summary: &BatchSummary, seconds_before: f64, elapsed: Duration) {
    replay.records_done = summary.records;
    replay.stored = summary.stored;
    replay.repeated = summary.repeated;
    replay.refused = summary.refused_count;
    replay.first_start_time = summary.first_start_time;
    replay.last_start_time = summary.last_start_time;
    replay.record_seconds_done = summary.record_seconds;
    let seconds = summary.record_seconds - seconds_before;
    replay.times_real_time = (summary.records > 0).then(|| seconds / elapsed.as_secs_f64().max(1e-9));
    if replay.error.is_none() {
        replay.error = summary
            .refused
            .first()
            .map(|refused| format!("record {}: {}", refused.record, refused.reason));
    }
}

/// The next record once its time has come: as far after the first one as it was recorded, divided by `times`.
async fn paced(
    records: &mut RecordStream,
    times: f64,
    began: tokio::time::Instant,
    first_start: &mut Option<Timestamp>,
) -> Vec<(u64, Result<crate::recording::Recorded, crate::recording::RecordingError>)> {
    let Some((number, record)) = records.next().await else {
        return Vec::new();
    };
    if let Ok(recorded) = &record {
        let start = recorded.record.start_time();
        let first = *first_start.get_or_insert(start);
        let seconds = (start.as_nanosecond() - first.as_nanosecond()) as f64 / 1e9 / times;
        if let Ok(wait) = Duration::try_from_secs_f64(seconds) {
            tokio::time::sleep_until(began + wait).await;
        }
    }
    vec![(number, record)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pace_is_read_and_written_alike() {
        for (text, pace) in [
            ("max", Pace::Max),
            ("realtime", Pace::Times(1.0)),
            ("10x", Pace::Times(10.0)),
            ("0.5x", Pace::Times(0.5)),
        ] {
            assert_eq!(text.parse(), Ok(pace));
            assert_eq!(String::from(pace), text);
        }
        for text in ["", "x", "10", "-1x", "0x", "NaNx", "infx", "fast"] {
            assert!(text.parse::<Pace>().is_err(), "{text}");
        }
    }
}
