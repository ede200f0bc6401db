//! The HTTP API and the dashboard.
//!
//! Routes stand on one page (`router`), one file a resource; a handler extracts, calls and renders. Everything that goes wrong is
//! answered as a problem (RFC 9457).

mod access;
mod alarms;
mod angle;
mod app;
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
mod event_ring;
mod events;
mod export;
mod freshness;
mod health;
mod indicators;
mod libraries;
mod library_states;
mod limits;
mod line_cache;
mod maintenance;
mod matching;
mod measurements;
mod metrics;
mod metrics_text;
mod openapi;
mod plotly;
mod problem;
mod provenance;
mod query;
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
mod start_error;
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
pub use event_ring::SharedEvents;
pub use health::HealthServer;
pub use limits::HttpLimits;
pub use plotly::plotly_js;
pub use server::{Node, RunningService, ServiceConfig, start, start_node};
pub use shared_tokens::SharedTokens;
pub use start_error::StartError;
pub use tokens::{Scope, Token, TokenError, Tokens};
