//! Streams: samples without end that come in chunks by their index, and the records cut out of them.
//!
//! - [`StreamFormat`]: what has to be known to read the samples;
//! - [`Assembler`]: chunks in any order, repeated or overlapping, to every sample once and gaps with their
//!   length;
//! - [`StreamClock`]: the time of a sample, with the rate's drift followed;
//! - [`StreamCutter`]: which samples become records, by a [`CutPolicy`];
//! - [`LevelMeter`]: RMS and peak of each second.
//!
//! Samples stay the bytes that came. What is kept from chunk to chunk can be serialised, so that a stream
//! goes on where it ended.

mod assembler;
mod clock;
mod cutter;
mod format;
mod levels;

pub use assembler::{Assembler, Chunk, MAX_INDEX, Piece};
pub use clock::StreamClock;
pub use cutter::{CutPolicy, StreamCut, StreamCutter};
pub use format::StreamFormat;
pub use levels::{ChannelLevel, Level, LevelMeter};
