//! Signal processing: a validated [`Record`] becomes spectra, [`Indicators`] and [`Features`].
//!
//! Knows nothing of gears beyond tooth numbers and shaft speed; simulated and measured records go through the same code.

mod features;
mod indicators;
mod record;
mod speed;

pub use features::Features;
pub use indicators::{Absence, Indicators};
pub use record::{MAX_RECORD_SAMPLES, OperatingPoint, Record, RecordError};
pub use speed::{MeshContext, ShaftSpeed, SpeedSource};
