//! A running replay: reading, analysing and storing concurrently.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use jiff::Timestamp;
use tokio::sync::watch;

use super::list::ReplayList;
use crate::service::clock::Clock;
use crate::service::error::ServiceError;
use crate::service::pipeline::{BatchSummary, Pipeline, ReadBatch, RecordStream, RecordedBatch};
use crate::service::record::ChannelUnits;
use crate::service::replay::{Pace, Replay, ReplayState};

/// Time between two saves of a running replay's progress.
const SAVED_EVERY: Duration = Duration::from_secs(1);

/// The context of a running replay.
pub(crate) struct Run {
    pub(crate) pipeline: Arc<Pipeline>,
    pub(crate) list: Arc<ReplayList>,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) is_ending: Arc<AtomicBool>,
    pub(crate) number: u64,
}

impl Run {
    /// Runs a replay to its end and saves the outcome.
    pub(crate) async fn to_end(
        &self,
        mut replay: Replay,
        mut records: RecordStream,
        mut stopped: watch::Receiver<bool>,
    ) {
        let began = tokio::time::Instant::now();
        let mut summary = so_far(&replay);
        let seconds_before = summary.record_seconds;
        let mut first_start = None;
        let mut learned = ChannelUnits::default();
        let mut saved = began;
        let mut before: Option<Box<RecordedBatch>> = None;
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
                let begun = self.pipeline.begin_batch(&asset, batch, &mut learned).await?;
                Ok(Next::Batch(Box::new(begun)))
            };
            let store = async {
                if before.is_none() {
                    return Ok(());
                }
                self.pipeline.finish_batch(before.take().map(|batch| *batch), &mut summary).await?;
                update(&mut replay, &summary, seconds_before, began.elapsed());
                self.list.publish(self.number, &replay);
                if saved.elapsed() > SAVED_EVERY {
                    saved = tokio::time::Instant::now();
                    self.list.save(self.number, &replay).await;
                }
                Ok::<_, ServiceError>(())
            };
            let (next, stored) = tokio::join!(next, store);
            match stored.and(next) {
                Ok(Next::Batch(batch)) => before = Some(batch),
                Ok(Next::Stopped) => break Ok(ReplayState::Stopped),
                Ok(Next::End) => {
                    break match summary.refused.first() {
                        Some(refused) if summary.refused_count == summary.records => {
                            Err(refused.reason.clone())
                        }
                        _ => Ok(ReplayState::Finished),
                    };
                }
                Err(error) => break Err(error.to_string()),
            }
        };
        if matches!(end, Ok(ReplayState::Stopped)) && self.is_ending.load(Ordering::SeqCst) {
            // Still running, for the next start.
            self.list.save(self.number, &replay).await;
            return;
        }
        match end {
            Ok(state) => replay.state = state,
            Err(error) => {
                tracing::warn!(replay = replay.id, %error, "failed to complete a replay");
                replay.state = ReplayState::Failed;
                replay.error = Some(error);
            }
        }
        if replay.state == ReplayState::Finished {
            replay.records_total = Some(summary.records);
        }
        replay.finished_at = Some(self.clock.now());
        update(&mut replay, &summary, seconds_before, began.elapsed());
        self.list.save(self.number, &replay).await;
        self.list.publish(self.number, &replay);
    }
}

/// The next step of a replay.
enum Next {
    /// A batch of records.
    Batch(Box<RecordedBatch>),
    /// The end of the recording.
    End,
    /// The replay was stopped.
    Stopped,
}

/// Returns the next record when it is due: after the time from the first record to it, divided by `times`.
async fn paced(
    records: &mut RecordStream,
    times: f64,
    began: tokio::time::Instant,
    first_start: &mut Option<Timestamp>,
) -> ReadBatch {
    let batch = records.next().await;
    if let Some((_, Ok(recorded))) = batch.records.first() {
        let start = recorded.record.start_time();
        let first = *first_start.get_or_insert(start);
        let seconds = (start.as_nanosecond() - first.as_nanosecond()) as f64 / 1e9 / times;
        // Longer than a duration can be at a very low pace.
        let due = Duration::try_from_secs_f64(seconds.max(0.0)).unwrap_or(Duration::MAX);
        tokio::time::sleep(due.saturating_sub(began.elapsed())).await;
    }
    batch
}

/// Updates a replay from the summary of its records; `elapsed` is the time that the records beyond the first
/// `seconds_before` seconds took.
fn update(replay: &mut Replay, summary: &BatchSummary, seconds_before: f64, elapsed: Duration) {
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
        replay.error =
            summary.refused.first().map(|refused| format!("record {}: {}", refused.record, refused.reason));
    }
}

/// The summary of a replay so far, from which it resumes.
fn so_far(replay: &Replay) -> BatchSummary {
    BatchSummary {
        records: replay.records_done,
        stored: replay.stored,
        repeated: replay.repeated,
        refused_count: replay.refused,
        first_start_time: replay.first_start_time,
        last_start_time: replay.last_start_time,
        record_seconds: replay.record_seconds_done,
        ..BatchSummary::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::{BlockEncoding, Recorded};
    use crate::signal::Record;

    fn recorded(second: i64) -> Recorded {
        let start = Timestamp::from_second(second).unwrap();
        Recorded {
            record: Record::new("1", start, 1000.0, "g", vec![0.5; 8]).unwrap(),
            raw: Vec::new(),
            encoding: BlockEncoding::Protobuf,
            reference_wear_um: None,
        }
    }

    #[tokio::test]
    async fn a_record_that_is_due_after_all_time_is_waited_for() {
        for times in [1e-18, 1e-300] {
            let records = [0, 10].map(|second| Ok(recorded(second)));
            let mut records = RecordStream::spawn(1 << 20, move || Ok(records.into_iter()));
            let (began, mut first) = (tokio::time::Instant::now(), None);
            assert_eq!(paced(&mut records, times, began, &mut first).await.records.len(), 1);
            let second = paced(&mut records, times, began, &mut first);
            assert!(tokio::time::timeout(Duration::from_millis(50), second).await.is_err(), "{times}");
        }
    }
}
