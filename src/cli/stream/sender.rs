//! Blocks sent to the server, each in a request that is answered when it is kept.

use std::time::Duration;

use jiff::Timestamp;
use serde::Deserialize;
use ureq::tls::TlsConfig;

use super::super::CliError;
use super::super::replay::trusted;
use super::StreamArgs;
use super::spool::Block;
use crate::asset::AssetId;
use crate::recording::stream::StreamFormat;

/// Wait before a block is sent again, and the longest one.
const FIRST_WAIT: Duration = Duration::from_millis(250);
const MAX_WAIT: Duration = Duration::from_secs(10);

/// How long one request may take.
const TIMEOUT: Duration = Duration::from_secs(60);

/// Sends the blocks of one stream.
pub(super) struct Sender {
    agent: ureq::Agent,
    token: Option<String>,
    /// Where it sends to.
    pub(super) url: String,
    name: String,
    /// The samples' format as it stands in the address.
    pub(super) format: String,
    frame_bytes: usize,
    /// Samples of each channel that are kept.
    pub(super) sent: u64,
    wait: Duration,
    was_away: bool,
}

/// What became of a block.
pub(super) enum Sent {
    /// The server keeps it.
    Kept,
    /// It is to be sent again, after a while.
    Later(Duration),
}

#[derive(Deserialize)]
struct Answer {
    next: Option<u64>,
}

impl Sender {
    pub(super) fn new(args: &StreamArgs, asset: &AssetId, format: &StreamFormat) -> Result<Self, CliError> {
        let agent = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .timeout_global(Some(TIMEOUT))
            .tls_config(TlsConfig::builder().root_certs(trusted(args.ca.as_deref())?).build())
            .build();
        let mut described = format!(
            "sample={}&sample_rate_hz={}&channels={}",
            format.sample().name(),
            format.sample_rate_hz(),
            format.channels()
        );
        let mut add = |name: &str, value: Option<String>| {
            if let Some(value) = value {
                described.push_str(&format!("&{name}={}", escaped(&value)));
            }
        };
        add("scale", args.scale.map(|scale| scale.to_string()));
        add("unit", args.unit.clone());
        add("channel_names", Some(args.channel_names.join(",")).filter(|names| !names.is_empty()));
        Ok(Self {
            agent: agent.into(),
            token: args.token.clone().or_else(|| std::env::var("FLANKWATCH_TOKEN").ok()),
            url: format!("{}/v1/assets/{asset}/stream", args.url.trim_end_matches('/')),
            name: args.name.clone(),
            format: described,
            frame_bytes: format.frame_bytes(),
            sent: 0,
            wait: FIRST_WAIT,
            was_away: false,
        })
    }

    /// The index that the server goes on with; none where it has no such stream or is away.
    pub(super) fn server_next(&self) -> Option<u64> {
        let request = self.agent.get(format!("{}?name={}", self.url, escaped(&self.name)));
        let mut response = self.authorized(request).call().ok()?;
        let text = response.body_mut().read_to_string().ok()?;
        serde_json::from_str::<Answer>(&text).ok()?.next
    }

    /// Sends a block.
    ///
    /// # Errors
    /// The server refuses it for good.
    pub(super) fn send(&mut self, block: &Block) -> Result<Sent, CliError> {
        let time = Timestamp::from_nanosecond(block.time_ns.into()).unwrap_or_default();
        // Blocks come in their order: what is missing before this one is lost.
        let address = format!(
            "{}?name={}&{}&first_index={}&start_time={time}&after_gap=true",
            self.url,
            escaped(&self.name),
            self.format,
            block.first,
        );
        let request = self.agent.post(address).content_type("application/octet-stream");
        let reason = match self.authorized(request).send(&block.bytes[..]) {
            Ok(mut response) => {
                let status = response.status().as_u16();
                let text = response.body_mut().read_to_string();
                match (status, text) {
                    (200, Ok(_)) => {
                        self.sent += (block.bytes.len() / self.frame_bytes) as u64;
                        self.wait = FIRST_WAIT;
                        return Ok(Sent::Kept);
                    }
                    (200, Err(error)) => error.to_string(),
                    (408 | 429 | 500 | 502 | 503 | 504 | 507, text) => {
                        format!("the server answered {status}: {}", text.unwrap_or_default())
                    }
                    (_, text) => {
                        let reason = format!("the server answered {status}: {}", text.unwrap_or_default());
                        return Err(CliError::Server { url: self.url.clone(), reason });
                    }
                }
            }
            Err(error) => error.to_string(),
        };
        if !std::mem::replace(&mut self.was_away, true) {
            eprintln!("cannot send now, samples are kept here: {reason}");
        }
        let wait = self.wait;
        self.wait = (wait * 2).min(MAX_WAIT);
        Ok(Sent::Later(wait))
    }

    /// Whether samples could not be sent before.
    pub(super) fn was_away(&self) -> bool {
        self.was_away
    }

    /// Everything that was read is sent.
    pub(super) fn caught_up(&mut self) {
        self.was_away = false;
        eprintln!("all samples that waited are sent");
    }

    fn authorized<B>(&self, request: ureq::RequestBuilder<B>) -> ureq::RequestBuilder<B> {
        match &self.token {
            Some(token) => request.header("authorization", format!("Bearer {token}")),
            None => request,
        }
    }
}

/// A value as it may stand in an address.
fn escaped(value: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.,~".contains(&byte);
    let escape = |byte: u8| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    value.bytes().map(escape).collect()
}
