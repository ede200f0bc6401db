//! From features to wear: the healthy baseline, the likelihood of each library state, and the tracking of wear over time.
//!
//! Everything here is pure and deterministic: an estimate is a fold over an asset's features in time order.

mod wear;

pub use wear::{BaselineProgress, BestState, Posterior, WearEstimate, WearStatus};
