//! A record with the bytes that it came from.

use super::BlockEncoding;
use flankwatch_signal::Record;

/// A record of a recording, with its raw bytes.
#[derive(Debug, Clone, PartialEq)]
pub struct Recorded {
    /// The record.
    pub record: Record,
    /// The block's raw bytes, followed by the pulses of tachometer messages that belong to it. A part of a
    /// WAV recording is encoded anew.
    pub raw: Vec<u8>,
    /// Encoding of `raw`.
    pub encoding: BlockEncoding,
    /// Reference wear depth in µm for this record's start time, for comparison only.
    pub reference_wear_um: Option<f64>,
}

impl Recorded {
    /// Returns its size in memory in bytes.
    pub fn bytes(&self) -> usize {
        let pulses = self.record.tachometer().map_or(0, |tachometer| tachometer.pulse_times_s.len());
        self.raw.capacity() + size_of_val(self.record.samples()) + pulses * size_of::<f64>()
    }
}
