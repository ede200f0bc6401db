//! The HTTP API and the dashboard.
//!
//! Routes stand on one page (`router`), one file a resource; a handler extracts, calls and renders. Everything that goes wrong is
//! answered as a problem (RFC 9457).

mod assets;
mod body;
mod dashboard;
mod health;
mod indicators;
mod libraries;
mod limits;
mod metrics;
mod plotly;
mod problem;
mod query;
mod reduction;
mod replays;
mod router;
mod segments;
mod server;
mod traffic;
mod waveforms;
mod wear;

pub use limits::HttpLimits;
pub use plotly::plotly_js;
pub use server::{RunningService, ServiceConfig, ServiceError, start};
