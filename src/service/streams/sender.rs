//! The sender's side of a stream: one connection that sends samples.

use std::sync::Arc;

use jiff::Timestamp;
use tokio::sync::watch;

use super::cutting::Cutting;
use super::live::LiveStream;
use super::new_stream::NewStream;
use super::stored::{StoredStream, StreamProgress};
use super::tachometer::Pulses;
use super::{MAX_PENDING, Streams};
use crate::recording::RecordingError;
use crate::recording::stream::{Chunk, StreamFormat};
use crate::service::error::ServiceError;
use crate::service::record::check_time;
use crate::service::workers::blocking;
use crate::signal::OperatingPoint;

/// Time in nanoseconds by which a chunk that repeats stored samples may be newer than all of them.
const REPEAT_TOLERANCE_NS: i64 = 1_000_000_000;

/// A stream opened for sending by one connection.
pub struct StreamSender {
    pub(super) streams: Arc<Streams>,
    pub(super) stream: Arc<LiveStream>,
    pub(super) owner: u64,
    pub(super) cutting: Arc<Cutting>,
    pub(super) format: StreamFormat,
    pub(super) next: Option<u64>,
    /// How the stream begins, until it is created with its first sample.
    pub(super) new_stream: Option<NewStream>,
    /// Whether the time of the stream's samples is known.
    pub(super) is_timed: bool,
    /// The latest time after a stored sample, by the sender's clock.
    pub(super) newest_ns: Option<i64>,
    pub(super) pending: watch::Receiver<usize>,
}

impl StreamSender {
    /// Index of the next expected sample; `None` if the stream starts with any sample.
    pub fn next(&self) -> Option<u64> {
        self.next
    }

    /// The format of its samples.
    pub fn format(&self) -> &StreamFormat {
        &self.format
    }

    /// Creates a chunk of samples received now, assuming that the last one was measured just now.
    pub fn received_now(&self, first: u64, bytes: bytes::Bytes) -> Chunk {
        let frames = (bytes.len() / self.format.frame_bytes()) as f64;
        let length_ns = (frames / self.format.sample_rate_hz() * 1e9) as i128;
        let time_ns = self.streams.clock.now().as_nanosecond() - length_ns;
        Chunk { first, time_ns: i64::try_from(time_ns).ok(), bytes }
    }

    /// Checks that a chunk whose samples are all stored is a repeated one: its time, by the sender's clock,
    /// is not after that of all stored samples.
    ///
    /// # Errors
    /// [`ServiceError::StreamRestarted`].
    pub fn check_repeat(&self, chunk: &Chunk) -> Result<(), ServiceError> {
        let frames = (chunk.bytes.len() / self.format.frame_bytes()) as u64;
        let stored_to = self.next.filter(|next| frames > 0 && chunk.first.saturating_add(frames) <= *next);
        let is_newer = self
            .newest_ns
            .zip(chunk.time_ns)
            .is_some_and(|(newest_ns, time_ns)| time_ns.saturating_sub(newest_ns) > REPEAT_TOLERANCE_NS);
        let Some(next) = stored_to.filter(|_| is_newer) else { return Ok(()) };
        let expected = format!(
            "at least {next}, as its time is after that of all stored samples: a sender whose count restarts \
             needs another stream, or counts from its clock (seconds since 1970 × sampling rate)"
        );
        Err(ServiceError::StreamRestarted { first: chunk.first, expected })
    }

    /// Stores chunks; returns once they are durable. Waits while too many records of the stream wait for the
    /// pipeline, which slows down the sender.
    ///
    /// # Errors
    /// [`ServiceError::StreamTaken`]; an invalid chunk, in which case the chunks before it are stored; the
    /// first time of the stream is too far ahead of the clock.
    pub async fn take(&mut self, mut chunks: Vec<Chunk>) -> Result<StreamProgress, ServiceError> {
        if let Some(new_stream) = &self.new_stream {
            chunks.retain(|chunk| !chunk.bytes.is_empty());
            let Some(first) = chunks.first() else {
                return Ok(StreamProgress { next: self.next, gaps: Vec::new() });
            };
            new_stream.assembler().push(first.clone())?;
        }
        self.check_start(&chunks)?;
        let (mut owner, mut over) = (self.stream.watch_owner(), self.streams.watch_end());
        let mine = self.owner;
        tokio::select! {
            // It also ends with the service.
            _ = self.pending.wait_for(|pending| *pending < MAX_PENDING) => {}
            _ = owner.wait_for(|owner| *owner != mine) => {}
            _ = over.wait_for(|over| *over) => {}
        }
        let cutting = Arc::clone(&self.cutting);
        self.write(move |stored| stored.take(chunks, &cutting)).await
    }

