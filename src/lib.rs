//! Condition monitoring for spur gears: vibration records in, wear depth with an honest interval out.
//!
//! This is the service and the commands. What they compute with are packages of their own:
//!
//! | package | here | holds |
//! | --- | --- | --- |
//! | `flankwatch-gear` | [`gear`] | the physics of one gear pair: geometry, wear, mesh relationship, stiffness, dynamics |
//! | `flankwatch-signal` | [`signal`] | a validated record, its spectra, indicators and features |
//! | `flankwatch-recording` | [`recording`] | bytes to records and back: WAV, MCAP, CSV, NumPy arrays, protobuf, JSON |
//! | `flankwatch-wear` | [`library`] | the grid of simulated wear states |
//! | | [`simulation`] | a synthetic run to failure with the truth known |
//! | | [`estimate`] | the healthy baseline, the likelihood and the tracking of wear over time |
//! | `flankwatch-lab` | [`figures`] | the model's figures beside those of the paper it follows, with checks |
//! | | [`evaluation`] | what the estimate is worth on simulated runs |
//!
//! The modules of this package, each of which knows only those above it:
//!
//! | module | holds |
//! | --- | --- |
//! | [`asset`] | what is monitored, and one analysed segment of its vibration |
//! | [`report`] | an asset's records on one page, for a browser or a printer |
//! | [`store`] | the only SQL and the only raw-object paths |
//! | [`service`] | the way of records, histories, replays, and what else works on records |
//! | [`http`] | the API and the dashboard |
//! | `cluster` | what joins the processes of a service on several machines (features `postgres`, `nats`) |
//! | `mqtt` | records from an MQTT broker (feature `mqtt`) |
//! | [`notifications`] | webhooks and e-mails that tell of alarms |
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
