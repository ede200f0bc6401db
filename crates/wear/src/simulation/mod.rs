//! A synthetic run to failure: the gear model's vibration of a wearing pair, seen through a random
//! transmission path with sensor noise, with the true wear known. For demonstrations, tests and evaluations.

mod path;
mod run;

pub use path::TransmissionPath;
pub use run::{Run, RunPlan, SimulatedRecord, SimulationError};
