//! Blocks of streams: each measuring point is a stream of its own, whose blocks are stored in order.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::{mpsc, watch};
use tokio::task::JoinSet;

use super::delivery::{Attempts, DeliveryOutcome};
use super::incoming::Incoming;
use super::message::Message;
use super::rejection::{FailureAction, Rejection};
use super::topic::Address;
use crate::recording::RawSample;
use crate::recording::stream::{Chunk, StreamFormat};
use crate::service::{Client, ClientPermit, Pulses, Service, ServiceError, StreamSender};
use crate::signal::{OperatingPoint, Record};

/// Time after which the samples that a waiting block lacks count as lost: a broker delivers in order.
const GAP_TIMEOUT: Duration = Duration::from_secs(2);

/// Time without blocks after which a stream's task ends; the next block starts another one.
const IDLE_TIMEOUT: Duration = Duration::from_secs(60);

/// Interval at which the asset's description is read again.
const REFRESH_INTERVAL: Duration = Duration::from_secs(2);

/// The streams of one connection to the broker.
#[derive(Default)]
pub(super) struct StreamBlocks {
    queues: HashMap<Address, mpsc::UnboundedSender<(Message, Incoming)>>,
}

impl StreamBlocks {
    /// Passes a block to the task of its stream, which is started if there is none. The slots of the
    /// connection limit the number of queued blocks.
    pub(super) fn pass(
        &mut self,
        message: Message,
        incoming: Incoming,
        stop: watch::Receiver<bool>,
        tasks: &mut JoinSet<()>,
    ) {
        let address = message.address.clone();
        let mut block = (message, incoming);
        if let Some(queue) = self.queues.get(&address) {
            match queue.send(block) {
                Ok(()) => return,
                // Its task has ended.
                Err(mpsc::error::SendError(returned)) => block = returned,
            }
        }
        self.queues.retain(|_, queue| !queue.is_closed());
        let (queue, blocks) = mpsc::unbounded_channel();
        // The receiver exists.
        let _ = queue.send(block);
        self.queues.insert(address.clone(), queue);
        tasks.spawn(PointStream::new(address, stop).run(blocks));
    }
}

/// A decoded block that is not acknowledged yet.
struct Block {
    first: u64,
    record: Record,
    incoming: Incoming,
}

impl Block {
    fn end(&self) -> u64 {
        self.first.saturating_add(self.record.samples().len() as u64)
    }

    fn chunk(&self) -> Chunk {
        Chunk {
            first: self.first,
            time_ns: i64::try_from(self.record.start_time().as_nanosecond()).ok(),
            bytes: self.record.samples().iter().flat_map(|sample| sample.to_le_bytes()).collect(),
        }
    }

    fn format(&self) -> Result<StreamFormat, ServiceError> {
        let unit = Some(self.record.unit()).filter(|unit| *unit != "1").map(str::to_owned);
        let names = vec![self.record.channel().to_owned()];
        Ok(StreamFormat::new(RawSample::F32, self.record.sample_rate_hz(), 1, None)?
            .with_names(unit, names)?)
    }

    /// Returns the tachometer pulses within the block.
    fn pulses(&self) -> Result<Option<Pulses>, ServiceError> {
        let Some(tachometer) = self.record.tachometer() else { return Ok(None) };
        let samples = tachometer.pulse_times_s.iter().map(|time_s| time_s * self.record.sample_rate_hz());
        // The next block has those after this one, at places that differ by the jitter of the start times.
        let length = self.record.samples().len() as f64;
        let within: Vec<f64> = samples.filter(|after| (0.0..length).contains(after)).collect();
        Pulses::new(self.first, &within, tachometer.pulses_per_revolution).map(Some)
    }
}

/// The stream of one measuring point.
struct PointStream {
    address: Address,
    stop: watch::Receiver<bool>,
    sender: Option<StreamSender>,
    /// Its place among the streams sent at the same time, until it is idle.
    permit: Option<ClientPermit>,
    refreshed_at: Instant,
    /// The operating point of the last block; `None` if the stream was opened since.
    operating_point: Option<OperatingPoint>,
    /// Blocks that came before their predecessors, and are acknowledged once they are durable.
    waiting: Vec<Block>,
}

impl PointStream {
    fn new(address: Address, stop: watch::Receiver<bool>) -> Self {
        Self {
            address,
            stop,
            sender: None,
            permit: None,
            refreshed_at: Instant::now(),
            operating_point: None,
            waiting: Vec::new(),
        }
    }

    async fn run(mut self, mut blocks: mpsc::UnboundedReceiver<(Message, Incoming)>) {
        let mut stop = self.stop.clone();
        loop {
            let timeout = if self.waiting.is_empty() { IDLE_TIMEOUT } else { GAP_TIMEOUT };
            let received = tokio::select! {
                received = tokio::time::timeout(timeout, blocks.recv()) => received,
                _ = stop.wait_for(|stop| *stop) => return,
            };
            match received {
                Ok(Some((message, incoming))) => self.receive(message, incoming).await,
                Ok(None) => return,
                // Blocks that are queued already are still received.
                Err(_) if self.waiting.is_empty() => blocks.close(),
                Err(_) => self.declare_gap().await,
            }
        }
    }

