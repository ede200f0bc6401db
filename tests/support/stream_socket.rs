//! A WebSocket over which a live stream is sent.

use std::net::TcpStream;
use std::time::Duration;

use rand::RngExt;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use tungstenite::client::IntoClientRequest;
use tungstenite::{HandshakeError, Message, WebSocket};

/// A WebSocket connection that sends a stream.
pub(crate) struct StreamSocket {
    socket: WebSocket<TcpStream>,
    /// The index that the service expects next.
    pub(crate) next: Option<u64>,
}

impl StreamSocket {
    /// Opens a stream at a URL such as `http://127.0.0.1:8600/v1/assets/a/stream?…`; returns the status if
    /// the service rejects it.
    pub(crate) fn open(url: &str, headers: &[(&'static str, &str)]) -> Result<Self, u16> {
        let address = url.trim_start_matches("http://");
        let stream = TcpStream::connect(&address[..address.find('/').unwrap()]).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        let mut request = format!("ws://{address}").into_client_request().unwrap();
        for (name, value) in headers {
            request.headers_mut().insert(*name, value.parse().unwrap());
        }
        match tungstenite::client(request, stream) {
            Ok((socket, _)) => {
                let mut socket = Self { socket, next: None };
                let message = socket.receive().unwrap();
                assert_eq!(message["type"], "stream");
                socket.next = message["next"].as_u64();
                Ok(socket)
            }
            Err(HandshakeError::Failure(tungstenite::Error::Http(answer))) => Err(answer.status().as_u16()),
            Err(error) => panic!("{error}"),
        }
    }

    /// Sends samples starting at an index, with the sender's time of the first one.
    pub(crate) fn send(&mut self, first: u64, time_ns: i64, samples: &[u8]) {
        assert!(self.try_send(first, time_ns, samples), "the connection is lost");
    }

    /// Sends samples; returns whether the connection is still there.
    pub(crate) fn try_send(&mut self, first: u64, time_ns: i64, samples: &[u8]) -> bool {
        let message = [&first.to_le_bytes()[..], &time_ns.to_le_bytes(), samples].concat();
        self.socket.send(Message::Binary(message.into())).is_ok()
    }

    pub(crate) fn send_json(&mut self, message: &Value) {
        self.socket.send(Message::Text(message.to_string().into())).unwrap();
    }

    /// Receives the next message; returns code and reason if the service closes, code 0 if the connection is
    /// lost.
    pub(crate) fn receive(&mut self) -> Result<Value, (u16, String)> {
        loop {
            match self.socket.read() {
                Ok(Message::Text(text)) => return Ok(serde_json::from_str(text.as_str()).unwrap()),
                Ok(Message::Close(Some(frame))) => {
                    return Err((frame.code.into(), frame.reason.as_str().to_owned()));
                }
                Ok(_) => {}
                Err(error) => return Err((0, error.to_string())),
            }
        }
    }

    /// Waits until everything before an index is acknowledged, without a gap; returns false if the connection
    /// is lost.
    pub(crate) fn try_wait_for(&mut self, next: u64, acknowledged: &mut u64) -> bool {
        while *acknowledged < next {
            let Ok(message) = self.receive() else { return false };
            assert_eq!(message["type"], "ack");
            *acknowledged = message["next"].as_u64().unwrap();
        }
        true
    }

    /// Waits until everything before an index is acknowledged; returns the reported gaps.
    pub(crate) fn wait_for(&mut self, next: u64) -> Vec<[u64; 2]> {
        let mut gaps = Vec::new();
        loop {
            let message = self.receive().unwrap();
            match message["type"].as_str().unwrap() {
                "gap" => {
                    gaps.push([message["first"].as_u64().unwrap(), message["samples"].as_u64().unwrap()])
                }
                "ack" if message["next"].as_u64().is_some_and(|kept| kept >= next) => return gaps,
                "ack" => {}
                other => panic!("{other}"),
            }
        }
    }
}

/// Returns reproducible noise as frames of one channel, twenty times as loud from an index on.
pub(crate) fn frames(first: u64, count: u64, loud_from: u64) -> Vec<u8> {
    let value = |k: u64| {
        let noise = (k.wrapping_mul(2_654_435_761) >> 7) % 2001;
        let factor = if k >= loud_from { 20.0 } else { 1.0 };
        (noise as f32 / 1000.0 - 1.0) * factor
    };
    (first..first + count).map(value).flat_map(f32::to_le_bytes).collect()
}

/// Cuts samples into chunks in random order, some of them repeated or overlapping. Returns the first index
/// and the number of samples of each.
pub(crate) fn shuffled(from: u64, until: u64, random: &mut ChaCha8Rng) -> Vec<(u64, u64)> {
    let (mut chunks, mut first) = (Vec::new(), from);
    while first < until {
        let count = random.random_range(1..1000).min(until - first);
        chunks.push((first, count));
        if random.random_bool(0.3) {
            let back = random.random_range(0..200).min(first);
            chunks.push((first - back, count));
        }
        first += count;
    }
    chunks.shuffle(random);
    chunks
}

/// A sender's clock: its crystal deviates from that of the samples, and it is set now and then.
pub(crate) struct SenderClock {
    begin_ns: i64,
    sample_rate_hz: f64,
    /// Offsets in nanoseconds, each from an index on.
    offsets: Vec<(u64, i64)>,
}

impl SenderClock {
    /// Relative excess of the sampling rate over the nominal one.
    const DRIFT: f64 = 5e-5;

    pub(crate) fn new(begin_ns: i64, sample_rate_hz: f64) -> Self {
        Self { begin_ns, sample_rate_hz, offsets: Vec::new() }
    }

    /// Sets the clock at a sample: a second to an hour forward, or back.
    pub(crate) fn jump(&mut self, index: u64, random: &mut ChaCha8Rng) {
        let before_ns = self.offsets.last().map_or(0, |(_, offset_ns)| *offset_ns);
        let by_ns = random.random_range(1_000_000_000..3_600_000_000_000);
        let by_ns = if before_ns > 0 { -by_ns } else { by_ns };
        self.offsets.push((index, before_ns + by_ns));
    }

    /// The number of jumps.
    pub(crate) fn jumps(&self) -> usize {
        self.offsets.len()
    }

    /// The time of a sample by this clock.
    pub(crate) fn time_ns(&self, index: u64) -> i64 {
        let offset = self.offsets.iter().rfind(|(from, _)| *from <= index);
        self.true_ns(index) + offset.map_or(0, |(_, offset_ns)| *offset_ns)
    }

    /// The time of a sample if the clock were never set.
    pub(crate) fn true_ns(&self, index: u64) -> i64 {
        let seconds = index as f64 / (self.sample_rate_hz * (1.0 + Self::DRIFT));
        self.begin_ns + (seconds * 1e9).round() as i64
    }
}
