//! The worker threads for computations, separate from the threads that serve connections.

use std::cell::RefCell;
use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

use super::error::ServiceError;
use super::limits::WorkLimits;
use crate::signal::{AnalysisSettings, Analyzer, MAX_RECORD_SAMPLES};

/// Samples beyond which a record counts as large. Its analysis takes about 85 bytes a sample, 1.4 GB for the
/// largest record.
const LARGE_SAMPLES: usize = 1 << 22;

thread_local! {
    /// FFT plans and scratch memory of this thread.
    static ANALYZER: RefCell<Analyzer> = RefCell::new(Analyzer::new(AnalysisSettings::default()));
}

/// Calls `f` with the calling thread's analyzer for a record of `samples` samples; for a large record with a
/// new analyzer, whose memory is released afterwards.
pub(crate) fn with_analyzer<T>(samples: usize, f: impl FnOnce(&mut Analyzer) -> T) -> T {
    if is_large(samples) {
        return f(&mut Analyzer::new(AnalysisSettings::default()));
    }
    ANALYZER.with_borrow_mut(f)
}

/// Whether a record of this many samples counts as large.
pub(crate) fn is_large(samples: usize) -> bool {
    samples > LARGE_SAMPLES
}

/// A fixed number of worker threads, and the limits on waiting work.
#[derive(Debug)]
pub struct Workers {
    pool: rayon::ThreadPool,
    /// For short tasks that others wait for, so that they do not queue behind records.
    first: rayon::ThreadPool,
    /// A single thread that reads records of streams: each thread that allocates such records keeps some of
    /// their memory (glibc's arenas), and there are many threads for blocking work.
    reader: rayon::ThreadPool,
    requests: Arc<Semaphore>,
    responses: Arc<Semaphore>,
    recordings: Arc<Semaphore>,
    kibibytes: Arc<Semaphore>,
    /// Kibibytes of stored records that may be in memory at the same time.
    stored_kibibytes: Arc<Semaphore>,
    /// Samples of large records that may be analysed at the same time.
    large: Arc<Semaphore>,
    limits: WorkLimits,
}

/// A permit to hold a request's bytes and have them processed; released when dropped.
#[derive(Debug)]
pub struct Ticket {
    _request: OwnedSemaphorePermit,
    kibibytes: Arc<Semaphore>,
    held: Option<OwnedSemaphorePermit>,
    bytes: usize,
}

impl Workers {
    pub(crate) fn new(limits: &WorkLimits) -> Result<Self, ServiceError> {
        Ok(Self {
            pool: threads(limits.workers, "worker")?,
            first: threads(limits.workers, "first")?,
            reader: threads(1, "reader")?,
            requests: Arc::new(Semaphore::new(limits.requests_at_once)),
            responses: Arc::new(Semaphore::new(limits.requests_at_once)),
            recordings: Arc::new(Semaphore::new(limits.recordings_at_once)),
            kibibytes: Arc::new(Semaphore::new(limits.bytes_at_once / 1024)),
            stored_kibibytes: Arc::new(Semaphore::new(stored_kibibytes(limits) as usize)),
            large: Arc::new(Semaphore::new(MAX_RECORD_SAMPLES)),
            limits: limits.clone(),
        })
    }

    /// Admits one more request, or returns [`ServiceError::Busy`] at once.
    pub fn admit(&self) -> Result<Ticket, ServiceError> {
        self.admit_to(&self.requests, "the queue of records is full")
    }

    /// Waits until one more request that holds `bytes` can be admitted, for work that no client waits for.
    /// More bytes than all requests may hold count as that many.
    pub(crate) async fn wait_to_admit(&self, bytes: u64) -> Result<Ticket, ServiceError> {
        let lost = |_| ServiceError::WorkerLost("admit a record");
        let request = Arc::clone(&self.requests).acquire_owned().await.map_err(lost)?;
        let max = self.limits.bytes_at_once as u64 / 1024;
        let needed = u32::try_from(bytes.div_ceil(1024).min(max)).unwrap_or(u32::MAX);
        let held = Arc::clone(&self.kibibytes).acquire_many_owned(needed).await.map_err(lost)?;
        let (kibibytes, bytes) = (Arc::clone(&self.kibibytes), held.num_permits() * 1024);
        Ok(Ticket { _request: request, kibibytes, held: Some(held), bytes })
    }