    async fn receive(&mut self, message: Message, incoming: Incoming) {
        let decoded = tokio::task::spawn_blocking(move || message.block()).await;
        let block = match decoded {
            Ok(Ok((first, record))) => Block { first, record, incoming },
            Ok(Err(rejection)) => return incoming.finish(DeliveryOutcome::Rejected(rejection)).await,
            Err(_) => {
                let rejection = Rejection::new(500, "the block could not be decoded");
                return incoming.finish(DeliveryOutcome::Rejected(rejection)).await;
            }
        };
        match self.deliver(&block).await {
            DeliveryOutcome::Stored => {
                self.waiting.push(block);
                self.acknowledge_stored().await;
            }
            outcome => block.incoming.finish(outcome).await,
        }
    }

    /// Stores a block; retries until it succeeds, is rejected, or the service stops.
    async fn deliver(&mut self, block: &Block) -> DeliveryOutcome {
        let (feed, address) = (Arc::clone(&block.incoming.feed), self.address.clone());
        let mut attempts = Attempts::new(&feed, &address, self.stop.clone());
        loop {
            let Err(failure) = self.store(block).await else { return DeliveryOutcome::Stored };
            if let Some(outcome) = attempts.failed(failure).await {
                return outcome;
            }
        }
    }

    /// Stores a block. If it is early, it waits for its predecessors.
    async fn store(&mut self, block: &Block) -> Result<(), FailureAction> {
        let format = block.format()?;
        if self.sender.as_ref().is_none_or(|sender| *sender.format() != format) {
            self.open(&block.incoming.service, format).await?;
        }
        let stored = self.store_in_order(block).await;
        if stored.is_err() {
            // Another sender may have the stream, or its asset may be another one.
            self.sender = None;
        }
        stored
    }

    async fn store_in_order(&mut self, block: &Block) -> Result<(), FailureAction> {
        let Some(sender) = &mut self.sender else {
            return Err(FailureAction::Retry("the stream is not open".to_owned()));
        };
        if self.refreshed_at.elapsed() > REFRESH_INTERVAL {
            sender.refresh().await?;
            self.refreshed_at = Instant::now();
        }
        let chunk = block.chunk();
        sender.check_repeat(&chunk)?;
        if sender.next().is_some_and(|next| block.end() <= next) {
            return Ok(());
        }
        let point = block.record.operating_point();
        if self.operating_point != Some(point) {
            sender.set_operating_point(point).await?;
            self.operating_point = Some(point);
        }
        if let Some(pulses) = block.pulses()? {
            sender.take_pulses(pulses).await?;
        }
        sender.take(vec![chunk]).await?;
        Ok(())
    }

    /// Opens the stream, for which there must be a place.
    async fn open(&mut self, service: &Service, format: StreamFormat) -> Result<(), FailureAction> {
        let is_new = self.permit.is_none();
        if is_new {
            // Holding the block would not help: it would take the slots of points that have a place.
            self.permit =
                Some(service.stream_limiter.try_acquire(Client::Feed("mqtt")).ok_or_else(too_many)?);
        }
        let opened = self.open_stream(service, format).await;
        if opened.is_err() && is_new {
            self.permit = None;
        }
        opened.map_err(|error| match error {
            // The name of the stream is a level of the topic.
            ServiceError::Field { field: "name", value, expected } => FailureAction::Reject(
                Rejection::field(422, "topic", &value, &format!("a point of {expected}")),
            ),
            error => error.into(),
        })
    }

    /// Opens the stream, and passes the waiting blocks to it again.
    async fn open_stream(&mut self, service: &Service, format: StreamFormat) -> Result<(), ServiceError> {
        let Address { asset, point } = &self.address;
        self.sender = None;
        let mut sender = service.streams.open(asset, point, format, None).await?;
        sender.take(self.waiting.iter().map(Block::chunk).collect()).await?;
        self.refreshed_at = Instant::now();
        self.operating_point = None;
        self.sender = Some(sender);
        Ok(())
    }

    /// Acknowledges the blocks that are durable.
    async fn acknowledge_stored(&mut self) {
        let next = self.sender.as_ref().and_then(StreamSender::next).unwrap_or(0);
        for block in self.waiting.extract_if(.., |block| block.end() <= next) {
            block.incoming.finish(DeliveryOutcome::Stored).await;
        }
    }

    /// Stops waiting for the samples before the first waiting block: they become a gap.
    async fn declare_gap(&mut self) {
        match self.skip_to_waiting().await {
            Ok(()) => self.acknowledge_stored().await,
            Err(FailureAction::Reject(rejection)) => {
                for block in self.waiting.drain(..) {
                    block.incoming.finish(DeliveryOutcome::Rejected(rejection.clone())).await;
                }
            }
            Err(FailureAction::Retry(reason)) => self.skip_failed(&reason),
            Err(FailureAction::RetryThenReject(rejection)) => self.skip_failed(rejection.detail()),
        }
    }

    async fn skip_to_waiting(&mut self) -> Result<(), FailureAction> {
        let Some(block) = self.waiting.iter().min_by_key(|block| block.first) else { return Ok(()) };
        let (first, service, format) = (block.first, Arc::clone(&block.incoming.service), block.format()?);
        if self.sender.is_none() {
            self.open(&service, format).await?;
        }
        if let Some(sender) = &mut self.sender {
            sender.declare_lost_before(first).await?;
        }
        Ok(())
    }

    /// The next attempt opens the stream again.
    fn skip_failed(&mut self, reason: &str) {
        tracing::warn!(reason, asset = %self.address.asset, "failed to skip the lost samples of a stream");
        self.sender = None;
    }
}

fn too_many() -> FailureAction {
    let detail = "too many live streams at the same time: a broker may have three quarters of limits.streams";
    FailureAction::Reject(Rejection::new(503, detail))
}
