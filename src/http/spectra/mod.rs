//! Samples, spectra and lines of stored records, and spectra over the life of a channel.

pub(super) mod angle;
pub(super) mod cepstra;
mod envelope_band;
pub(super) mod line_cache;
mod line_levels;
mod line_range;
pub(super) mod lines;
pub(super) mod matching;
pub(super) mod waterfall;
pub(super) mod waveforms;