    /// Admits one more response computed from stored records, or returns [`ServiceError::Busy`] at once. The
    /// limit is separate, so that slow uploads do not block reads.
    pub fn admit_response(&self) -> Result<Ticket, ServiceError> {
        self.admit_to(&self.responses, "too many spectra and recordings are being requested")
    }

    fn admit_to(&self, queue: &Arc<Semaphore>, what: &'static str) -> Result<Ticket, ServiceError> {
        let busy = |_| ServiceError::Busy { what, retry_after_s: 1 };
        let request = Arc::clone(queue).try_acquire_owned().map_err(busy)?;
        Ok(Ticket { _request: request, kibibytes: Arc::clone(&self.kibibytes), held: None, bytes: 0 })
    }

    /// Waits for memory for a stored record of `bytes`. One that needs more than all stored records may have
    /// gets all of it.
    pub(crate) async fn memory_for_stored(&self, bytes: u64) -> Result<OwnedSemaphorePermit, ServiceError> {
        let needed = bytes.div_ceil(1024).min(stored_kibibytes(&self.limits).into()) as u32;
        let memory = Arc::clone(&self.stored_kibibytes).acquire_many_owned(needed).await;
        memory.map_err(|_| ServiceError::WorkerLost("read a record"))
    }

    /// Admits the reading of one more whole recording, or returns [`ServiceError::Busy`] at once.
    pub(crate) fn admit_recording(&self) -> Result<OwnedSemaphorePermit, ServiceError> {
        let permit = Arc::clone(&self.recordings).try_acquire_owned();
        permit
            .map_err(|_| ServiceError::Busy { what: "too many recordings are being read", retry_after_s: 5 })
    }

    /// Waits until another recording may be read.
    pub(crate) async fn wait_for_recording(&self) -> Option<OwnedSemaphorePermit> {
        Arc::clone(&self.recordings).acquire_owned().await.ok()
    }

    /// The number of admitted requests, and its maximum.
    pub fn queue(&self) -> (usize, usize) {
        let max = self.limits.requests_at_once;
        (max - self.requests.available_permits().min(max), max)
    }

    /// The number of worker threads.
    pub(crate) fn threads(&self) -> usize {
        self.limits.workers.max(1)
    }

    /// Runs `f` on a worker thread; `task` names it in the error if it panics.
    pub async fn run<T: Send + 'static>(
        &self,
        task: &'static str,
        f: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, ServiceError> {
        run_in(&self.pool, task, f).await
    }

    /// Memory limit in bytes for the records of one whole recording: its share of the limit for all.
    pub(crate) fn recording_bytes(&self) -> usize {
        self.limits.bytes_at_once / self.limits.recordings_at_once.max(1)
    }

    /// Runs `f`, which analyses a record of `samples` samples, on a worker thread. Large records wait for
    /// each other, so that those analysed at once together have at most as many samples as the largest record
    /// may have. Other records do not wait for them.
    pub(crate) async fn run_analysis<T: Send + 'static>(
        &self,
        task: &'static str,
        samples: usize,
        f: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, ServiceError> {
        if !is_large(samples) {
            return self.run(task, f).await;
        }
        let samples = samples.min(MAX_RECORD_SAMPLES) as u32;
        let permit = Arc::clone(&self.large).acquire_many_owned(samples).await;
        let permit = permit.map_err(|_| ServiceError::WorkerLost(task))?;
        self.run(task, move || {
            // The memory is in use until the end, even if the caller is gone.
            let _permit = permit;
            f()
        })
        .await
    }

    /// Runs `f`, which takes a few milliseconds at most, ahead of everything that waits for a worker thread.
    pub(crate) async fn run_first<T: Send + 'static>(
        &self,
        task: &'static str,
        f: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, ServiceError> {
        run_in(&self.first, task, f).await
    }

