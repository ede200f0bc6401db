//! A replay under way: reading, analysing and storing side by side.

use std::time::Duration;

use jiff::Timestamp;
use tokio::sync::watch;

use super::batch::KeptBatch;
use super::read_ahead::{Batch, RecordStream};
use super::replay::{Pace, Replay, ReplayState};
use super::{Ingest, IngestError};

/// How often a running replay's progress is saved.
const SAVED_EVERY: Duration = Duration::from_secs(1);

impl Ingest {
    /// Runs a replay to its end and notes that.
    pub(super) async fn run_replay(&self, number: u64, mut replay: Replay, mut records: RecordStream, mut stopped: watch::Receiver<bool>) {
        let began = tokio::time::Instant::now();
        let mut summary = replay.so_far();
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
                if batch.records.is_empty() {
                    return Ok(Next::End);
                }
                self.keep_batch(&asset, batch).await.map(|batch| Next::Batch(Box::new(batch)))
            };
            let store = async {
                if before.is_none() {
                    return Ok(());
                }
                self.store_batch(before.take().map(|batch| *batch), &mut summary).await?;
                replay.note(&summary, seconds_before, began.elapsed());
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
        replay.note(&summary, seconds_before, began.elapsed());
        self.save_replay(number, &replay).await;
        self.announce_replay(number, &replay);
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

/// The next record once its time has come: as far after the first one as it was recorded, divided by `times`.
async fn paced(records: &mut RecordStream, times: f64, began: tokio::time::Instant, first_start: &mut Option<Timestamp>) -> Batch {
    let batch = records.next().await;
    if let Some((_, Ok(recorded))) = batch.records.first() {
        let start = recorded.record.start_time();
        let first = *first_start.get_or_insert(start);
        let seconds = (start.as_nanosecond() - first.as_nanosecond()) as f64 / 1e9 / times;
        if let Ok(wait) = Duration::try_from_secs_f64(seconds) {
            tokio::time::sleep_until(began + wait).await;
        }
    }
    batch
}
