//! A WebSocket over which a live stream is sent.

use std::net::TcpStream;
use std::time::Duration;

use serde_json::Value;
use tungstenite::client::IntoClientRequest;
use tungstenite::{HandshakeError, Message, WebSocket};

/// A connection that sends a stream.
pub(crate) struct StreamSocket {
    socket: WebSocket<TcpStream>,
    /// Where the service goes on.
    pub(crate) next: Option<u64>,
}

impl StreamSocket {
    /// Begins a stream at an address such as `http://127.0.0.1:8600/v1/assets/a/stream?…`; the status of the
    /// answer where that is refused.
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
                let told = socket.hear().unwrap();
                assert_eq!(told["type"], "stream");
                socket.next = told["next"].as_u64();
                Ok(socket)
            }
            Err(HandshakeError::Failure(tungstenite::Error::Http(answer))) => Err(answer.status().as_u16()),
            Err(error) => panic!("{error}"),
        }
    }

    /// Sends samples from an index on, with the sender's time of the first one.
    pub(crate) fn send(&mut self, first: u64, time_ns: i64, samples: &[u8]) {
        let message = [&first.to_le_bytes()[..], &time_ns.to_le_bytes(), samples].concat();
        self.socket.send(Message::Binary(message.into())).unwrap();
    }

    pub(crate) fn say(&mut self, said: &Value) {
        self.socket.send(Message::Text(said.to_string().into())).unwrap();
    }

    /// What the service says next; the code and reason where it closes, 0 where the connection is lost.
    pub(crate) fn hear(&mut self) -> Result<Value, (u16, String)> {
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

    /// Waits until everything before an index is kept; returns the gaps that were told.
    pub(crate) fn wait_for(&mut self, next: u64) -> Vec<[u64; 2]> {
        let mut gaps = Vec::new();
        loop {
            let told = self.hear().unwrap();
            match told["type"].as_str().unwrap() {
                "gap" => gaps.push([told["first"].as_u64().unwrap(), told["samples"].as_u64().unwrap()]),
                "ack" if told["next"].as_u64().is_some_and(|kept| kept >= next) => return gaps,
                "ack" => {}
                other => panic!("{other}"),
            }
        }
    }
}
