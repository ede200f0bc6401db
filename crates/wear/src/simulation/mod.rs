//! Synthetic runs to failure: the gear model's vibration of a wearing pair, through a random transmission
//! path and with sensor noise, with known true wear. For demonstrations, tests and evaluations.

mod path;
mod run;

pub use path::TransmissionPath;
pub use run::{Run, RunPlan, SimulatedRecord, SimulationError};
