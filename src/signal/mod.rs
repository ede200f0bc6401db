//! Signal processing: a validated [`Record`] becomes spectra, [`Indicators`] and [`Features`].
//!
//! Knows nothing of gears beyond tooth numbers and shaft speed; simulated and measured records go through the same code.
//! An [`Analyzer`] transforms a record once, without a window; the Hann spectrum, the mesh comb, all lines and the envelopes of bands
//! come from those bins. Signals over the shaft's angle
//! ([`AngleRecord`], [`GearSignals`]) cost a resampling more and are worked out on request.

mod analyzer;
mod angle_record;
mod band;
mod cepstrum;
mod envelope;
mod faults;
mod features;
mod gear_indicators;
#[cfg(test)]
mod gear_reference;
mod gear_signals;
mod indicators;
mod line;
mod mesh_comb;
mod mesh_lines;
mod mesh_phase;
mod moments;
mod order_tracking;
mod pchip;
mod record;
mod record_spectrum;
#[cfg(test)]
mod reference;
mod shaft_angle;
mod spectrum;
mod speed;
mod transform;

pub use analyzer::{Analysis, AnalysisSettings, Analyzer};
pub use angle_record::{AngleRecord, OrderSpectrum};
pub use band::{Band, BandQuantity};
pub use cepstrum::Cepstrum;
pub use envelope::{BandError, BandSource};
pub use features::{Features, PREPROCESSING};
pub use gear_indicators::{GearAnalysis, RunMean};
pub use gear_signals::GearSignals;
pub use indicators::{Absence, Indicators};
pub use mesh_lines::MeshLine;
pub use record::{MAX_RECORD_SAMPLES, OperatingPoint, Record, RecordError};
pub use shaft_angle::{AngleSource, PulseError, ShaftAngle};
pub use spectrum::Spectrum;
pub use speed::{MeshContext, ShaftSpeed, SpeedSource};
