//! The sample gearbox as its sensor hears it now: the latest record over and over, in real time.

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

/// How often samples are sent.
const EVERY: Duration = Duration::from_millis(100);

/// Most samples sent at once, after the machine was suspended for example.
const MAX_AT_ONCE: u64 = 1 << 16;

/// Seconds over which one record passes into the next.
const BLEND_S: f64 = 0.02;

/// Sends the stream until the service ends or somebody else sends it.
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
    let (mut due, began, mut sent) = (interval(EVERY), Instant::now(), 0);
    due.set_missed_tick_behavior(MissedTickBehavior::Skip);
    loop {
        let now = tokio::select! {
            now = due.tick() => now,
            () = sender.taken_over() => return Ok(()),
        };
        let all = (now.duration_since(began).as_secs_f64() * rate_hz) as u64;
        let count = all.saturating_sub(sent).min(MAX_AT_ONCE);
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

/// Plays records one after the other, each blended into the next.
struct Playback {
    current: Arc<Record>,
    at: usize,
    /// The record that the current one passes into, while it does.
    upcoming: Option<Arc<Record>>,
    blend: usize,
}

impl Playback {
    fn new(first: Arc<Record>) -> Self {
        let blend = (BLEND_S * first.sample_rate_hz()) as usize;
        let blend = blend.clamp(1, (first.samples().len() / 2).max(1));
        Self { current: first, at: 0, upcoming: None, blend }
    }

    /// The next sample; a record that ends passes into `latest`.
    fn next(&mut self, latest: Option<&Arc<Record>>) -> f32 {
        let samples = self.current.samples();
        let left = samples.len().saturating_sub(self.at);
        let sample = samples.get(self.at).copied().unwrap_or_default();
        self.at += 1;
        if left > self.blend {
            return sample;
        }
        let upcoming = self.upcoming.get_or_insert_with(|| Arc::clone(latest.unwrap_or(&self.current)));
        let begun = self.blend - left;
        // Two records are not in phase: their powers add.
        let part = std::f32::consts::FRAC_PI_2 * (begun + 1) as f32 / self.blend as f32;
        let blended =
            sample * part.cos() + upcoming.samples()[begun.min(upcoming.samples().len() - 1)] * part.sin();
        if left <= 1 {
            (self.current, self.at) = (Arc::clone(upcoming), self.blend);
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
    fn records_pass_into_the_latest_one() {
        let [one, two] = [record(1.0), record(2.0)];
        let mut playback = Playback::new(one);
        let played: Vec<f32> = (0..400).map(|_| playback.next(Some(&two))).collect();
        assert_eq!(played[..80], [1.0; 80]);
        assert!(played[80..100].iter().all(|x| (0.9..=2.3).contains(x)), "{:?}", &played[80..100]);
        assert_eq!(played[100..160], [2.0; 60]);
    }
}
