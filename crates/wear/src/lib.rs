//! Wear of spur gears from vibration: libraries of simulated wear states, simulated runs to failure, and the estimate over time.
//!
//! | module | holds |
//! | --- | --- |
//! | [`library`] | the grid of simulated wear states |
//! | [`simulation`] | a synthetic run to failure with the truth known |
//! | [`estimate`] | the healthy baseline, the likelihood and the tracking of wear over time; alarms |

pub mod estimate;
pub mod library;
pub mod simulation;
