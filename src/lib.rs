//! Condition monitoring for spur gears: estimates the wear depth, with an interval, from vibration records.
//!
//! This package is the service and the command line. The computations are in packages of their own:
//!
//! | package | re-exported as | contents |
//! | --- | --- | --- |
//! | `flankwatch-gear` | [`gear`] | the physics of one gear pair: geometry, wear, mesh relationship, stiffness, dynamics |
//! | `flankwatch-signal` | [`signal`] | a validated record, its spectra, indicators and features |
//! | `flankwatch-recording` | [`recording`] | encoding and decoding of records: WAV, MCAP, CSV, NumPy arrays,
//! protobuf, JSON |
//! | `flankwatch-wear` | [`library`] | the grid of simulated wear states |
//! | | [`simulation`] | a synthetic run to failure with known wear |
//! | | [`estimate`] | the healthy baseline, the likelihood and the tracking of wear over time |
//! | `flankwatch-lab` | [`figures`] | the figures of the model's paper, with checks of its statements |
//! | | [`evaluation`] | scores of the estimate on simulated runs |
//!
//! The modules of this package; each uses only modules above it:
//!
//! | module | contents |
//! | --- | --- |
//! | [`settings`] | what settings of all modules share |
//! | [`asset`] | the description of a monitored asset, and an analysed segment of its vibration |
//! | [`report`] | an asset's HTML report |
//! | [`store`] | database and raw-object storage: the only SQL and the only raw-object paths |
//! | [`service`] | the record pipeline, histories, replays and other work on records |
//! | [`http`] | the API and the dashboard |
//! | `cluster` | one service on several machines (features `postgres`, `nats`) |
//! | `mqtt` | records from an MQTT broker (feature `mqtt`) |
//! | [`notifications`] | notifications of alarms by webhook and e-mail |
//! | [`cli`] | the command-line interface |

pub mod asset;
pub mod cli;
#[cfg(feature = "postgres")]
pub mod cluster;
pub mod http;
#[cfg(feature = "mqtt")]
pub mod mqtt;
pub mod notifications;
pub mod report;
pub mod service;
pub mod settings;
pub mod store;

pub use flankwatch_gear as gear;
pub use flankwatch_lab::{evaluation, figures};
pub use flankwatch_recording as recording;
pub use flankwatch_signal as signal;
pub use flankwatch_wear::{estimate, library, simulation};
