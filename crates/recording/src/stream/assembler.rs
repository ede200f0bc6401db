//! Assembly of chunks in any order into every sample exactly once.

use std::collections::BTreeMap;

use bytes::Bytes;

use super::super::RecordingError;
use super::StreamFormat;

/// Highest index of a sample: larger whole numbers are not exact in JSON.
pub const MAX_INDEX: u64 = 1 << 53;

/// Largest number of chunks that wait for earlier ones.
const MAX_PENDING: usize = 4096;

/// Largest number of bytes that wait for earlier ones.
const MAX_PENDING_BYTES: usize = 4 << 20;

/// Longest gap in seconds: a longer one means a wrong index.
const MAX_GAP_S: f64 = 366.0 * 24.0 * 3600.0;

/// Consecutive samples of all channels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Chunk {
    /// Index of the first sample.
    pub first: u64,
    /// The sender's time of the first sample, in nanoseconds since 1970.
    pub time_ns: Option<i64>,
    /// Raw bytes of the frames.
    pub bytes: Bytes,
}

/// The next part of a stream.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Piece {
    /// Samples that continue the stream.
    Frames(Chunk),
    /// Missing samples.
    Gap {
        /// Index of the first missing sample.
        first: u64,
        /// Number of missing samples per channel.
        frames: u64,
    },
}

/// Puts chunks in order: each sample is emitted once, even if chunks are repeated, overlap or arrive late.
///
/// A chunk ahead of the stream waits for the chunks before it. Once it is further ahead than the limit, the
/// missing samples become a gap. Chunks that arrive after their gap was emitted are dropped.
#[derive(Debug)]
pub struct Assembler {
    frame_bytes: usize,
    sample_rate_hz: f64,
    reorder_frames: u64,
    next: Option<u64>,
    pending: BTreeMap<u64, Chunk>,
    pending_bytes: usize,
}

impl Assembler {
    /// Creates an assembler that starts at the index `next`, or at that of the first chunk. Chunks may be
    /// ahead by `reorder_frames`.
    pub fn new(format: &StreamFormat, next: Option<u64>, reorder_frames: u64) -> Self {
        Self {
            frame_bytes: format.frame_bytes(),
            sample_rate_hz: format.sample_rate_hz(),
            reorder_frames,
            next,
            pending: BTreeMap::new(),
            pending_bytes: 0,
        }
    }

    /// Returns the index of the next expected sample; `None` before the first chunk.
    pub fn next(&self) -> Option<u64> {
        self.next
    }

    /// Adds a chunk and returns the pieces that can be emitted.
    ///
    /// # Errors
    /// An incomplete frame, or an implausible index. The chunk is ignored then.
    pub fn push(&mut self, chunk: Chunk) -> Result<Vec<Piece>, RecordingError> {
        if !chunk.bytes.len().is_multiple_of(self.frame_bytes) {
            let expected = "a multiple of the bytes of one sample of every channel";
            return Err(RecordingError::field("the chunk's length", chunk.bytes.len(), expected));
        }
        let end = chunk.first.saturating_add(self.frames_of(&chunk));
        let next = self.next.unwrap_or(chunk.first);
        self.check_index(next, end)?;
        if end > chunk.first {
            self.next = Some(next);
            self.store(next, chunk);
        }
        let mut pieces = Vec::new();
        self.emit_ready(&mut pieces);
        while self.is_too_far_ahead() {
            self.emit_gap(&mut pieces);
        }
        Ok(pieces)
    }

    /// Declares all missing samples before `index` lost, and returns the pieces that can be emitted.
    ///
    /// # Errors
    /// An implausible index.
    pub fn declare_lost_before(&mut self, index: u64) -> Result<Vec<Piece>, RecordingError> {
        let mut pieces = Vec::new();
        let Some(next) = self.next else {
            self.check_index(index, index)?;
            self.next = Some(index);
            return Ok(pieces);
        };
        self.check_index(next, index)?;
        while self.pending.first_key_value().is_some_and(|(first, _)| *first < index) {
            self.emit_gap(&mut pieces);
        }
        if let Some(next) = self.next
            && next < index
        {
            pieces.push(Piece::Gap { first: next, frames: index - next });
            self.next = Some(index);
        }
        self.emit_ready(&mut pieces);
        Ok(pieces)
    }

    /// Drops the waiting chunks: the sender restarts at [`next`](Self::next).
    pub fn discard_pending(&mut self) {
        self.pending.clear();
        self.pending_bytes = 0;
    }

    fn check_index(&self, next: u64, end: u64) -> Result<(), RecordingError> {
        let longest = (MAX_GAP_S * self.sample_rate_hz) as u64;
        if end > MAX_INDEX || end.saturating_sub(next) > longest {
            let expected = "an index below 2^53 and within a year of samples of the next one";
            return Err(RecordingError::field("first index", end, expected));
        }
        Ok(())
    }

