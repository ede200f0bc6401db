//! A client for server-sent events.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::time::Duration;

use crate::running::Service;

/// A stream of events.
pub(crate) struct EventStream(BufReader<TcpStream>);

#[derive(Debug)]
pub(crate) struct Received {
    pub(crate) kind: String,
    pub(crate) id: String,
    pub(crate) data: serde_json::Value,
}

impl EventStream {
    pub(crate) fn open(service: &Service, query: &str, last: Option<&str>) -> Self {
        Self::open_at(&service.url(""), query, last)
    }

    /// Opens the events of a service at a URL.
    pub(crate) fn open_at(url: &str, query: &str, last: Option<&str>) -> Self {
        let last = last.map_or_else(String::new, |last| format!("last-event-id: {last}\r\n"));
        Self::open_path(url, &format!("/v1/events{query}"), &last)
    }

    /// Opens another event stream; `head` has additional header lines of the request.
    pub(crate) fn open_path(url: &str, path: &str, head: &str) -> Self {
        let address = url.trim_start_matches("http://").to_string();
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nhost: localhost\r\n{head}\r\n").unwrap();
        let mut reader = BufReader::new(stream);
        let mut line = String::new();
        reader.read_line(&mut line).unwrap();
        assert!(line.starts_with("HTTP/1.1 200 "), "{line}");
        while line.trim() != "" {
            line.clear();
            reader.read_line(&mut line).unwrap();
        }
        Self(reader)
    }

    pub(crate) fn next(&mut self) -> Received {
        self.next_or_end().expect("the stream ended")
    }

    /// Returns the next event; `None` if the server ended the stream.
    pub(crate) fn next_or_end(&mut self) -> Option<Received> {
        let (mut kind, mut id, mut data) = (String::new(), String::new(), None);
        loop {
            let mut line = String::new();
            let read = self.0.read_line(&mut line).unwrap();
            // The last chunk, or the end of the connection.
            if read == 0 || line == "0\r\n" {
                return None;
            }
            // Lines with chunk lengths are ignored.
            if let Some(text) = line.strip_prefix("event: ") {
                kind = text.trim().to_string();
            } else if let Some(text) = line.strip_prefix("id: ") {
                id = text.trim().to_string();
            } else if let Some(text) = line.strip_prefix("data: ") {
                data = Some(serde_json::from_str(text).unwrap());
            } else if line.trim().is_empty()
                && let Some(data) = data.take()
            {
                return Some(Received { kind, id, data });
            }
        }
    }
}
