//! From features to wear: the healthy baseline, the likelihood of each wear depth, and the tracking of wear over time.
//!
//! Everything here is pure and deterministic: an estimate is a fold over an asset's features in time order. Features enter
//! relative to the asset's own healthy baseline, so that an unknown linear transmission path cancels.

mod baseline;
mod depth_grid;
mod likelihood;
mod shape_spread;
mod tracker;
mod transition;
mod wear;

pub use tracker::{EstimatorSettings, METHOD, Tracker, TrackerState};
pub use wear::{BaselineProgress, BestState, Posterior, WearEstimate, WearStatus};
