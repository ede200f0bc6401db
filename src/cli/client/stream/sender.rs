//! Sends blocks to the server, each in a request that is answered once the block is stored.

use std::time::Duration;

use jiff::Timestamp;
use serde::Deserialize;

use super::super::server::{ServerArgs, refusal};
use super::StreamArgs;
use super::spool::Block;
use crate::asset::AssetId;
use crate::cli::CliError;
use crate::cli::output::note;
use crate::recording::stream::StreamFormat;

/// First and longest wait before a block is sent again.
const FIRST_WAIT: Duration = Duration::from_millis(250);
const MAX_WAIT: Duration = Duration::from_secs(10);

/// Timeout of a request.
const TIMEOUT: Duration = Duration::from_secs(60);

/// Sends the blocks of one stream.
pub(super) struct Sender {
    server: ServerArgs,
    agent: ureq::Agent,
    /// URL that blocks are sent to.
    pub(super) url: String,
    name: String,
    /// The samples' format as URL query parameters.
    pub(super) format: String,
    frame_bytes: usize,
    /// Samples per channel that the server has stored.
    pub(super) sent: u64,
    /// Samples per channel that the server had already.
    pub(super) repeated: u64,
    /// Index that the server expects next, where it has said so.
    pub(super) next: Option<u64>,
    wait: Duration,
    is_behind: bool,
}

/// Outcome of sending a block.
pub(super) enum SendOutcome {
    /// The server has stored the block.
    Stored,
    /// The block must be sent again after this wait.
    RetryAfter(Duration),
}

#[derive(Deserialize)]
struct Answer {
    next: Option<u64>,
}

impl Sender {
    pub(super) fn new(args: &StreamArgs, asset: &AssetId, format: &StreamFormat) -> Result<Self, CliError> {
        let mut query = format!(
            "sample={}&sample_rate_hz={}&channels={}",
            format.sample().name(),
            format.sample_rate_hz(),
            format.channels()
        );
        let mut add = |name: &str, value: Option<String>| {
            if let Some(value) = value {
                query.push_str(&format!("&{name}={}", escaped(&value)));
            }
        };
        add("scale", args.scale.map(|scale| scale.to_string()));
        add("unit", args.unit.clone());
        add("channel_names", Some(args.channel_names.join(",")).filter(|names| !names.is_empty()));
        add("tachometer_channel", args.tachometer_channel.clone());
        add("tachometer_level", args.tachometer_level.map(|level| level.to_string()));
        add("tachometer_hysteresis", args.tachometer_hysteresis.map(|hysteresis| hysteresis.to_string()));
        add("pulses_per_revolution", args.pulses_per_revolution.map(|number| number.to_string()));
        Ok(Self {
            server: args.server.clone(),
            agent: args.server.agent(TIMEOUT)?,
            url: args.server.address(&format!("assets/{asset}/stream")),
            name: args.name.clone(),
            format: query,
            frame_bytes: format.frame_bytes(),
            sent: 0,
            repeated: 0,
            next: None,
            wait: FIRST_WAIT,
            is_behind: false,
        })
    }

    /// Returns the index that the server expects next; `None` if it has no such stream or is unreachable.
    ///
    /// # Errors
    /// The stream has another format.
    pub(super) fn server_next(&mut self) -> Result<Option<u64>, CliError> {
        let request = self.agent.get(format!("{}?name={}", self.url, escaped(&self.name)));
        let Ok(mut response) = self.server.authorized(request).call() else { return Ok(None) };
        let text = response.body_mut().read_to_string().unwrap_or_default();
        self.next = serde_json::from_str::<Answer>(&text).ok().and_then(|answer| answer.next);
        if self.next.is_some() {
            // The server compares the format of an empty part too, before any sample is skipped.
            let _ = self.post("", &[])?;
        }
        Ok(self.next)
    }

    /// Sends a block.
    ///
    /// # Errors
    /// The server rejects the block permanently.
    pub(super) fn send(&mut self, block: &Block) -> Result<SendOutcome, CliError> {
        let time = Timestamp::from_nanosecond(block.time_ns.into()).unwrap_or_default();
        // Blocks are sent in order, so samples missing before this one are lost.
        let place = format!("&first_index={}&start_time={time}&after_gap=true", block.first);
        let reason = match self.post(&place, &block.bytes)? {
            Ok(next) => {
                self.count(block.first, (block.bytes.len() / self.frame_bytes) as u64, next);
                self.wait = FIRST_WAIT;
                return Ok(SendOutcome::Stored);
            }
            Err(reason) => reason,
        };
        if !std::mem::replace(&mut self.is_behind, true) {
            note(&format!("failed to send, buffering samples: {reason}"));
        }
        let wait = self.wait;
        self.wait = (wait * 2).min(MAX_WAIT);
        Ok(SendOutcome::RetryAfter(wait))
    }

    /// Counts a block by the index that the server expects after it.
    fn count(&mut self, first: u64, frames: u64, next: Option<u64>) {
        let end = first + frames;
        let next = next.unwrap_or(end);
        // An answer may have been lost: a block sent again is stored, too.
        let stored = if next > end { 0 } else { end - self.next.unwrap_or(first).clamp(first, end) };
        self.sent += stored;
        self.repeated += frames - stored;
        self.next = Some(next);
    }

    /// Sends samples; returns the index that the server expects next, or why they must be sent again.
    fn post(&self, place: &str, samples: &[u8]) -> Result<Result<Option<u64>, String>, CliError> {
        let address = format!("{}?name={}&{}{place}", self.url, escaped(&self.name), self.format);
        let request = self.agent.post(address).content_type("application/octet-stream");
        let mut response = match self.server.authorized(request).send(samples) {
            Ok(response) => response,
            Err(error) => return Ok(Err(error.to_string())),
        };
        let status = response.status().as_u16();
        match (status, response.body_mut().read_to_string()) {
            (200, Ok(text)) => {
                Ok(Ok(serde_json::from_str::<Answer>(&text).ok().and_then(|answer| answer.next)))
            }
            (200, Err(error)) => Ok(Err(error.to_string())),
            (408 | 429 | 500 | 502 | 503 | 504 | 507, text) => {
                Ok(Err(refusal(status, &text.unwrap_or_default())))
            }
            (_, text) => {
                let reason = refusal(status, &text.unwrap_or_default());
                Err(CliError::Server { url: self.url.clone(), reason })
            }
        }
    }

    /// Whether sending has failed since the sender last caught up.
    pub(super) fn is_behind(&self) -> bool {
        self.is_behind
    }

    /// Notes that everything read so far is sent.
    pub(super) fn caught_up(&mut self) {
        self.is_behind = false;
        note("sent all buffered samples");
    }
}

/// Percent-encodes a value for a URL query.
fn escaped(value: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.,~".contains(&byte);
    let escape = |byte: u8| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    value.bytes().map(escape).collect()
}