    /// Runs `f`, which reads a record of a stream from the disk, after the others that are being read.
    pub(crate) async fn run_reading<T: Send + 'static>(
        &self,
        task: &'static str,
        f: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, ServiceError> {
        run_in(&self.reader, task, f).await
    }
}

/// Runs `work` to completion even if the caller is cancelled: it must not be left half done.
pub(crate) async fn detached<T: Send + 'static>(
    task: &'static str,
    work: impl Future<Output = T> + Send + 'static,
) -> Result<T, ServiceError> {
    tokio::spawn(work).await.map_err(|_| ServiceError::WorkerLost(task))
}

/// Runs `f`, which blocks on the disk or the network, on a blocking thread.
pub(crate) async fn blocking<T: Send + 'static>(
    task: &'static str,
    f: impl FnOnce() -> T + Send + 'static,
) -> Result<T, ServiceError> {
    tokio::task::spawn_blocking(f).await.map_err(|_| ServiceError::WorkerLost(task))
}

/// Creates a pool of threads with this name and a number.
pub(crate) fn threads(count: usize, name: &'static str) -> Result<rayon::ThreadPool, ServiceError> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(count)
        .thread_name(move |n| format!("{name}-{n}"))
        // A panic ends one task, whose caller gets an error, and not the process.
        .panic_handler(|_| tracing::error!("a task panicked on a worker thread"))
        .build()
        .map_err(|source| ServiceError::Threads { name, source })
}

/// The memory for stored records that are read: half of that for records that are received.
fn stored_kibibytes(limits: &WorkLimits) -> u32 {
    u32::try_from(limits.bytes_at_once / 2048).unwrap_or(u32::MAX >> 3).max(1)
}

async fn run_in<T: Send + 'static>(
    pool: &rayon::ThreadPool,
    task: &'static str,
    f: impl FnOnce() -> T + Send + 'static,
) -> Result<T, ServiceError> {
    let (sender, receiver) = oneshot::channel();
    pool.spawn(move || {
        // The caller may be gone; the result is then dropped.
        let _ = sender.send(f());
    });
    receiver.await.map_err(|_| ServiceError::WorkerLost(task))
}

