//! Signal processing: a validated [`Record`] becomes spectra, [`Indicators`] and [`Features`].
//!
//! - [`Record`]: samples of one channel with their time, rate and unit, checked;
//! - [`Analyzer`]: computes the analysis; one per thread, as it reuses its transform plans and buffers;
//! - [`Indicators`]: condition indicators by name, or the reason why one could not be computed;
//! - [`Features`]: the values that the wear estimate compares.
//!
//! ```
//! use flankwatch_signal::{AnalysisSettings, Analyzer, MeshContext, Record};
//! use jiff::Timestamp;
//!
//! // A mesh of 24 teeth at 25 Hz, modulated once a turn.
//! let samples = (0..40_000).map(|i| {
//!     let turn = std::f64::consts::TAU * 25.0 * f64::from(i) / 20_000.0;
//!     ((1.0 + 0.1 * turn.cos()) * (24.0 * turn).sin()) as f32
//! });
//! let record = Record::new("a1", Timestamp::UNIX_EPOCH, 20_000.0, "m/s2", samples.collect())?;
//!
//! let mesh = MeshContext::new([24, 0], 24.5, 0.05);
//! let analysis = Analyzer::new(AnalysisSettings::default()).analyze(&record, &mesh);
//! let speed = analysis.shaft_speed.expect("the mesh is in the record");
//! assert!((speed.shaft_speed_hz - 25.0).abs() < 0.01);
//! let rms = analysis.indicators.get("rms").expect("every record has one");
//! assert!((rms - (0.5_f64 * 1.005).sqrt()).abs() < 1e-3);
//! # Ok::<(), flankwatch_signal::RecordError>(())
//! ```
//!
//! The only gear data used here are tooth counts and the shaft speed. Simulated and measured records take
//! the same code path. An analyzer transforms a record once, without a window; the Hann spectrum, the mesh
//! comb, all lines and the band envelopes come from those bins. Signals over the shaft angle
//! ([`AngleRecord`], [`GearSignals`]) need a resampling as well and are computed on request.
//! [`Analyzer::condition`] computes the indicators over time and over angle together.
//!
//! # Features
//! - `openapi`: implements `utoipa::ToSchema` for the result types.

mod acceleration;
mod analyzer;
mod angle_record;
#[cfg(test)]
mod any_samples;
mod band;
mod bearing;
mod bearing_lines;
mod by_name;
mod cepstrum;
mod checks;
mod comb;
mod comb_support;
mod condition;
mod either_gear;
mod envelope;
mod envelope_analysis;
mod faults;
mod features;
mod foreign_lines;
mod gear_analysis;
mod gear_indicators;
#[cfg(test)]
mod gear_reference;
mod gear_signals;
mod impacts;
mod indicator_names;
mod indicators;
mod interpolation;
mod kurtogram;
mod line;
mod mesh_comb;
mod mesh_context;
mod mesh_lines;
mod mesh_phase;
mod moments;
mod motion;
mod not_computed;
mod order_tracking;
mod other_meshes;
mod pchip;
mod phases;
mod record;
mod record_spectrum;
pub mod reduction;
#[cfg(test)]
mod reference;
mod resampling;
mod shaft_angle;
mod smeared_comb;
mod spectrum;
mod spectrum_lines;
mod speed;
mod speed_compensation;
mod speed_fluctuation;
mod sums;
mod tachometer_marks;
mod tooth_contrast;
mod tracked_harmonic;
mod transform;
mod turn_bins;
mod velocity;

pub use acceleration::unit_factor;
pub use analyzer::{Analysis, AnalysisSettings, Analyzer, Precision};
pub use angle_record::{AngleRecord, OrderSpectrum};
pub use band::{Band, BandQuantity, is_name};
pub use bearing::{Bearing, BearingLine, BearingOrders};
pub use bearing_lines::{EnvelopeLine, LineSource};
pub use by_name::{ByName, Name};
pub use cepstrum::Cepstrum;
pub use condition::{Basis, Condition, ConditionSettings, GEAR_PREPROCESSING};
pub use either_gear::{Gear, TurnAverage};
pub use envelope::{BandError, BandSource, EnvelopeBand, EnvelopeSearch};
pub use features::{Extent, Features, PREPROCESSING};
pub use gear_indicators::{AngleUsed, RunMean, RunMeans};
pub use gear_signals::GearSignals;
pub use impacts::BearingSettings;
pub use indicator_names::IndicatorScope;
pub use indicators::{INDICATORS, Indicators};
pub use kurtogram::{Kurtogram, KurtogramBand, KurtogramLevel};
pub use mesh_context::MeshContext;
pub use mesh_lines::MeshLine;
pub use motion::Motion;
pub use not_computed::NotComputed;
pub use other_meshes::{OtherMesh, OtherMeshes};
pub use record::{MAX_RECORD_SAMPLES, OperatingPoint, Quality, Record, RecordError, RecordOf, Tachometer};
pub use shaft_angle::{AngleSource, PulseError, ShaftAngle};
pub use spectrum::Spectrum;
pub use speed::{ShaftSpeed, SpeedDoubt, SpeedSource};
pub use velocity::VELOCITY_RMS;
