//! Sends blocks to the server, each in a request that is answered once the block is stored.

use std::thread;
use std::time::{Duration, Instant};

use jiff::Timestamp;
use serde::Deserialize;

use super::super::server::{ServerArgs, failure, refusal};
use super::spool::Block;
use super::{POLL_INTERVAL, StreamArgs};
use crate::asset::AssetId;
use crate::cli::CliError;
use crate::cli::output::{counted, print_stderr};
use crate::recording::stream::StreamFormat;

/// First and longest wait before a block is sent again.
const FIRST_WAIT: Duration = Duration::from_millis(250);
const MAX_WAIT: Duration = Duration::from_secs(10);

/// Timeout of a request.
const TIMEOUT: Duration = Duration::from_secs(60);

/// Longest wait at the end for records that are not stored yet.
const STORING_TIMEOUT: Duration = Duration::from_secs(5);

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
    /// Index before which the server had the samples when it answered first.
    had_to: Option<u64>,
    /// Index before which a request without a response may have stored the samples.
    tried_to: u64,
    /// Records that were refused before.
    refused_before: Option<u64>,
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
struct SendResponse {
    next: Option<u64>,
    /// Samples of the request that the stream had passed before.
    repeated: u64,
}

/// The records of a stream.
#[derive(Default, Deserialize)]
struct Status {
    records_refused: u64,
    last_refusal: Option<String>,
    records_waiting: u64,
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
            had_to: None,
            tried_to: 0,
            refused_before: None,
            wait: FIRST_WAIT,
            is_behind: false,
        })
    }

    /// Takes over the stream; returns the index that the server expects next, `None` if it has no such stream
    /// or is unreachable.
    ///
    /// # Errors
    /// The server refuses the stream or its format.
    pub(super) fn open(&mut self) -> Result<Option<u64>, CliError> {
        self.refused_before = self.status().map(|status| status.records_refused);
        // An empty part is checked like any other. From its response on, no earlier request stores samples.
        if let Ok(response) = self.post("", &[])? {
            self.next = response.next;
            self.had_to = Some(response.next.unwrap_or(0));
        }
        Ok(self.next)
    }

    /// The records of the stream; `None` if the server is unreachable.
    fn status(&self) -> Option<Status> {
        let request = self.agent.get(format!("{}?name={}", self.url, escaped(&self.name)));
        let mut response = self.server.authorized(request).call().ok()?;
        match response.status().as_u16() {
            404 => Some(Status::default()),
            _ => serde_json::from_str(&response.body_mut().read_to_string().ok()?).ok(),
        }
    }

    /// Returns how many records were refused since the stream was opened, and why; `None` without any.
    pub(super) fn refused(&self) -> Option<String> {
        let (before, began) = (self.refused_before?, Instant::now());
        let mut status = self.status()?;
        while status.records_waiting > 0 && began.elapsed() < STORING_TIMEOUT {
            thread::sleep(POLL_INTERVAL);
            status = self.status()?;
        }
        let refused = status.records_refused.saturating_sub(before);
        let reason = status.last_refusal.unwrap_or_default();
        (refused > 0)
            .then(|| format!("{} refused, the last one because {reason}", counted(refused, "record")))
    }

    /// Sends a block.
    ///
    /// # Errors
    /// The server rejects the block permanently, or has passed it since it answered first.
    pub(super) fn send(&mut self, block: &Block) -> Result<SendOutcome, CliError> {
        let time = Timestamp::from_nanosecond(block.time_ns.into()).unwrap_or_default();
        // Blocks are sent in order, so samples missing before this one are lost.
        let place = format!("&first_index={}&start_time={time}&after_gap=true", block.first);
        let frames = (block.bytes.len() / self.frame_bytes) as u64;
        let reason = match self.post(&place, &block.bytes)? {
            Ok(response) => {
                let lost = self.count(block.first, frames, &response);
                if lost > 0 {
                    let reason = format!(
                        "{lost} samples of each channel at {time} are not stored: another sender sends stream \
                         {}, or the stream has passed this time; expected one sender of a stream (see --name)",
                        self.name
                    );
                    return Err(self.failed(reason));
                }
                self.wait = FIRST_WAIT;
                return Ok(SendOutcome::Stored);
            }
            Err(reason) => reason,
        };
        self.tried_to = block.first + frames;
        if !std::mem::replace(&mut self.is_behind, true) {
            print_stderr(&format!("failed to send, buffering samples: {reason}"));
        }
        let wait = self.wait;
        self.wait = (wait * 2).min(MAX_WAIT);
        Ok(SendOutcome::RetryAfter(wait))
    }

    /// Counts the samples of a block; returns how many the server had, although it did not have them when it
    /// answered first and no request without a response had them.
    fn count(&mut self, first: u64, frames: u64, response: &SendResponse) -> u64 {
        let (repeated, next) = (response.repeated.min(frames), response.next.unwrap_or(first + frames));
        let had_to = if repeated == frames { next } else { first + repeated };
        let had_to = *self.had_to.get_or_insert(had_to);
        let had = repeated.min(had_to.saturating_sub(first));
        let lost = (first + repeated).saturating_sub(had_to.max(self.tried_to).max(first));
        self.sent += frames - had - lost;
        self.repeated += had;
        self.next = Some(next);
        lost
    }

    /// Sends samples; returns the response, or why they must be sent again.
    fn post(&self, place: &str, samples: &[u8]) -> Result<Result<SendResponse, String>, CliError> {
        let address = format!("{}?name={}&{}{place}", self.url, escaped(&self.name), self.format);
        let request = self.agent.post(address).content_type("application/octet-stream");
        let mut response = match self.server.authorized(request).send(samples) {
            Ok(response) => response,
            Err(error) => {
                let (reason, may_pass) = failure(&error);
                return if may_pass { Ok(Err(reason)) } else { Err(self.failed(reason)) };
            }
        };
        let status = response.status().as_u16();
        match (status, response.body_mut().read_to_string()) {
            (200, Ok(text)) => match serde_json::from_str(&text) {
                Ok(response) => Ok(Ok(response)),
                Err(error) => Err(self.failed(format!("invalid answer: {error}"))),
            },
            (200, Err(error)) => Ok(Err(error.to_string())),
            (408 | 429 | 500 | 502 | 503 | 504 | 507, text) => {
                Ok(Err(refusal(status, &text.unwrap_or_default())))
            }
            (_, text) => Err(self.failed(refusal(status, &text.unwrap_or_default()))),
        }
    }

    /// The error for a reason why the server does not store the samples.
    pub(super) fn failed(&self, reason: String) -> CliError {
        CliError::Server { url: self.url.clone(), reason }
    }

    /// Whether sending has failed since the sender last caught up.
    pub(super) fn is_behind(&self) -> bool {
        self.is_behind
    }

    /// Records that everything read so far is sent.
    pub(super) fn caught_up(&mut self) {
        self.is_behind = false;
        print_stderr("sent all buffered samples");
    }
}

