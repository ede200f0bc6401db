//! Reads the records of a recording ahead on a separate thread, in batches and within a memory limit.

use std::sync::Arc;

use tokio::runtime::Handle;
use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore, mpsc};

use crate::recording::{Recorded, RecordingError};

/// Bytes of memory after which a batch ends: bounds the length of a transaction.
const BATCH_BYTES: usize = 32 << 20;

/// Maximum number of records in a batch.
const BATCH_RECORDS: usize = 128;

/// Number of records read ahead.
const READ_AHEAD: usize = 8;

/// A record and its index in the recording, from 0.
pub(crate) type Numbered = (u64, Result<Recorded, RecordingError>);

/// Consecutive records of a recording.
#[derive(Default)]
pub(crate) struct ReadBatch {
    pub(crate) records: Vec<Numbered>,
    /// Their share of the recording's memory; released when dropped.
    pub(crate) memory: Option<OwnedSemaphorePermit>,
}

/// The records of one recording, from the thread that reads it.
///
/// The records that are read but not stored yet stay within a memory limit: the next record is read only if
/// one as large as the last fits. A record beyond the limit takes all of it, so that a record of any size
/// gets through alone.
pub(crate) struct RecordStream {
    receiver: mpsc::Receiver<(Result<Recorded, RecordingError>, OwnedSemaphorePermit)>,
    read: u64,
    memory: MemoryBudget,
}

/// The memory limit of one recording's records.
#[derive(Clone)]
struct MemoryBudget {
    kibibytes: Arc<Semaphore>,
    max: u32,
    /// Notified when the reader waits for memory.
    reader_waits: Arc<Notify>,
}

impl RecordStream {
    /// Reads from the iterator that `open` returns, on a separate thread, at most `bytes` ahead of the stored
    /// records.
    pub(crate) fn spawn<I, F>(bytes: usize, open: F) -> Self
    where
        F: FnOnce() -> Result<I, RecordingError> + Send + 'static,
        I: Iterator<Item = Result<Recorded, RecordingError>>,
    {
        let (sender, receiver) = mpsc::channel(READ_AHEAD);
        let memory = MemoryBudget::new(bytes);
        let (reserve, runtime) = (memory.clone(), Handle::current());
        tokio::task::spawn_blocking(move || {
            let mut records = match open() {
                Ok(records) => Some(records),
                Err(error) => {
                    if let Some(taken) = reserve.take(0, &runtime) {
                        let _ = sender.blocking_send((Err(error), taken));
                    }
                    None
                }
            };
            let mut expected = 0;
            // Reading ends when the receiver is dropped.
            while let Some(mut taken) = reserve.take(expected, &runtime)
                && let Some(record) = records.as_mut().and_then(Iterator::next)
            {
                let needed = reserve.needed(record.as_ref().map_or(0, Recorded::bytes));
                if needed > expected {
                    let Some(more) = reserve.take(needed - expected, &runtime) else {
                        break;
                    };
                    taken.merge(more);
                } else {
                    drop(taken.split((expected - needed) as usize));
                }
                expected = needed;
                if sender.blocking_send((record, taken)).is_err() {
                    break;
                }
            }
        });
        Self { receiver, read: 0, memory }
    }

    /// Numbers the records from `first` on, as those before it in the recording are skipped.
    pub(crate) fn numbered_from(mut self, first: u64) -> Self {
        self.read = first;
        self
    }

    /// The next record as a batch; empty at the end.
    pub(crate) async fn next(&mut self) -> ReadBatch {
        let mut batch = ReadBatch::default();
        if let Some(received) = self.receiver.recv().await {
            self.read += 1;
            batch.add(self.read - 1, received);
        }
        batch
    }

    /// The next batch: waits for one record and adds those that are available at once; empty at the end.
    pub(crate) async fn next_batch(&mut self) -> ReadBatch {
        let mut batch = self.next().await;
        while !batch.records.is_empty() && batch.records.len() < BATCH_RECORDS && batch.bytes() < BATCH_BYTES
        {
            let next = match self.receiver.try_recv() {
                Ok(ready) => Some(ready),
                // The reader is faster than the fold; a short wait makes batches, and so transactions,
                // larger.
                Err(_) if batch.records.len() < READ_AHEAD => tokio::select! {
                    biased;
                    next = self.receiver.recv() => next,
                    // The reader waits for the memory of this batch.
                    () = self.memory.reader_waits.notified() => None,
                },
                Err(_) => None,
            };
            let Some(received) = next else { break };
            self.read += 1;
            batch.add(self.read - 1, received);
        }
        batch
    }
}

impl Drop for RecordStream {
    fn drop(&mut self) {
        // Ends a reader that waits for memory.
        self.memory.kibibytes.close();
    }
}

impl ReadBatch {
    fn add(
        &mut self,
        number: u64,
        (record, taken): (Result<Recorded, RecordingError>, OwnedSemaphorePermit),
    ) {
        self.records.push((number, record));
        match &mut self.memory {
            Some(memory) => memory.merge(taken),
            None => self.memory = Some(taken),
        }
    }

    fn bytes(&self) -> usize {
        self.memory.as_ref().map_or(0, |memory| 1024 * memory.num_permits())
    }
}

