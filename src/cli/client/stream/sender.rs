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
            wait: FIRST_WAIT,
            is_behind: false,
        })
    }

    /// Returns the index that the server expects next; `None` if it has no such stream or is unreachable.
    pub(super) fn server_next(&self) -> Option<u64> {
        let request = self.agent.get(format!("{}?name={}", self.url, escaped(&self.name)));
        let mut response = self.server.authorized(request).call().ok()?;
        let text = response.body_mut().read_to_string().ok()?;
        serde_json::from_str::<Answer>(&text).ok()?.next
    }

    /// Sends a block.
    ///
    /// # Errors
    /// The server rejects the block permanently.
    pub(super) fn send(&mut self, block: &Block) -> Result<SendOutcome, CliError> {
        let time = Timestamp::from_nanosecond(block.time_ns.into()).unwrap_or_default();
        // Blocks are sent in order, so samples missing before this one are lost.
        let address = format!(
            "{}?name={}&{}&first_index={}&start_time={time}&after_gap=true",
            self.url,
            escaped(&self.name),
            self.format,
            block.first,
        );
        let request = self.agent.post(address).content_type("application/octet-stream");
        let reason = match self.server.authorized(request).send(&block.bytes[..]) {
            Ok(mut response) => {
                let status = response.status().as_u16();
                let text = response.body_mut().read_to_string();
                match (status, text) {
                    (200, Ok(_)) => {
                        self.sent += (block.bytes.len() / self.frame_bytes) as u64;
                        self.wait = FIRST_WAIT;
                        return Ok(SendOutcome::Stored);
                    }
                    (200, Err(error)) => error.to_string(),
                    (408 | 429 | 500 | 502 | 503 | 504 | 507, text) => {
                        refusal(status, &text.unwrap_or_default())
                    }
                    (_, text) => {
                        let reason = refusal(status, &text.unwrap_or_default());
                        return Err(CliError::Server { url: self.url.clone(), reason });
                    }
                }
            }
            Err(error) => error.to_string(),
        };
        if !std::mem::replace(&mut self.is_behind, true) {
            note(&format!("failed to send, buffering samples: {reason}"));
        }
        let wait = self.wait;
        self.wait = (wait * 2).min(MAX_WAIT);
        Ok(SendOutcome::RetryAfter(wait))
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
