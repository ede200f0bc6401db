//! The demonstration's live stream: repeats the latest record in real time.

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use tokio::sync::watch;
use tokio::time::{Instant, MissedTickBehavior, interval};

use crate::asset::AssetId;
use crate::recording::RawSample;
use crate::recording::stream::StreamFormat;
use crate::service::{Service, ServiceError};
use crate::signal::Record;

/// The stream's name.
const NAME: &str = "sensor";

/// Time between two chunks.
const CHUNK_INTERVAL: Duration = Duration::from_millis(100);

/// Maximum samples in a chunk, for example after the machine was suspended.
const MAX_CHUNK_SAMPLES: u64 = 1 << 16;

/// Seconds of cross-fade from one record into the next.
const CROSSFADE_S: f64 = 0.02;

/// Sends the stream until the service stops or another sender takes it over.
pub(super) async fn send(
    service: Arc<Service>,
    asset: AssetId,
    mut latest: watch::Receiver<Option<Arc<Record>>>,
) -> Result<(), ServiceError> {
    let Ok(Some(first)) = latest.wait_for(Option::is_some).await.map(|record| record.clone()) else {
        return Ok(());
    };
    let rate_hz = first.sample_rate_hz();
    let mut format = StreamFormat::new(RawSample::F32, rate_hz, 1, None)?;
    format.unit = Some(first.unit().to_owned());
    format.channel_names = vec![first.channel().to_owned()];
    let mut sender = service.streams.open(&asset, NAME, format, None).await?;
    let mut next = sender.next().unwrap_or(0);
    let mut playback = Playback::new(first);
    let (mut due, began, mut sent) = (interval(CHUNK_INTERVAL), Instant::now(), 0);
    due.set_missed_tick_behavior(MissedTickBehavior::Skip);
    loop {
        let now = tokio::select! {
            now = due.tick() => now,
            () = sender.taken_over() => return Ok(()),
        };
        let all = (now.duration_since(began).as_secs_f64() * rate_hz) as u64;
        let count = all.saturating_sub(sent).min(MAX_CHUNK_SAMPLES);
        sent = all;
        let upcoming = latest.borrow().clone();
        let samples = (0..count).map(|_| playback.next(upcoming.as_ref()));
        let bytes: Bytes = samples.flat_map(f32::to_le_bytes).collect::<Vec<u8>>().into();
        if !bytes.is_empty() {
            let chunk = sender.received_now(next, bytes);
            sender.take(vec![chunk]).await?;
            next += count;
        }
    }
}

/// Plays records one after the other with a cross-fade between them.
struct Playback {
    current: Arc<Record>,
    /// Index of the next sample of the current record.
    position: usize,
    /// The record that the current one fades into, during the cross-fade.
    upcoming: Option<Arc<Record>>,
    /// Length of the cross-fade in samples.
    crossfade: usize,
}

impl Playback {
    fn new(first: Arc<Record>) -> Self {
        let crossfade = (CROSSFADE_S * first.sample_rate_hz()) as usize;
        let crossfade = crossfade.clamp(1, (first.samples().len() / 2).max(1));
        Self { current: first, position: 0, upcoming: None, crossfade }
    }

    /// Returns the next sample; at its end the current record fades into `latest`.
    fn next(&mut self, latest: Option<&Arc<Record>>) -> f32 {
        let samples = self.current.samples();
        let remaining = samples.len().saturating_sub(self.position);
        let sample = samples.get(self.position).copied().unwrap_or_default();
        self.position += 1;
        if remaining > self.crossfade {
            return sample;
        }
        let upcoming = self.upcoming.get_or_insert_with(|| Arc::clone(latest.unwrap_or(&self.current)));
        let faded = self.crossfade - remaining;
        // The records are not in phase, so their powers add: an equal-power cross-fade.
        let phase = std::f32::consts::FRAC_PI_2 * (faded + 1) as f32 / self.crossfade as f32;
        let blended =
            sample * phase.cos() + upcoming.samples()[faded.min(upcoming.samples().len() - 1)] * phase.sin();
        if remaining <= 1 {
            (self.current, self.position) = (Arc::clone(upcoming), self.crossfade);
            self.upcoming = None;
        }
        blended
    }
}

#[cfg(test)]
mod tests {
    use jiff::Timestamp;

    use super::*;

    fn record(level: f32) -> Arc<Record> {
        Arc::new(Record::new("x", Timestamp::UNIX_EPOCH, 1000.0, "m/s2", vec![level; 100]).unwrap())
    }

    #[test]
    fn a_record_fades_into_the_latest_one() {
        let [one, two] = [record(1.0), record(2.0)];
        let mut playback = Playback::new(one);
        let played: Vec<f32> = (0..400).map(|_| playback.next(Some(&two))).collect();
        assert_eq!(played[..80], [1.0; 80]);
        assert!(played[80..100].iter().all(|x| (0.9..=2.3).contains(x)), "{:?}", &played[80..100]);
        assert_eq!(played[100..160], [2.0; 60]);
    }
}
