//! Limits of the API: the cost of a single request.

use std::num::NonZeroU32;
use std::time::Duration;

/// Limits on requests.
#[derive(Debug, Clone)]
pub struct HttpLimits {
    /// Bytes of a record's body.
    pub record_bytes: usize,
    /// Bytes of a recording's body, which holds many records and is spooled to a file instead of memory.
    pub recording_bytes: u64,
    /// Unfinished resumable uploads; in a cluster of all nodes together.
    pub uploads_at_once: u32,
    /// Bytes of any other body.
    pub description_bytes: usize,
    /// Concurrent connections; of further ones, only health checks are answered.
    pub connections: usize,
    /// Bytes of a request's line and header fields.
    pub header_bytes: usize,
    /// Time to send a request's head, and time that a connection may stay idle.
    pub header_timeout: Duration,
    /// Time that a client may stop reading its response.
    pub write_timeout: Duration,
    /// Requests per second and token.
    pub requests_per_s: NonZeroU32,
    /// Events kept for clients that reconnect.
    pub events_kept: usize,
    /// Time for a body to arrive.
    pub body_timeout: Duration,
    /// Time without any bytes of a body.
    pub body_idle: Duration,
    /// Minimum rate of a body in bytes per second once it takes longer than `body_idle`.
    pub body_bytes_per_s: u64,
    /// Time to process a request once its body has arrived.
    pub request_timeout: Duration,
    /// Time to finish running work when the service is stopped.
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
            events_kept: 4096,
            body_timeout: Duration::from_secs(300),
            body_idle: Duration::from_secs(20),
            body_bytes_per_s: 1024,
            request_timeout: Duration::from_secs(150),
            grace: Duration::from_secs(10),
        }
    }
}
