//! The latest samples of a stream, kept in memory while there are viewers.

use std::collections::VecDeque;

use bytes::Bytes;

/// The last contiguous frames, as bytes.
#[derive(Debug)]
pub(super) struct Recent {
    frame_bytes: usize,
    /// Maximum number of bytes.
    max_bytes: usize,
    /// Index after the last frame.
    end: u64,
    bytes: VecDeque<u8>,
}

impl Recent {
    pub(super) fn new(frame_bytes: usize, max_frames: u64) -> Self {
        let max_bytes = usize::try_from(max_frames).unwrap_or(usize::MAX).saturating_mul(frame_bytes);
        Self { frame_bytes, max_bytes, end: 0, bytes: VecDeque::new() }
    }

    /// Appends frames; drops the frames before a gap.
    pub(super) fn push(&mut self, first: u64, bytes: &[u8]) {
        if first != self.end {
            self.bytes.clear();
        }
        self.end = first + (bytes.len() / self.frame_bytes) as u64;
        let late = &bytes[bytes.len().saturating_sub(self.max_bytes)..];
        let excess = (self.bytes.len() + late.len()).saturating_sub(self.max_bytes);
        self.bytes.drain(..excess.min(self.bytes.len()));
        self.bytes.extend(late);
    }

    /// The frames, with the index of the first.
    pub(super) fn frames(&self) -> (u64, Bytes) {
        let (one, other) = self.bytes.as_slices();
        let frames = (self.bytes.len() / self.frame_bytes) as u64;
        (self.end - frames, [one, other].concat().into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_contiguous_frames_are_kept() {
        let all: Vec<u8> = (0..200).collect();
        for piece in [2, 6, 30, 120, 200] {
            let mut recent = Recent::new(2, 20);
            for (n, bytes) in all.chunks(piece).enumerate() {
                recent.push(7 + (n * piece / 2) as u64, bytes);
            }
            assert_eq!(recent.frames(), (87, Bytes::copy_from_slice(&all[160..])));
            recent.push(200, &all[..6]);
            assert_eq!(recent.frames(), (200, Bytes::copy_from_slice(&all[..6])));
        }
    }
}
