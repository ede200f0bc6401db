//! Streams: endless sequences of samples that arrive in indexed chunks, and the records cut from them.
//!
//! - [`StreamFormat`]: the format of the samples;
//! - [`Assembler`]: turns chunks in any order, repeated or overlapping, into every sample exactly once, and
//!   gaps with their length;
//! - [`StreamClock`]: gives the time of a sample and tracks the drift of the sampling rate;
//! - [`StreamCutter`]: selects the samples that become records, by a [`CutPolicy`];
//! - [`LevelMeter`]: measures RMS and peak of each second;
//! - [`TachometerChannel`]: finds the pulses of a tachometer in one of the channels.
//!
//! Samples remain raw bytes. All state between chunks can be serialised, so that an interrupted stream can
//! continue.

mod assembler;
mod clock;
mod cutter;
mod format;
mod levels;
mod tachometer;

pub use assembler::{Assembler, Chunk, MAX_INDEX, Piece};
pub use clock::StreamClock;
pub use cutter::{CutPolicy, StreamCut, StreamCutter};
pub use format::StreamFormat;
pub use levels::{ChannelLevel, Level, LevelMeter};
pub use tachometer::TachometerChannel;