    fn frames_of(&self, chunk: &Chunk) -> u64 {
        (chunk.bytes.len() / self.frame_bytes) as u64
    }

    /// Stores the new part of a chunk. Of two chunks with the same start the longer one is kept.
    fn store(&mut self, next: u64, chunk: Chunk) {
        let Some(chunk) = self.part_from(chunk, next) else { return };
        if self.pending.get(&chunk.first).is_some_and(|pending| pending.bytes.len() >= chunk.bytes.len()) {
            return;
        }
        self.pending_bytes += chunk.bytes.len();
        if let Some(shorter) = self.pending.insert(chunk.first, chunk) {
            self.pending_bytes -= shorter.bytes.len();
        }
    }

    /// Emits the chunks that continue the stream.
    fn emit_ready(&mut self, pieces: &mut Vec<Piece>) {
        while let Some(next) = self.next
            && let Some(entry) = self.pending.first_entry()
            && *entry.key() <= next
        {
            let chunk = entry.remove();
            self.pending_bytes -= chunk.bytes.len();
            if let Some(chunk) = self.part_from(chunk, next) {
                self.next = Some(next + self.frames_of(&chunk));
                pieces.push(Piece::Frames(chunk));
            }
        }
    }

    fn is_too_far_ahead(&self) -> bool {
        let Some((next, last)) = self.next.zip(self.pending.last_key_value()) else { return false };
        let end = last.0 + self.frames_of(last.1);
        end - next > self.reorder_frames
            || self.pending.len() > MAX_PENDING
            || self.pending_bytes > MAX_PENDING_BYTES
    }

    /// Emits the gap before the first waiting chunk, and the chunks that follow it.
    fn emit_gap(&mut self, pieces: &mut Vec<Piece>) {
        if let Some((first, next)) = self.pending.keys().next().copied().zip(self.next) {
            pieces.push(Piece::Gap { first: next, frames: first - next });
            self.next = Some(first);
            self.emit_ready(pieces);
        }
    }

