//! Wear of spur gears from vibration: libraries of simulated wear states, simulated runs to failure, and the
//! estimate over time.
//!
//! - [`library::Library`]: what wear does to a pair's vibration, simulated once; an
//!   [`Ensemble`](library::Ensemble) adds what is not known of the pair;
//! - [`simulation::Run`]: a run to failure through an unknown transmission path, with the true wear known;
//! - [`estimate::Tracker`]: a fold over a machine's features in time order;
//!   [`WearEstimate`](estimate::WearEstimate) is its answer;
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
//! Everything is a function of what goes in: no clock, no environment, no chance without a seed.
//!
//! # Features
//! - `files`: libraries kept in a folder under the hash of what they depend on; without it nothing here opens
//!   a file.
//! - `openapi`: `utoipa::ToSchema` for estimates and alarms.

pub mod estimate;
pub mod library;
pub mod simulation;
