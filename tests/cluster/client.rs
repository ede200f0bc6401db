//! A client of a service at a URL, which may be unreachable.

use std::time::{Duration, Instant};

use flankwatch::recording::{BlockEncoding, encode_block};
use flankwatch::signal::Record;
use serde_json::Value;

/// A client of a service at a URL.
pub(super) struct Client {
    pub(super) url: String,
    agent: ureq::Agent,
}

impl Client {
    pub(super) fn new(url: String) -> Self {
        let agent = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .timeout_global(Some(Duration::from_secs(60)))
            .build();
        Self { url, agent: agent.into() }
    }

    /// Returns status and body; `None` if the service is unreachable.
    pub(super) fn try_send(
        &self,
        method: &str,
        path: &str,
        media_type: &str,
        body: &[u8],
    ) -> Option<(u16, Value)> {
        let (status, _, answer) = self.try_send_with(method, path, &[("content-type", media_type)], body)?;
        Some((status, answer))
    }

    /// Returns status, headers and body; `None` if the service is unreachable.
    pub(super) fn try_send_with(
        &self,
        method: &str,
        path: &str,
        headers: &[(&str, &str)],
        body: &[u8],
    ) -> Option<(u16, ureq::http::HeaderMap, Value)> {
        let mut request = ureq::http::Request::builder().method(method).uri(format!("{}{path}", self.url));
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let mut response = self.agent.run(request.body(body).unwrap()).ok()?;
        let text = response.body_mut().with_config().limit(64 << 20).read_to_string().ok()?;
        let body = serde_json::from_str(&text).unwrap_or(Value::String(text));
        Some((response.status().as_u16(), response.headers().clone(), body))
    }

    #[track_caller]
    pub(super) fn send_json(&self, method: &str, path: &str, body: &Value, status: u16) -> Value {
        let sent = self.try_send(method, path, "application/json", body.to_string().as_bytes());
        let (found, answer) = sent.unwrap_or_else(|| panic!("nobody answers at {}", self.url));
        assert_eq!(found, status, "{method} {path}: {answer}");
        answer
    }

    #[track_caller]
    pub(super) fn get(&self, path: &str) -> Value {
        self.send_json("GET", path, &Value::Null, 200)
    }

    pub(super) fn try_upload(&self, asset: &str, record: &Record) -> Option<(u16, Value)> {
        let block = encode_block(record, BlockEncoding::Protobuf);
        let path = format!("/v1/assets/{asset}/segments");
        self.try_send("POST", &path, "application/x-protobuf", &block)
    }

    /// Sends a record until it is accepted.
    #[track_caller]
    pub(super) fn upload(&self, asset: &str, record: &Record) -> Value {
        let began = Instant::now();
        loop {
            match self.try_upload(asset, record) {
                Some((201, answer)) => return answer,
                Some((503, _)) => {}
                other => panic!("{other:?}"),
            }
            assert!(began.elapsed() < Duration::from_secs(60), "never taken");
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    #[track_caller]
    pub(super) fn wait_for(&self, path: &str, is_wanted: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        loop {
            let found = self.try_send("GET", path, "application/json", b"");
            if let Some((200, answer)) = &found
                && is_wanted(answer)
            {
                return answer.clone();
            }
            // A history has hundreds of rows: the first ones say what kind of answer it is.
            assert!(
                began.elapsed() < Duration::from_secs(120),
                "{path} is still {:.600}",
                format!("{found:?}")
            );
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Waits until an asset has this many segments, for as long as their number changes.
    #[track_caller]
    pub(super) fn wait_for_segments(&self, asset: &str, count: impl TryInto<u64>) {
        let count = count.try_into().ok().unwrap();
        let (mut found, mut changed) = (None, Instant::now());
        while found != Some(count) {
            let answer = self.try_send("GET", &format!("/v1/assets/{asset}"), "application/json", b"");
            let now = answer.and_then(|(_, answer)| answer["summary"]["segments"].as_u64());
            if now.is_some() && now != found {
                (found, changed) = (now, Instant::now());
            }
            assert!(
                changed.elapsed() < Duration::from_secs(120),
                "{asset} has {found:?} of {count} segments; {}",
                self.queue_metrics()
            );
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// The state of the queue and its workers.
    fn queue_metrics(&self) -> String {
        let Some((_, Value::String(text))) = self.try_send("GET", "/metrics", "text/plain", b"") else {
            return "no metrics".to_owned();
        };
        let prefixes = ["flankwatch_queue", "flankwatch_workers", "flankwatch_dead_letters"];
        let lines = text.lines().filter(|line| prefixes.iter().any(|prefix| line.starts_with(prefix)));
        lines.collect::<Vec<_>>().join(", ")
    }

    /// Returns all values of all records in time order.
    pub(super) fn history(&self, asset: &str) -> Vec<Value> {
        let mut rows = Vec::new();
        let summary = self.get(&format!("/v1/assets/{asset}"))["summary"].clone();
        let mut channels: Vec<&str> =
            summary["channels"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
        channels.sort_unstable();
        for channel in channels {
            for path in ["wear/history", "indicators"] {
                let answer =
                    self.get(&format!("/v1/assets/{asset}/{path}?max_points=200000&channel={channel}"));
                rows.push(answer["items"].clone());
            }
        }
        rows
    }

    /// Returns the state and the history of every alarm, without the times of operator actions.
    pub(super) fn alarms(&self) -> Vec<Value> {
        let mut alarms = self.get("/v1/alarms?limit=1000")["items"].as_array().unwrap().clone();
        for alarm in &mut alarms {
            alarm.as_object_mut().unwrap().remove("changed_at");
        }
        alarms.sort_by_key(|alarm| alarm["id"].to_string());
        alarms
    }
}