impl Ticket {
    /// Reserves memory for `bytes` more under this ticket, or returns [`ServiceError::Busy`] if all requests
    /// together hold too many.
    pub fn grow(&mut self, bytes: usize) -> Result<(), ServiceError> {
        self.bytes += bytes;
        let held = self.held.as_ref().map_or(0, OwnedSemaphorePermit::num_permits);
        let needed = self.bytes.div_ceil(1024);
        if needed > held {
            let more = u32::try_from(needed - held).unwrap_or(u32::MAX);
            let more = Arc::clone(&self.kibibytes).try_acquire_many_owned(more).map_err(|_| {
                ServiceError::Busy { what: "too many bytes are being received", retry_after_s: 2 }
            })?;
            match &mut self.held {
                Some(held) => held.merge(more),
                None => self.held = Some(more),
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn workers() -> Workers {
        Workers::new(&WorkLimits {
            workers: 1,
            requests_at_once: 2,
            bytes_at_once: 10 * 1024,
            ..WorkLimits::default()
        })
        .unwrap()
    }

    #[test]
    fn a_full_queue_refuses_and_a_dropped_ticket_makes_room() {
        let workers = workers();
        let first = workers.admit().unwrap();
        let _second = workers.admit().unwrap();
        assert_eq!(workers.queue(), (2, 2));
        assert!(matches!(workers.admit(), Err(ServiceError::Busy { .. })));
        drop(first);
        assert!(workers.admit().is_ok());
    }

    #[test]
    fn bytes_of_all_tickets_count_together() {
        let workers = workers();
        let mut first = workers.admit().unwrap();
        let mut second = workers.admit().unwrap();
        for _ in 0..6 {
            first.grow(1024).unwrap();
        }
        second.grow(4 * 1024).unwrap();
        assert!(second.grow(1).is_err());
        drop(first);
        assert!(second.grow(1).is_ok());
    }

    #[tokio::test]
    async fn work_in_the_background_waits_until_it_is_admitted() {
        let workers = workers();
        let mut first = workers.admit().unwrap();
        first.grow(8 * 1024).unwrap();
        let waits =
            tokio::time::timeout(std::time::Duration::from_millis(20), workers.wait_to_admit(4 * 1024));
        assert!(waits.await.is_err());
        let small = workers.wait_to_admit(2 * 1024).await.unwrap();
        drop((first, small));
        // Larger than everything that is allowed at once.
        let large = workers.wait_to_admit(u64::MAX).await.unwrap();
        assert!(workers.admit().unwrap().grow(1024).is_err());
        drop(large);
        assert!(workers.admit().unwrap().grow(10 * 1024).is_ok());
    }

    #[tokio::test]
    async fn stored_records_wait_for_memory_and_a_large_one_gets_all() {
        let workers = workers();
        let small = workers.memory_for_stored(1).await.unwrap();
        let wait = std::time::Duration::from_millis(20);
        assert!(tokio::time::timeout(wait, workers.memory_for_stored(u64::MAX)).await.is_err());
        drop(small);
        let _large = workers.memory_for_stored(u64::MAX).await.unwrap();
        assert!(tokio::time::timeout(wait, workers.memory_for_stored(1)).await.is_err());
    }

    #[tokio::test]
    async fn a_panicking_task_is_reported_and_the_next_one_runs() {
        let workers = workers();
        let lost = workers.run("fail", || panic!("on purpose")).await;
        assert!(matches!(lost, Err::<(), _>(ServiceError::WorkerLost("fail"))));
        assert_eq!(workers.run("add", || 1 + 1).await.unwrap(), 2);
    }

    #[tokio::test]
    async fn two_of_the_largest_records_are_not_analysed_at_once() {
        use std::sync::atomic::{AtomicUsize, Ordering};
        use std::time::Duration;

        let workers = Arc::new(Workers::new(&WorkLimits { workers: 4, ..WorkLimits::default() }).unwrap());
        let samples_now = Arc::new(AtomicUsize::new(0));
        let max = Arc::new(AtomicUsize::new(0));
        let analyse = |samples: usize| {
            let (workers, now, max) = (Arc::clone(&workers), Arc::clone(&samples_now), Arc::clone(&max));
            tokio::spawn(async move {
                let analysis = move || {
                    max.fetch_max(now.fetch_add(samples, Ordering::SeqCst) + samples, Ordering::SeqCst);
                    std::thread::sleep(Duration::from_millis(20));
                    now.fetch_sub(samples, Ordering::SeqCst);
                };
                workers.run_analysis("analyse", samples, analysis).await.unwrap();
            })
        };
        let half = MAX_RECORD_SAMPLES / 2;
        let sizes = [MAX_RECORD_SAMPLES, half, half, MAX_RECORD_SAMPLES, LARGE_SAMPLES + 1];
        let tasks: Vec<_> = sizes.into_iter().map(analyse).collect();
        for task in tasks {
            task.await.unwrap();
        }
        assert_eq!(max.load(Ordering::SeqCst), MAX_RECORD_SAMPLES);
    }

    #[tokio::test]
    async fn a_record_of_ordinary_length_does_not_wait_for_large_ones() {
        let workers = Workers::new(&WorkLimits { workers: 2, ..WorkLimits::default() });
        let workers = workers.unwrap();
        let (done, wait) = std::sync::mpsc::channel();
        let large = || workers.run_analysis("large", MAX_RECORD_SAMPLES, || ());
        let first = workers.run_analysis("large", MAX_RECORD_SAMPLES, move || wait.recv());
        let ordinary = async {
            workers.run_analysis("ordinary", LARGE_SAMPLES, || ()).await.unwrap();
            done.send(()).unwrap();
        };
        let (first, second, third, ()) = tokio::join!(first, large(), large(), ordinary);
        assert!(first.unwrap().is_ok() && second.is_ok() && third.is_ok());
    }
}
