//! Condition monitoring for spur gears: vibration records in, wear depth with an honest interval out.
//!
//! One record's journey goes through the rooms in this order; a room knows only those above it:
//!
//! | room | holds |
//! | --- | --- |
//! | [`gear`] | the physics of one gear pair: geometry, wear, mesh relationship, stiffness, dynamics |
//! | [`signal`] | a validated record, its spectra, indicators and features |
//! | [`library`] | the grid of simulated wear states |
//! | [`figures`] | the model's figures beside those of the paper it follows, with checks |
//! | [`simulation`] | a synthetic run to failure with the truth known |
//! | [`estimate`] | the healthy baseline, the likelihood and the tracking of wear over time |
//! | [`evaluation`] | what the estimate is worth on simulated runs |
//! | [`recording`] | bytes to records and back: WAV, MCAP, CSV, protobuf, JSON |
//! | [`asset`] | what is monitored, and one analysed segment of its vibration |
//! | [`report`] | an asset's records on one page, for a browser or a printer |
//! | [`store`] | the only SQL and the only raw-object paths |
//! | [`service`] | the way of records, histories, replays, and what else works on records |
//! | `cluster` | what joins the processes of a service on several machines (feature `cluster`) |
//! | [`http`] | the API and the dashboard |
//! | `cluster` | engines beyond one machine (feature `cluster`) |
//! | [`cli`] | the commands |

pub mod asset;
pub mod cli;
#[cfg(feature = "cluster")]
pub mod cluster;
pub mod estimate;
pub mod evaluation;
pub mod figures;
pub mod gear;
pub mod http;

pub mod library;
pub mod recording;
pub mod report;
pub mod service;
pub mod signal;
pub mod simulation;
pub mod store;
