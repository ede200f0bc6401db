//! Signal processing: a validated [`Record`] becomes spectra, [`Indicators`] and [`Features`].
//!
//! Knows nothing of gears beyond tooth numbers and shaft speed; simulated and measured records go through the same code.
//! An [`Analyzer`] transforms a record once, without a window; the Hann spectrum, the mesh comb, all lines and the envelopes of bands
//! come from those bins.

mod analyzer;
mod envelope;
mod features;
mod indicators;
mod line;
mod mesh_comb;
mod mesh_lines;
mod moments;
mod record;
mod record_spectrum;
#[cfg(test)]
mod reference;
mod spectrum;
mod speed;
mod transform;

pub use analyzer::{Analysis, AnalysisSettings, Analyzer};
pub use envelope::{BandError, BandSource};
pub use features::{Features, PREPROCESSING};
pub use indicators::{Absence, Indicators};
pub use mesh_lines::MeshLine;
pub use record::{MAX_RECORD_SAMPLES, OperatingPoint, Record, RecordError};
pub use spectrum::Spectrum;
pub use speed::{MeshContext, ShaftSpeed, SpeedSource};