/// Percent-encodes a value for a URL query.
fn escaped(value: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.,~".contains(&byte);
    let escape = |byte: u8| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    value.bytes().map(escape).collect()
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::recording::RawSample;

    #[derive(Parser)]
    struct Words {
        #[command(flatten)]
        args: StreamArgs,
    }

    fn sender() -> Sender {
        let args = Words::parse_from(["stream", "--asset", "pump"]).args;
        let format = StreamFormat::new(RawSample::F32, 1000.0, 1, None).unwrap();
        Sender::new(&args, &AssetId::new("pump").unwrap(), &format).unwrap()
    }

    #[test]
    fn samples_that_another_sender_sent_are_not_counted_as_repeated() {
        let response = |next, repeated| SendResponse { next: Some(next), repeated };
        let mut sender = Sender { had_to: Some(150), ..sender() };
        // What the server had at the start; new ones; what an attempt without a response stored.
        assert_eq!(sender.count(100, 100, &response(200, 50)), 0);
        assert_eq!(sender.count(200, 100, &response(300, 0)), 0);
        sender.tried_to = 400;
        assert_eq!(sender.count(300, 100, &response(400, 100)), 0);
        assert_eq!((sender.sent, sender.repeated), (250, 50));
        // A part of the block, and all of it.
        assert_eq!(sender.count(400, 100, &response(500, 30)), 30);
        assert_eq!(sender.count(500, 100, &response(900, 100)), 100);
        assert_eq!((sender.sent, sender.repeated), (320, 50));
    }

    #[test]
    fn the_first_answer_of_a_server_that_was_unreachable_says_what_it_had() {
        let mut sender = sender();
        sender.tried_to = 100;
        assert_eq!(sender.count(0, 100, &SendResponse { next: Some(250), repeated: 100 }), 0);
        assert_eq!(sender.count(100, 100, &SendResponse { next: Some(250), repeated: 100 }), 0);
        assert_eq!(sender.count(200, 100, &SendResponse { next: Some(300), repeated: 50 }), 0);
        assert_eq!((sender.sent, sender.repeated), (50, 250));
        assert_eq!(sender.count(300, 100, &SendResponse { next: Some(400), repeated: 1 }), 1);
    }
}
