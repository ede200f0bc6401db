//! The records of a recording as a thread of their own reads them, in batches and within a bound on memory.

use std::sync::Arc;

use tokio::runtime::Handle;
use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore, mpsc};

use crate::recording::{Recorded, RecordingError};

/// Bytes of memory of one batch, beyond which the next one begins: bounds the length of a transaction.
const BATCH_BYTES: usize = 32 << 20;

/// Records of one batch, beyond which the next one begins.
const BATCH_RECORDS: usize = 128;

/// Records read ahead of the one that is processed.
const READ_AHEAD: usize = 8;

/// A record and its number in the recording, counted from 0.
pub(crate) type Numbered = (u64, Result<Recorded, RecordingError>);

/// Consecutive records of a recording.
#[derive(Default)]
pub(crate) struct ReadBatch {
    pub(crate) records: Vec<Numbered>,
    /// What they take of the recording's memory; given back when dropped.
    pub(crate) room: Option<OwnedSemaphorePermit>,
}

/// Records of one recording as they come from the thread that reads it.
///
/// What is read and not yet stored keeps within a bound: one more record is read only where there is room for
/// one as large as the last, or where nothing is held at all, so that a record of any size gets through by
/// itself.
pub(crate) struct RecordStream {
    receiver: mpsc::Receiver<(Result<Recorded, RecordingError>, OwnedSemaphorePermit)>,
    read: u64,
    room: Room,
}

/// The memory of one recording's records.
#[derive(Clone)]
struct Room {
    kibibytes: Arc<Semaphore>,
    most: u32,
    /// The reader waits for room.
    wanted: Arc<Notify>,
}

impl RecordStream {
    /// Reads with the iterator that `open` makes on a thread of its own, at most `bytes` ahead of what is
    /// stored.
    pub(crate) fn spawn<I, F>(bytes: usize, open: F) -> Self
    where
        F: FnOnce() -> Result<I, RecordingError> + Send + 'static,
        I: Iterator<Item = Result<Recorded, RecordingError>>,
    {
        let (sender, receiver) = mpsc::channel(READ_AHEAD);
        let room = Room::new(bytes);
        let (reserve, runtime) = (room.clone(), Handle::current());
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
            // The other side may have gone: then reading ends too.
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
        Self { receiver, read: 0, room }
    }

    /// The next record by itself; empty at the end.
    pub(crate) async fn next(&mut self) -> ReadBatch {
        let mut batch = ReadBatch::default();
        if let Some(received) = self.receiver.recv().await {
            self.read += 1;
            batch.add(self.read - 1, received);
        }
        batch
    }

    /// The next batch: waits for one record and takes with it those that follow at once; empty at the end.
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
                    // It waits for what this batch holds.
                    () = self.room.wanted.notified() => None,
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
        // A reader that waits for room ends.
        self.room.kibibytes.close();
    }
}

impl ReadBatch {
    fn add(
        &mut self,
        number: u64,
        (record, taken): (Result<Recorded, RecordingError>, OwnedSemaphorePermit),
    ) {
        self.records.push((number, record));
        match &mut self.room {
            Some(room) => room.merge(taken),
            None => self.room = Some(taken),
        }
    }

    fn bytes(&self) -> usize {
        self.room.as_ref().map_or(0, |room| 1024 * room.num_permits())
    }
}

impl Room {
    fn new(bytes: usize) -> Self {
        let most = u32::try_from(bytes / 1024).unwrap_or(u32::MAX).max(1);
        Self { kibibytes: Arc::new(Semaphore::new(most as usize)), most, wanted: Arc::default() }
    }

    /// What so many bytes take: all of it where they are more than there is.
    fn needed(&self, bytes: usize) -> u32 {
        u32::try_from(bytes.div_ceil(1024)).unwrap_or(u32::MAX).min(self.most)
    }

    /// Waits for room; none where nobody wants records any more. Blocks the thread.
    fn take(&self, kibibytes: u32, runtime: &Handle) -> Option<OwnedSemaphorePermit> {
        let semaphore = || Arc::clone(&self.kibibytes);
        if let Ok(taken) = semaphore().try_acquire_many_owned(kibibytes) {
            return Some(taken);
        }
        self.wanted.notify_one();
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

    /// A record that takes this many bytes, half of them raw.
    fn recorded(bytes: usize) -> Recorded {
        Recorded {
            record: Record::new("1", Timestamp::UNIX_EPOCH, 1000.0, "g", vec![0.5; bytes / 8]).unwrap(),
            raw: vec![0; bytes / 2],
            encoding: BlockEncoding::Protobuf,
            reference_wear_um: None,
        }
    }

    /// A stream of records of these sizes, and how many bytes have been read of it.
    fn stream(room: usize, sizes: Vec<usize>) -> (RecordStream, Arc<AtomicUsize>) {
        let read = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&read);
        let records = sizes.into_iter().map(move |bytes| {
            counted.fetch_add(bytes, Ordering::SeqCst);
            Ok(recorded(bytes))
        });
        (RecordStream::spawn(room, move || Ok(records)), read)
    }

    /// Reads to the end, keeping the batch before as one that waits for the disk; the largest number of bytes
    /// that were held.
    async fn read_through(room: usize, sizes: Vec<usize>) -> (usize, Vec<usize>) {
        let (mut records, read) = stream(room, sizes);
        let (mut before, mut stored, mut most) = (ReadBatch::default(), 0, 0);
        let mut batches = Vec::new();
        let bytes = |batch: &ReadBatch| -> usize {
            batch.records.iter().flat_map(|(_, record)| record).map(Recorded::bytes).sum()
        };
        loop {
            let batch = tokio::time::timeout(Duration::from_secs(20), async {
                let store = async {
                    tokio::time::sleep(Duration::from_millis(20)).await;
                    most = most.max(read.load(Ordering::SeqCst) - stored);
                    stored += bytes(&before);
                    drop(std::mem::take(&mut before));
                };
                tokio::join!(records.next_batch(), store).0
            });
            let batch = batch.await.expect("reader and reading wait for each other");
            if batch.records.is_empty() {
                return (most, batches);
            }
            batches.push(batch.records.len());
            before = batch;
        }
    }

    #[tokio::test]
    async fn large_records_keep_within_the_bound() {
        let (most, batches) = read_through(12 * MIB, vec![4 * MIB; 12]).await;
        assert_eq!(batches.iter().sum::<usize>(), 12);
        assert!(most <= 12 * MIB, "{most} bytes held");
    }

    #[tokio::test]
    async fn a_record_beyond_the_bound_gets_through_by_itself() {
        for sizes in [vec![8 * MIB; 4], vec![MIB / 64, 8 * MIB, MIB / 64, MIB / 64, 8 * MIB], vec![8; 300]] {
            let (count, largest) = (sizes.len(), sizes.iter().copied().max().unwrap());
            let (most, batches) = read_through(2 * MIB, sizes).await;
            assert_eq!(batches.iter().sum::<usize>(), count);
            // One that is larger than the one before is there before there is room for it.
            assert!(most <= 2 * MIB + largest, "{most} bytes held");
        }
    }

    #[tokio::test]
    async fn small_records_are_read_ahead_and_come_in_batches() {
        let (_, batches) = read_through(64 * MIB, vec![MIB / 64; 64]).await;
        assert!(batches.len() <= 8, "{batches:?}");
    }

    #[tokio::test]
    async fn a_reader_that_waits_for_room_ends_with_its_stream() {
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
