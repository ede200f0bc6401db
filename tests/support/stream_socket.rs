//! A WebSocket over which a live stream is sent.

use std::net::TcpStream;
use std::time::Duration;

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
