//! What one request may cost: the one place where the API's limits stand.

use std::num::NonZeroU32;
use std::time::Duration;

/// Limits on requests.
#[derive(Debug, Clone)]
pub struct HttpLimits {
    /// Bytes of a record's body.
    pub record_bytes: usize,
    /// Bytes of a recording's body (many records; it is read from a file, not held in memory).
    pub recording_bytes: u64,
    /// Resumable uploads under way: begun, and neither read nor given up. In a cluster those of all nodes.
    pub uploads_at_once: u32,
    /// Bytes of any other body.
    pub description_bytes: usize,
    /// Connections at once; further ones wait in the system's queue.
    pub connections: usize,
    /// Bytes of a request's line and header fields.
    pub header_bytes: usize,
    /// How long a client may take to send its request's head, and may keep a connection without asking
    /// anything.
    pub header_timeout: Duration,
    /// How long a client may read nothing of its answer.
    pub write_timeout: Duration,
    /// Requests a second with one token.
    pub requests_per_s: NonZeroU32,
    /// Live streams that are sent at once.
    pub streams: usize,
    /// Events that are kept for clients that lost their connection.
    pub events_kept: usize,
    /// How long a body may take to arrive.
    pub body_timeout: Duration,
    /// How long nothing of a body may come.
    pub body_idle: Duration,
    /// Bytes a second with which a body has to come once it takes longer than that.
    pub body_bytes_per_s: u64,
    /// How long a request may take once its body is there.
    pub request_timeout: Duration,
    /// How long the service takes to end what it has begun when it is stopped.
    pub grace: Duration,
}

impl Default for HttpLimits {
    fn default() -> Self {
        Self {
            record_bytes: 256 << 20,
            recording_bytes: 4 << 30,
            uploads_at_once: 256,
            description_bytes: 1 << 20,
            connections: 1024,
            header_bytes: 32 << 10,
            header_timeout: Duration::from_secs(30),
            write_timeout: Duration::from_secs(60),
            requests_per_s: NonZeroU32::new(2000).unwrap_or(NonZeroU32::MIN),
            streams: 64,
            events_kept: 4096,
            body_timeout: Duration::from_secs(300),
            body_idle: Duration::from_secs(20),
            body_bytes_per_s: 1024,
            request_timeout: Duration::from_secs(150),
            grace: Duration::from_secs(10),
        }
    }
}
