//! RMS and peak of each second of a stream.

use serde::{Deserialize, Serialize};

use super::StreamFormat;

/// The level of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChannelLevel {
    /// Root mean square in the stream's unit, mean not removed; NaN if no sample is a number.
    pub rms: f32,
    /// Largest magnitude in the stream's unit.
    pub peak: f32,
}

/// The levels of one second.
#[derive(Debug, Clone, PartialEq)]
pub struct Level {
    /// Index of the second's first sample, a multiple of the samples of one second.
    pub first: u64,
    /// Number of samples per channel received.
    pub frames: u64,
    /// One entry per channel.
    pub channels: Vec<ChannelLevel>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
struct Sums {
    squares: f64,
    count: u64,
    peak: f32,
}

/// Measures levels second by second. Seconds are counted by index, so they do not depend on how samples
/// arrived.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct LevelMeter {
    first: u64,
    frames: u64,
    channels: Vec<Sums>,
}

impl LevelMeter {
    /// Adds samples and appends each completed second to `levels`.
    pub fn extend(&mut self, format: &StreamFormat, first: u64, bytes: &[u8], levels: &mut Vec<Level>) {
        let second = format.frames_in(1.0).max(1);
        let (mut first, mut bytes) = (first, bytes);
        while !bytes.is_empty() {
            let begin = first / second * second;
            if begin != self.first {
                levels.extend(self.take());
                self.first = begin;
            }
            let frames = ((bytes.len() / format.frame_bytes()) as u64).min(begin + second - first);
            if frames == 0 {
                return;
            }
            let (now, rest) = bytes.split_at(frames as usize * format.frame_bytes());
            self.add(format, now);
            self.frames += frames;
            first += frames;
            bytes = rest;
            if first == begin + second {
                levels.extend(self.take());
            }
        }
    }

    fn add(&mut self, format: &StreamFormat, bytes: &[u8]) {
        self.channels.resize(format.channels(), Sums::default());
        let channels = self.channels.len();
        for (n, value) in format.values(bytes).enumerate() {
            if value.is_finite() {
                let sums = &mut self.channels[n % channels];
                sums.squares += f64::from(value) * f64::from(value);
                sums.count += 1;
                sums.peak = sums.peak.max(value.abs());
            }
        }
    }

    /// Returns the current second; `None` if it has no samples.
    fn take(&mut self) -> Option<Level> {
        let channels = std::mem::take(&mut self.channels);
        let frames = std::mem::take(&mut self.frames);
        let level = |sums: Sums| ChannelLevel {
            rms: (sums.squares / sums.count as f64).sqrt() as f32,
            peak: sums.peak,
        };
        let channels = channels.into_iter().map(level).collect();
        (frames > 0).then_some(Level { first: self.first, frames, channels })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RawSample;

    fn bytes(values: impl IntoIterator<Item = f32>) -> Vec<u8> {
        values.into_iter().flat_map(f32::to_le_bytes).collect()
    }

    #[test]
    fn each_second_has_its_rms_and_peak_whatever_the_chunks() {
        let format = StreamFormat::new(RawSample::F32, 10.0, 2, Some(2.0)).unwrap();
        // A square wave of 1 and a ramp, each scaled by 2.
        let all = bytes((0..40).flat_map(|k| [if k % 2 == 0 { 1.0 } else { -1.0 }, -(k as f32)]));
        let measure = |frames: usize| {
            let (mut meter, mut levels) = (LevelMeter::default(), Vec::new());
            let mut first = 5;
            for chunk in all.chunks(frames * 8) {
                meter.extend(&format, first, chunk, &mut levels);
                first += (chunk.len() / 8) as u64;
            }
            levels
        };
        let levels = measure(40);
        let firsts: Vec<(u64, u64)> = levels.iter().map(|level| (level.first, level.frames)).collect();
        assert_eq!(firsts, [(0, 5), (10, 10), (20, 10), (30, 10)]);
        assert_eq!(levels[1].channels[0], ChannelLevel { rms: 2.0, peak: 2.0 });
        assert_eq!(levels[1].channels[1].peak, 28.0);
        for frames in [1, 3, 7] {
            assert_eq!(measure(frames), levels);
        }
    }

    #[test]
    fn gaps_and_invalid_samples_are_excluded() {
        let format = StreamFormat::new(RawSample::F32, 4.0, 1, None).unwrap();
        let (mut meter, mut levels) = (LevelMeter::default(), Vec::new());
        meter.extend(&format, 0, &bytes([3.0, f32::NAN]), &mut levels);
        meter.extend(&format, 8, &bytes([f32::NAN; 4]), &mut levels);
        assert_eq!(
            levels[0],
            Level { first: 0, frames: 2, channels: vec![ChannelLevel { rms: 3.0, peak: 3.0 }] }
        );
        assert!(levels[1].first == 8 && levels[1].channels[0].rms.is_nan());
    }
}
