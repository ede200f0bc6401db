//! The HTTP API and the dashboard.
//!
//! All routes are in `router`, one file per resource; a handler extracts, calls and renders. Every error is
//! returned as a problem (RFC 9457).

mod access;
mod alarms;
mod app;
mod assets;
mod baseline;
mod damage;
mod dashboard;
mod events;
mod export;
mod health;
mod indicators;
mod libraries;
mod metrics;
mod notifications;
mod openapi;
mod pair_presets;
mod plotly;
mod preview;
mod problem;
mod recomputations;
mod replays;
mod reports;
mod request;
mod router;
mod segments;
mod server;
mod spectra;
mod streams;
mod table;
mod uploads;
mod wear;

pub use access::token_error::TokenError;
pub use access::tokens::Tokens;
pub use health::HealthServer;
pub use metrics::queue::queue_metrics;
pub use plotly::plotly_js;
pub use server::connections::TlsFiles;
pub use server::limits::HttpLimits;
pub use server::start_error::StartError;
pub use server::{Node, RunningService, ServiceConfig, start, start_node, start_on};
pub(crate) use table::{CHANNEL, PARQUET, REDUCED, ROWS};
