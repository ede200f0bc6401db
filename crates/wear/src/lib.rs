//! Wear of spur gears from vibration: libraries of simulated wear states, simulated runs to failure, and wear
//! estimates over time.
//!
//! - [`library::Library`]: the effect of wear on a pair's vibration, simulated once. An
//!   [`Ensemble`](library::Ensemble) adds variants of the pair, for the properties that are not known;
//! - [`simulation::Run`]: a run to failure through an unknown transmission path, with known true wear;
//! - [`estimate::Tracker`]: a fold over a machine's features in time order, which returns a
//!   [`WearEstimate`](estimate::WearEstimate) for each record;
//! - [`estimate::AlarmPanel`]: alarms on indicators and wear.
//!
//! ```
//! use std::sync::Arc;
//!
//! use flankwatch_gear::PairSpec;
//! use flankwatch_wear::estimate::{EstimatorSettings, Tracker, WearStatus};
//! use flankwatch_wear::library::{BuildControl, Ensemble, GridSettings, build};
//! use jiff::Timestamp;
//!
//! let pair = PairSpec::from_toml(
//!     "
//!     [geometry]
//!     teeth = [24, 26]              # driving, driven
//!     module_mm = 6.0
//!     face_width_mm = 50.0
//!     bore_radius_mm = [20.0, 20.0]
//!     centre_distance_mm = 150.0
//!
//!     [operation]
//!     torque_nm = 1300.0
//!     shaft_speed_hz = 16.64
//! ",
//! )?;
//!
//! // Five wear states from 0 to 200 µm.
//! let grid = GridSettings { states: 5, max_wear_um: 200.0, seconds: 0.5, ..GridSettings::default() };
//! let library = Arc::new(build(&pair, &grid, &BuildControl::silent())?);
//! let healthy = library.states()[0].features.clone();
//!
//! let settings = EstimatorSettings { baseline_records: 3, limit_um: None };
//! let tracker = Tracker::new(settings, Some(Arc::new(Ensemble::of(library))));
//! let mut state = tracker.start();
//! let estimate = tracker.update(&mut state, Timestamp::UNIX_EPOCH, &healthy);
//! assert_eq!(estimate.status, WearStatus::CollectingBaseline);
//! assert_eq!((estimate.baseline.have, estimate.baseline.need), (1, 3));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Results depend on the inputs alone: no clock or environment is read; random numbers are seeded.
//!
//! # Features
//! - `files`: caches libraries in a folder under the hash of their inputs; without it, the crate opens no files.
//! - `openapi`: `utoipa::ToSchema` for estimates and alarms.

pub mod estimate;
pub mod library;
pub mod simulation;