    /// Returns the part of a chunk from an index on, if any.
    fn part_from(&self, mut chunk: Chunk, index: u64) -> Option<Chunk> {
        let skipped = index.saturating_sub(chunk.first);
        if skipped >= self.frames_of(&chunk) {
            return None;
        }
        chunk.first += skipped;
        chunk.bytes = chunk.bytes.slice(skipped as usize * self.frame_bytes..);
        let later_ns = (skipped as f64 / self.sample_rate_hz * 1e9) as i64;
        chunk.time_ns = chunk.time_ns.map(|time_ns| time_ns.saturating_add(later_ns));
        Some(chunk)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::RawSample;

    fn format(channels: u32) -> StreamFormat {
        StreamFormat::new(RawSample::I16, 1000.0, channels, None).unwrap()
    }

    /// Frames of two channels that differ from each other.
    fn bytes(first: u64, frames: u64) -> Bytes {
        (first..first + frames).flat_map(|k| [k as i16, -(k as i16)]).flat_map(i16::to_le_bytes).collect()
    }

    fn chunk(first: u64, frames: u64) -> Chunk {
        Chunk { first, time_ns: None, bytes: bytes(first, frames) }
    }

    /// All samples by their index, and the gaps.
    fn put_together(pieces: Vec<Piece>) -> (Vec<u8>, Vec<(u64, u64)>) {
        let (mut samples, mut gaps) = (Vec::new(), Vec::new());
        for piece in pieces {
            match piece {
                Piece::Frames(chunk) => samples.extend_from_slice(&chunk.bytes),
                Piece::Gap { first, frames } => gaps.push((first, frames)),
            }
        }
        (samples, gaps)
    }

    #[test]
    fn samples_missing_too_long_are_a_gap_and_dropped_later() {
        let mut assembler = Assembler::new(&format(2), None, 50);
        assert_eq!(assembler.push(chunk(100, 10)).unwrap(), [Piece::Frames(chunk(100, 10))]);
        assert_eq!(assembler.push(chunk(120, 30)).unwrap(), []);
        let pieces = assembler.push(chunk(150, 20)).unwrap();
        let gap = Piece::Gap { first: 110, frames: 10 };
        assert_eq!(pieces, [gap, Piece::Frames(chunk(120, 30)), Piece::Frames(chunk(150, 20))]);
        assert_eq!(assembler.push(chunk(105, 15)).unwrap(), []);
        assert_eq!(assembler.next(), Some(170));
        // A gap declared by the sender needs no waiting.
        let gap = Piece::Gap { first: 170, frames: 30 };
        assert_eq!(assembler.declare_lost_before(200).unwrap(), [gap]);
        assert_eq!(assembler.push(chunk(200, 1)).unwrap(), [Piece::Frames(chunk(200, 1))]);
    }

    #[test]
    fn pending_chunks_continue_after_a_declared_gap() {
        let mut assembler = Assembler::new(&format(2), Some(0), 1000);
        assert_eq!(assembler.push(chunk(10, 5)).unwrap(), []);
        let pieces = assembler.declare_lost_before(20).unwrap();
        let (gap, rest) = (Piece::Gap { first: 0, frames: 10 }, Piece::Gap { first: 15, frames: 5 });
        assert_eq!(pieces, [gap, Piece::Frames(chunk(10, 5)), rest]);
        assembler.push(chunk(30, 5)).unwrap();
        assembler.discard_pending();
        assert_eq!(assembler.declare_lost_before(40).unwrap(), [Piece::Gap { first: 20, frames: 20 }]);
    }

    #[test]
    fn implausible_indices_and_lengths_are_rejected() {
        let mut assembler = Assembler::new(&format(2), Some(0), 50);
        let half = Chunk { bytes: Bytes::from_static(&[0; 6]), ..chunk(0, 1) };
        for bad in [half, chunk(MAX_INDEX, 1), chunk(400 * 24 * 3600 * 1000, 1)] {
            assert!(assembler.push(bad).is_err());
        }
        assert!(assembler.declare_lost_before(MAX_INDEX + 1).is_err());
        assert_eq!(assembler.push(chunk(0, 3)).unwrap(), [Piece::Frames(chunk(0, 3))]);
    }

    #[test]
    fn pending_chunks_are_bounded() {
        let mut assembler = Assembler::new(&format(2), Some(0), u64::MAX);
        let mut pieces = Vec::new();
        for k in 0..3 * MAX_PENDING as u64 {
            pieces.extend(assembler.push(chunk(2 * k + 1, 1)).unwrap());
        }
        assert!(assembler.pending.len() <= MAX_PENDING);
        assert_eq!(pieces[0], Piece::Gap { first: 0, frames: 1 });
    }

    proptest! {
        /// Chunks that cover 0..500 and any others, in any order, give each sample once.
        #[test]
        fn any_order_repetition_and_overlap_gives_the_same_samples(
            cuts in prop::collection::btree_set(1_u64..500, 0..20),
            extra in prop::collection::vec((0_u64..500, 1_u64..100), 0..20),
            order in any::<prop::sample::Index>(),
            seed in prop::collection::vec(any::<u32>(), 64),
        ) {
            let edges: Vec<u64> = std::iter::once(0).chain(cuts).chain([500]).collect();
            let mut chunks: Vec<Chunk> = edges.windows(2).map(|edge| chunk(edge[0], edge[1] - edge[0])).collect();
            chunks.extend(extra.iter().map(|&(first, frames)| chunk(first, frames.min(500 - first))));
            let mut keyed: Vec<(u32, Chunk)> =
                chunks.into_iter().enumerate().map(|(n, chunk)| (seed[n % 64].wrapping_mul(n as u32 | 1), chunk)).collect();
            keyed.sort_by_key(|(key, _)| *key);
            let middle = order.index(keyed.len());
            keyed.rotate_left(middle);
            let mut assembler = Assembler::new(&format(2), Some(0), 500);
            let mut pieces = Vec::new();
            for (_, chunk) in keyed {
                pieces.extend(assembler.push(chunk).unwrap());
            }
            let (samples, gaps) = put_together(pieces);
            prop_assert_eq!(gaps, []);
            prop_assert_eq!(samples, bytes(0, 500));
            prop_assert_eq!((assembler.pending.len(), assembler.pending_bytes), (0, 0));
        }

        /// With a small bound there are gaps; samples and gaps together still are every index once, in order.
        #[test]
        fn samples_and_gaps_are_every_index_once(
            chunks in prop::collection::vec((0_u64..500, 1_u64..50), 1..60),
        ) {
            let mut assembler = Assembler::new(&format(2), Some(0), 64);
            let mut next = 0;
            for (first, frames) in chunks {
                for piece in assembler.push(chunk(first, frames)).unwrap() {
                    match piece {
                        Piece::Frames(whole) => {
                            let frames = whole.bytes.len() as u64 / 4;
                            prop_assert_eq!(whole.first, next);
                            prop_assert_eq!(&whole.bytes, &bytes(next, frames));
                            next += frames;
                        }
                        Piece::Gap { first, frames } => {
                            prop_assert_eq!(first, next);
                            prop_assert!(frames > 0);
                            next += frames;
                        }
                    }
                }
                prop_assert_eq!(assembler.next(), Some(next));
            }
        }
    }
}
