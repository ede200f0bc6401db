//! The live stream of a schedule.

use bytes::{Bytes, BytesMut};
use flankwatch::asset::AssetId;
use flankwatch::recording::RawSample;
use flankwatch::recording::stream::{Chunk, StreamFormat};
use flankwatch::service::{ServiceError, StreamSender};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use super::life::Life;
use crate::running::plain_asset;

pub(super) const ASSET: &str = "mill";
const NAME: &str = "main";

/// Samples of each record that is cut.
const RECORD_SAMPLES: u64 = 2000;

/// Records that may wait to be stored before a sender has to wait.
const MAX_WAITING: u64 = 3;

/// The description of the asset, whose stream is cut into records without gaps.
pub(super) fn asset() -> Value {
    let mut asset = plain_asset(ASSET);
    asset["stream"] = json!({ "record_s": 0.5, "interval_s": 0.5 });
    asset
}

/// What is known about the stream.
#[derive(Default)]
pub(super) struct KnownStream {
    /// Whether a sample was acknowledged.
    exists: bool,
    /// All samples before this index were acknowledged.
    next: u64,
    /// No sample from this index on was sent.
    sent: u64,
    /// The connection of the running process.
    sender: Option<StreamSender>,
}

impl KnownStream {
    /// Sends some samples, as far as the disk allows.
    pub(super) fn send(&mut self, life: &Life, random: &mut ChaCha8Rng) {
        if self.sender.is_none() {
            self.open(life);
        }
        let Some(sender) = &mut self.sender else { return };
        let id = id();
        let status = life.service().streams.status(&id, NAME);
        let waiting = life.block_on(life.disk.unless_stopped(status)).transpose();
        let may_send = match waiting {
            Ok(Some(status)) => status.records_waiting < MAX_WAITING,
            // It is created with its first sample.
            Err(ServiceError::StreamUnknown { .. }) => true,
            _ => false,
        };
        if !may_send {
            return;
        }
        let count = random.random_range(1..3 * RECORD_SAMPLES / 2);
        let chunk = Chunk {
            first: self.next,
            time_ns: Some(1_767_225_600_000_000_000 + (self.next * 250_000) as i64),
            bytes: samples(self.next, count),
        };
        self.sent = self.sent.max(self.next + count);
        let taken = life.block_on(life.disk.unless_stopped(sender.take(vec![chunk])));
        match taken {
            // A response after the disk has stopped does not count.
            _ if life.disk.is_stopped() => {}
            Some(Ok(progress)) => {
                assert_eq!(progress.next, Some(self.next + count));
                (self.exists, self.next) = (true, self.next + count);
            }
            // The next step opens it again.
            Some(Err(_)) | None => self.sender = None,
        }
    }

    /// Opens the stream, and learns what it has.
    fn open(&mut self, life: &Life) {
        let opened = life.block_on(life.disk.unless_stopped(open(life)));
        if let Some(Ok(sender)) = opened
            && !life.disk.is_stopped()
        {
            self.take_next(sender.next());
            self.sender = Some(sender);
        }
    }

    fn take_next(&mut self, next: Option<u64>) {
        let next = next.unwrap_or(0);
        assert!((self.next..=self.sent).contains(&next), "{next}, not {} to {}", self.next, self.sent);
        (self.exists, self.next) = (self.exists || next > 0, next);
    }

    /// The connection ends with the process.
    pub(super) fn end_of_life(&mut self) {
        self.sender = None;
    }

    /// Compares the stream and its records with what was acknowledged.
    pub(super) fn check(&mut self, life: &Life) {
        let streams = &life.service().streams;
        let found = life.block_on(streams.list(&id())).unwrap();
        if self.exists {
            assert_eq!(found.len(), 1, "the stream was acknowledged");
        }
        if found.is_empty() {
            return;
        }
        let status = life.wait_for("records of the stream", async || {
            Some(streams.status(&id(), NAME).await.unwrap()).filter(|status| status.records_waiting == 0)
        });
        self.take_next(status.next);
        assert_eq!((status.gaps, status.records_refused), (0, 0));
        let stored = life.stored(ASSET);
        assert_eq!(stored.len() as u64, self.next / RECORD_SAMPLES, "{} samples", self.next);
        for (segment, n) in stored.iter().zip(0..) {
            let raw = life.service().store.objects().get(&segment.raw.sha256).unwrap();
            assert!(
                raw == samples(n * RECORD_SAMPLES, RECORD_SAMPLES),
                "the bits of record {n} of the stream"
            );
        }
    }
}

fn id() -> AssetId {
    AssetId::new(ASSET).unwrap()
}

async fn open(life: &Life) -> Result<StreamSender, ServiceError> {
    let format = StreamFormat::new(RawSample::F32, 4000.0, 1, None).unwrap();
    life.service().streams.open(&id(), NAME, format, Some(0)).await
}

/// Samples from an index on.
fn samples(first: u64, count: u64) -> Bytes {
    let mut bytes = BytesMut::new();
    for k in first..first + count {
        let value = (k.wrapping_mul(2_654_435_761) % 65_521) as f32 / 1000.0 - 32.0;
        bytes.extend_from_slice(&value.to_le_bytes());
    }
    bytes.freeze()
}
