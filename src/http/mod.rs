//! The HTTP API and the dashboard.
//!
//! Routes stand on one page (`router`), one file a resource; a handler extracts, calls and renders. Everything that goes wrong is
//! answered as a problem (RFC 9457).

mod access;
mod alarms;
mod angle;
mod asset_metrics;
mod assets;
mod bare_refusals;
mod body;
mod category;
mod cepstra;
mod chosen;
mod coding;
mod connections;
mod dashboard;
mod events;
mod export;
mod freshness;
mod health;
mod indicators;
mod libraries;
mod library_states;
mod limits;
mod maintenance;
mod matching;
mod metrics;
mod openapi;
mod plotly;
mod problem;
mod provenance;
mod query;
mod rate;
mod recomputations;
mod reduction;
mod replays;
mod reports;
mod request_examples;
mod resumable;
mod router;
mod segments;
mod server;
mod shared_tokens;
mod table;
mod tokens;
mod traffic;
mod tus;
mod unread;
mod uploads;
mod waterfall;
mod waveforms;
mod wear;

pub use connections::TlsFiles;
pub use events::{SharedEvents, live_events, lost_events};
pub use health::HealthServer;
pub use limits::HttpLimits;
pub use plotly::plotly_js;
pub use server::{Node, RunningService, ServiceConfig, ServiceError, start, start_node};
pub use shared_tokens::SharedTokens;
pub use tokens::{Scope, Token, TokenError, Tokens};
