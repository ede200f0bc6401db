//! Signal processing: a validated [`Record`] becomes spectra, [`Indicators`] and [`Features`].
//!
//! Knows nothing of gears beyond tooth numbers and shaft speed; simulated and measured records go through the same code.
//! An [`Analyzer`] transforms a record once, without a window; the Hann spectrum, the mesh comb, all lines and the envelopes of bands
//! come from those bins. Signals over the shaft's angle
//! ([`AngleRecord`], [`GearSignals`]) cost a resampling more and are worked out on request.

mod analyzer;
mod angle_record;
#[cfg(test)]
mod any_samples;
mod band;
mod cepstrum;
mod checks;
mod condition;
mod envelope;
mod faults;
mod features;
mod foreign_lines;
mod gear_indicators;
#[cfg(test)]
mod gear_reference;
mod gear_signals;
mod indicators;
mod interpolation;
mod kurtogram;
mod line;
mod mesh_comb;
mod mesh_lines;
mod mesh_phase;
mod moments;
mod order_tracking;
mod other_meshes;
mod pchip;
mod phases;
mod reading;
mod record;
mod record_spectrum;
#[cfg(test)]
mod reference;
mod resampling;
mod shaft_angle;
mod spectrum;
mod speed;
mod speed_wander;
mod steadying;
mod tooth_contrast;
mod transform;

pub use analyzer::{Analysis, AnalysisSettings, Analyzer};
pub use angle_record::{AngleRecord, OrderSpectrum};
pub use band::{Band, BandQuantity};
pub use cepstrum::Cepstrum;
pub use condition::{Basis, Condition, ConditionSettings, GEAR_PREPROCESSING};
pub use envelope::{BandError, BandSource, EnvelopeBand, EnvelopeSearch};
pub use features::{Features, PREPROCESSING};
pub use gear_indicators::{AngleUsed, GearAnalysis, RunMean, RunMeans};
pub use gear_signals::GearSignals;
pub use indicators::{Absence, INDICATORS, Indicators};
pub use kurtogram::{Kurtogram, KurtogramBand, KurtogramLevel};
pub use mesh_lines::MeshLine;
pub use other_meshes::{OtherMesh, OtherMeshes};
pub use reading::Reading;
pub use record::{MAX_RECORD_SAMPLES, OperatingPoint, Quality, Record, RecordError, Tachometer};
pub use shaft_angle::{AngleSource, PulseError, ShaftAngle};
pub use spectrum::Spectrum;
pub use speed::{MeshContext, ShaftSpeed, SpeedSource};
