//! Condition monitoring for spur gears: estimates the wear depth, with an interval, from vibration records.
//!
//! This package is the service and the command line. The computations are in packages of their own, which it
//! re-exports:
//!
//! | package | module | contents |
//! | --- | --- | --- |
//! | `flankwatch-gear` | [`gear`] | the physics of one gear pair: geometry, wear, mesh relationship, stiffness, dynamics |
//! | `flankwatch-signal` | [`signal`] | a validated record, its spectra, indicators and features |
//! | `flankwatch-recording` | [`recording`] | encoding and decoding of records: WAV, MCAP, CSV, NumPy arrays,
//! protobuf, JSON |
//! | `flankwatch-wear` | [`library`] | the grid of simulated wear states |
//! | | [`simulation`] | synthetic run-to-failure data with known wear |
//! | | [`estimate`] | the healthy baseline, the likelihood and the tracking of wear over time |
//! | `flankwatch-lab` | [`figures`] | the figures of the model beside those of the paper it follows, with
//! checks |
//! | | [`evaluation`] | the accuracy of the estimate on simulated runs |
//!
//! The modules of this package; each depends only on those above it:
//!
//! | module | contents |
//! | --- | --- |
//! | [`asset`] | the description of a monitored asset, and one analysed segment of its vibration |
//! | [`report`] | an asset's records on one page, for a browser or a printer |
//! | [`store`] | the database and the raw objects: the only SQL and the only object paths |
//! | [`service`] | the record pipeline, channel histories, replays, streams and background work |
//! | [`http`] | the API and the dashboard |
//! | `cluster` | the queue and events of a service on several machines (features `postgres`, `nats`) |
//! | `mqtt` | records from an MQTT broker (feature `mqtt`) |
//! | [`notifications`] | webhooks and e-mails about alarms |
//! | [`cli`] | the commands |

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
pub mod store;

pub use flankwatch_gear as gear;
pub use flankwatch_lab::{evaluation, figures};
pub use flankwatch_recording as recording;
pub use flankwatch_signal as signal;
pub use flankwatch_wear::{estimate, library, simulation};