impl MemoryBudget {
    fn new(bytes: usize) -> Self {
        let max = u32::try_from(bytes / 1024).unwrap_or(u32::MAX).max(1);
        Self { kibibytes: Arc::new(Semaphore::new(max as usize)), max, reader_waits: Arc::default() }
    }

    /// The kibibytes for a number of bytes, capped at the limit.
    fn needed(&self, bytes: usize) -> u32 {
        u32::try_from(bytes.div_ceil(1024)).unwrap_or(u32::MAX).min(self.max)
    }

    /// Waits for memory; returns `None` once the stream is dropped. Blocks the thread.
    fn take(&self, kibibytes: u32, runtime: &Handle) -> Option<OwnedSemaphorePermit> {
        let semaphore = || Arc::clone(&self.kibibytes);
        if let Ok(taken) = semaphore().try_acquire_many_owned(kibibytes) {
            return Some(taken);
        }
        self.reader_waits.notify_one();
        runtime.block_on(semaphore().acquire_many_owned(kibibytes)).ok()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    use jiff::Timestamp;

    use super::*;
    use crate::recording::BlockEncoding;
    use crate::signal::Record;

    const MIB: usize = 1 << 20;

    /// A record of this many bytes, half of them raw.
    fn recorded(bytes: usize) -> Recorded {
        Recorded {
            record: Record::new("1", Timestamp::UNIX_EPOCH, 1000.0, "g", vec![0.5; bytes / 8]).unwrap(),
            raw: vec![0; bytes / 2],
            encoding: BlockEncoding::Protobuf,
            reference_wear_um: None,
        }
    }

    /// A stream of records of these sizes, and the number of bytes read from it.
    fn stream(memory: usize, sizes: Vec<usize>) -> (RecordStream, Arc<AtomicUsize>) {
        let read = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&read);
        let records = sizes.into_iter().map(move |bytes| {
            counted.fetch_add(bytes, Ordering::SeqCst);
            Ok(recorded(bytes))
        });
        (RecordStream::spawn(memory, move || Ok(records)), read)
    }

    /// Reads to the end, holding the previous batch as one that waits for the disk; returns the largest
    /// number of bytes held and the batch sizes.
    async fn read_through(memory: usize, sizes: Vec<usize>) -> (usize, Vec<usize>) {
        let (mut records, read) = stream(memory, sizes);
        let (mut before, mut stored, mut max) = (ReadBatch::default(), 0, 0);
        let mut batches = Vec::new();
        let bytes = |batch: &ReadBatch| -> usize {
            batch.records.iter().flat_map(|(_, record)| record).map(Recorded::bytes).sum()
        };
        loop {
            let batch = tokio::time::timeout(Duration::from_secs(20), async {
                let store = async {
                    tokio::time::sleep(Duration::from_millis(20)).await;
                    max = max.max(read.load(Ordering::SeqCst) - stored);
                    stored += bytes(&before);
                    drop(std::mem::take(&mut before));
                };
                tokio::join!(records.next_batch(), store).0
            });
            let batch = batch.await.expect("reader and reading wait for each other");
            if batch.records.is_empty() {
                return (max, batches);
            }
            batches.push(batch.records.len());
            before = batch;
        }
    }

    #[tokio::test]
    async fn large_records_stay_within_the_limit() {
        let (max, batches) = read_through(12 * MIB, vec![4 * MIB; 12]).await;
        assert_eq!(batches.iter().sum::<usize>(), 12);
        assert!(max <= 12 * MIB, "{max} bytes held");
    }

    #[tokio::test]
    async fn a_record_beyond_the_limit_gets_through_alone() {
        for sizes in [vec![8 * MIB; 4], vec![MIB / 64, 8 * MIB, MIB / 64, MIB / 64, 8 * MIB], vec![8; 300]] {
            let (count, largest) = (sizes.len(), sizes.iter().copied().max().unwrap());
            let (max, batches) = read_through(2 * MIB, sizes).await;
            assert_eq!(batches.iter().sum::<usize>(), count);
            // A record larger than the previous one is in memory before its memory is acquired.
            assert!(max <= 2 * MIB + largest, "{max} bytes held");
        }
    }

    #[tokio::test]
    async fn small_records_are_read_ahead_and_come_in_batches() {
        let (_, batches) = read_through(64 * MIB, vec![MIB / 64; 64]).await;
        assert!(batches.len() <= 8, "{batches:?}");
    }

    #[tokio::test]
    async fn records_after_skipped_ones_have_their_number_in_the_recording() {
        let (records, _) = stream(MIB, vec![8; 3]);
        let mut records = records.numbered_from(5);
        for expected in 5..8 {
            assert_eq!(records.next().await.records[0].0, expected);
        }
    }

    #[tokio::test]
    async fn a_reader_that_waits_for_memory_ends_with_its_stream() {
        let ended = Arc::new(());
        let held = Arc::clone(&ended);
        let records = std::iter::repeat_with(move || {
            let _ = &held;
            Ok(recorded(MIB))
        });
        let mut records = RecordStream::spawn(2 * MIB, move || Ok(records));
        let batch = records.next().await;
        tokio::time::sleep(Duration::from_millis(50)).await;
        drop(records);
        for _ in 0..200 {
            tokio::time::sleep(Duration::from_millis(10)).await;
            if Arc::strong_count(&ended) == 1 {
                assert_eq!(batch.records.len(), 1);
                return;
            }
        }
        panic!("the reader still waits");
    }
}
