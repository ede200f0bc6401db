//! Engines beyond one machine (feature `cluster`).

pub mod mqtt;