    /// Declares that no more samples before an index will arrive.
    ///
    /// # Errors
    /// Those of [`take`](Self::take).
    pub async fn declare_lost_before(&mut self, index: u64) -> Result<StreamProgress, ServiceError> {
        if let Some(new_stream) = &self.new_stream {
            new_stream.assembler().declare_lost_before(index)?;
        }
        let cutting = Arc::clone(&self.cutting);
        self.write(move |stored| stored.declare_lost_before(index, &cutting)).await
    }

    /// Sets the operating point of the machine from now on; a speed of 0 is a standstill.
    ///
    /// # Errors
    /// A value that no record can have; those of [`take`](Self::take).
    pub async fn set_operating_point(&mut self, point: OperatingPoint) -> Result<(), ServiceError> {
        let turning_hz = point.shaft_speed_hz.filter(|speed_hz| *speed_hz != 0.0);
        let turning = OperatingPoint { shaft_speed_hz: turning_hz, ..point };
        turning.check().map_err(RecordingError::from)?;
        let cutting = Arc::clone(&self.cutting);
        self.write(move |stored| stored.set_operating_point(point, &cutting)).await
    }

    /// Stores tachometer pulses among future samples; pulses among samples already received are dropped.
    ///
    /// # Errors
    /// Those of [`take`](Self::take).
    pub(crate) async fn take_pulses(&mut self, pulses: Pulses) -> Result<(), ServiceError> {
        self.write(move |stored| stored.take_pulses(pulses)).await
    }

    /// Waits until another connection takes over the stream, or its asset is deleted.
    pub async fn taken_over(&self) {
        let mine = self.owner;
        let _ = self.stream.watch_owner().wait_for(|owner| *owner != mine).await;
    }

    /// Updates the cutting of records to the asset's current description, and the stream to what other
    /// processes did with it.
    ///
    /// # Errors
    /// The asset is deleted; [`ServiceError::StreamTaken`].
    pub async fn refresh(&mut self) -> Result<(), ServiceError> {
        let described = self.streams.store.asset(&self.stream.asset).await?;
        if let Ok(cutting) = Cutting::of(&described.spec, &self.format) {
            self.cutting = Arc::new(cutting);
        }
        if self.stream.location.is_shared() && self.new_stream.is_none() {
            let stream = Arc::clone(&self.stream);
            match blocking("access a stream", move || stream.with_stored(|_| Ok(()))).await? {
                // Another process has removed it.
                Err(ServiceError::StreamUnknown { .. }) => return Err(ServiceError::StreamTaken),
                read => read?,
            }
            if !self.stream.is_owner(self.owner) {
                return Err(ServiceError::StreamTaken);
            }
        }
        Ok(())
    }

    /// Checks the time that starts the stream: with one far ahead, all its records would be refused.
    fn check_start(&self, chunks: &[Chunk]) -> Result<(), ServiceError> {
        let timed = chunks.iter().filter(|_| !self.is_timed).filter(|chunk| chunk.time_ns.is_some());
        let time_ns = timed.min_by_key(|chunk| chunk.first).and_then(|chunk| chunk.time_ns);
        let start_time = time_ns.and_then(|time_ns| Timestamp::from_nanosecond(time_ns.into()).ok());
        let latest = self.streams.pipeline.latest(self.streams.clock.now());
        start_time.map_or(Ok(()), |start_time| check_time(start_time, latest))
    }

    async fn write<T: Send + 'static>(
        &mut self,
        work: impl FnOnce(&mut StoredStream) -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let (stream, owner, new_stream) = (Arc::clone(&self.stream), self.owner, self.new_stream.clone());
        let write = move || {
            stream.with_sent(owner, new_stream, |stored| {
                let done = work(stored)?;
                Ok((done, stored.state().next, stored.is_timed(), stored.state().newest_ns))
            })
        };
        let (done, next, is_timed, newest_ns) = blocking("write a stream", write).await??;
        (self.next, self.is_timed, self.newest_ns, self.new_stream) = (next, is_timed, newest_ns, None);
        self.streams.cut_in_background(&self.stream);
        Ok(done)
    }
}
