//! Samples of a device that measures by its own clock: in blocks, with the number of samples lost in between.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use jiff::{SignedDuration, Timestamp};

use super::source::{BLOCK_S, SampleSource, SourceBlock};
use crate::cli::CliError;
use crate::recording::stream::StreamFormat;

/// A device that samples into a buffer of its own.
pub(super) trait CaptureDevice: Send {
    /// Empties the buffer and begins to sample, at first and after an overrun.
    fn start(&mut self) -> Result<(), CliError>;

    /// Waits for frames, and moves them from the buffer to `frames`.
    fn read(&mut self, frames: &mut [u8]) -> Result<CaptureRead, CliError>;

    /// Frames in the buffer; `None` if the device has stopped.
    fn buffered_frames(&self) -> Option<u64>;

    /// The time since an arbitrary moment, by a monotonic clock.
    fn monotonic_time(&self) -> Duration;
}

/// The result of reading from a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum CaptureRead {
    /// Frames read; none if the device had none for a while.
    Frames(usize),
    /// The buffer was full, so the device has stopped; what was in it is lost.
    Overrun,
    /// There are no more samples.
    End,
}

/// The samples of a device.
pub(super) struct Capture<D> {
    device: D,
    format: StreamFormat,
    is_running: bool,
    /// When the sample after the last one read was due.
    read_to: Duration,
    stop: Arc<AtomicBool>,
}

impl<D: CaptureDevice> Capture<D> {
    /// Creates the source; samples between now and the first block count as lost.
    pub(super) fn new(device: D, format: StreamFormat, stop: Arc<AtomicBool>) -> Self {
        let read_to = device.monotonic_time();
        Self { device, format, is_running: false, read_to, stop }
    }

    /// Starts the device; returns the number of samples lost since the last one.
    fn start(&mut self) -> Result<u64, CliError> {
        self.device.start()?;
        self.is_running = true;
        let began = self.device.monotonic_time();
        let lost = self.format.frames_in(began.saturating_sub(self.read_to).as_secs_f64());
        self.read_to = began;
        Ok(lost)
    }

    fn seconds(&self, frames: u64) -> Duration {
        Duration::from_secs_f64(self.format.seconds(frames))
    }
}

impl<D: CaptureDevice> SampleSource for Capture<D> {
    fn format(&self) -> &StreamFormat {
        &self.format
    }

    fn next(&mut self) -> Result<Option<SourceBlock>, CliError> {
        let width = self.format.frame_bytes();
        let mut bytes = vec![0; self.format.frames_in(BLOCK_S).max(1) as usize * width];
        let (mut filled, mut lost) = (0, 0);
        while filled < bytes.len() && !self.stop.load(Ordering::Relaxed) {
            if !self.is_running {
                lost += self.start()?;
            }
            match self.device.read(&mut bytes[filled..])? {
                CaptureRead::Frames(frames) => {
                    filled += frames * width;
                    self.read_to = match self.device.buffered_frames() {
                        Some(waiting) => self.device.monotonic_time().saturating_sub(self.seconds(waiting)),
                        None => self.read_to + self.seconds(frames as u64),
                    };
                }
                CaptureRead::Overrun => {
                    self.is_running = false;
                    // What was read before the loss is a block of its own.
                    if filled > 0 {
                        break;
                    }
                }
                CaptureRead::End => break,
            }
        }
        bytes.truncate(filled);
        if bytes.is_empty() {
            return Ok(None);
        }
        let unread = self.device.monotonic_time().saturating_sub(self.read_to);
        let age = unread + self.seconds((filled / width) as u64);
        let time = Timestamp::now() - SignedDuration::try_from(age).unwrap_or_default();
        Ok(Some(SourceBlock { lost, time, bytes }))
    }
}

/// A clock for devices.
#[derive(Debug)]
pub(super) struct MonotonicClock(Instant);

impl MonotonicClock {
    pub(super) fn new() -> Self {
        Self(Instant::now())
    }

    pub(super) fn time(&self) -> Duration {
        self.0.elapsed()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use super::*;
    use crate::recording::RawSample;

    /// A device at 1000 Hz that is sometimes read late, with a millisecond clock.
    struct LateDevice {
        time_ms: u64,
        /// The times of its next sample and of its start.
        sampled_to_ms: u64,
        /// Milliseconds from one read to the next.
        reads: VecDeque<u64>,
    }

    const BUFFER_FRAMES: u64 = 100;

    impl CaptureDevice for LateDevice {
        fn start(&mut self) -> Result<(), CliError> {
            self.time_ms += 3;
            self.sampled_to_ms = self.time_ms;
            Ok(())
        }

        fn read(&mut self, frames: &mut [u8]) -> Result<CaptureRead, CliError> {
            let Some(wait) = self.reads.pop_front() else { return Ok(CaptureRead::End) };
            self.time_ms += wait;
            let waiting = self.time_ms - self.sampled_to_ms;
            if waiting > BUFFER_FRAMES {
                return Ok(CaptureRead::Overrun);
            }
            // The time of a sample is its value.
            let count = (waiting as usize).min(frames.len() / 2);
            for frame in frames[..2 * count].chunks_exact_mut(2) {
                frame.copy_from_slice(&(self.sampled_to_ms as i16).to_le_bytes());
                self.sampled_to_ms += 1;
            }
            Ok(CaptureRead::Frames(count))
        }

        fn buffered_frames(&self) -> Option<u64> {
            Some(self.time_ms - self.sampled_to_ms)
        }

        fn monotonic_time(&self) -> Duration {
            Duration::from_millis(self.time_ms)
        }
    }

    #[test]
    fn an_overrun_is_a_gap_of_its_length() {
        // Read in time; late, at once and after a block; twice in a row; in time again.
        let reads = [60, 90, 100, 70, 150, 30, 99, 101, 400, 80, 80, 80, 500, 50].into();
        let device = LateDevice { time_ms: 40, sampled_to_ms: 0, reads };
        let format = StreamFormat::new(RawSample::I16, 1000.0, 1, None).unwrap();
        let mut capture = Capture::new(device, format, Arc::default());
        capture.device.time_ms += 200;
        let (mut index, mut blocks, mut lost) = (40, 0, 0);
        while let Some(block) = capture.next().unwrap() {
            index += block.lost;
            let times = block.bytes.as_chunks::<2>().0.iter().map(|bytes| i16::from_le_bytes(*bytes));
            for time_ms in times {
                assert_eq!(i64::from(time_ms), index as i64, "the index of a sample is its time");
                index += 1;
            }
            (blocks, lost) = (blocks + 1, lost + block.lost);
        }
        // The first start, and 3 ms for every further one.
        assert_eq!((blocks, lost), (5, 203 + (150 + 3) + (101 + 3 + 400 + 3) + (500 + 3)));
    }
}
