//! The program in its own process.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use flankwatch::recording::{BlockEncoding, encode_block};
use serde_json::{Value, json};

use crate::running::record;

/// A running program and its log.
pub(crate) struct Program {
    child: Child,
    url: String,
    log: Arc<Mutex<String>>,
    agent: ureq::Agent,
}

impl Program {
    pub(crate) fn start(folder: &Path) -> Self {
        Self::start_with(folder, &[])
    }

    /// Starts with additional options.
    pub(crate) fn start_with(folder: &Path, options: &[&str]) -> Self {
        Self::start_by(Command::new(env!("CARGO_BIN_EXE_flankwatch")), folder, options)
    }

    /// Starts with a maximum size of the files that it writes; a longer write fails with EFBIG.
    pub(crate) fn start_with_file_size(folder: &Path, bytes: u64) -> Self {
        // In blocks of 512 bytes. The signal would end the program.
        let script = format!("trap '' XFSZ; ulimit -f {}; exec \"$0\" \"$@\"", bytes / 512);
        let mut command = Command::new("sh");
        command.args(["-c", &script, env!("CARGO_BIN_EXE_flankwatch")]);
        Self::start_by(command, folder, &[])
    }

    pub(crate) fn start_by(mut command: Command, folder: &Path, options: &[&str]) -> Self {
        let mut child = command
            .args(["serve", "--data-dir"])
            .arg(folder)
            .args(if options.contains(&"--listen") { &[][..] } else { &["--listen", "127.0.0.1:0"] })
            .args(options)
            .env("FLANKWATCH_LOG", "info")
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        let mut err = child.stderr.take().unwrap();
        let log = Arc::new(Mutex::new(String::new()));
        let sink = Arc::clone(&log);
        std::thread::spawn(move || {
            let mut piece = [0; 4096];
            while let Ok(count) = err.read(&mut piece)
                && count > 0
            {
                sink.lock().unwrap().push_str(&String::from_utf8_lossy(&piece[..count]));
            }
        });
        let mut url = String::new();
        while !url.contains("http://") {
            url.clear();
            let count = out.read_line(&mut url).unwrap();
            assert!(count > 0, "did not start: {}", log.lock().unwrap());
        }
        let url = url[url.find("http://").unwrap()..].trim().to_owned();
        let agent = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .timeout_global(Some(Duration::from_secs(60)))
            .build();
        Self { child, url, log, agent: agent.into() }
    }

    pub(crate) fn get(&self, path: &str) -> Value {
        let mut response = self.agent.get(format!("{}{path}", self.url)).call().unwrap();
        let text = response.body_mut().with_config().limit(256 << 20).read_to_string().unwrap();
        assert!(response.status().is_success(), "{path}: {text}");
        serde_json::from_str(&text).unwrap()
    }

    pub(crate) fn send(
        &self,
        method: &str,
        path: &str,
        headers: &[(&str, &str)],
        body: &[u8],
    ) -> ureq::http::Response<ureq::Body> {
        let mut request = ureq::http::Request::builder().method(method).uri(format!("{}{path}", self.url));
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        self.agent.run(request.body(body).unwrap()).unwrap()
    }

    /// Uploads a record; returns the acknowledged segment, or `None` if the program is gone.
    pub(crate) fn upload(&self, asset: &str, n: u32) -> Option<Value> {
        let body = encode_block(&record("1", n), BlockEncoding::Protobuf);
        let request = self.agent.post(format!("{}/v1/assets/{asset}/segments", self.url));
        let mut response = request.content_type("application/x-protobuf").send(&body[..]).ok()?;
        let status = response.status().as_u16();
        let text = response.body_mut().read_to_string().ok()?;
        assert_eq!(status, 201, "{text}");
        serde_json::from_str(&text).ok()
    }

    pub(crate) fn make(&self, asset: &Value) {
        let request = self.agent.post(format!("{}/v1/assets", self.url));
        let response = request.content_type("application/json").send(asset.to_string().as_bytes()).unwrap();
        assert!([201, 409].contains(&response.status().as_u16()));
    }

    /// Returns the base URL.
    pub(crate) fn url(&self) -> &str {
        &self.url
    }

    /// Returns the log so far.
    pub(crate) fn log(&self) -> String {
        self.log.lock().unwrap().clone()
    }

    /// Returns the process ID.
    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    pub(crate) fn kill(mut self) -> String {
        // SIGKILL
        self.child.kill().unwrap();
        self.child.wait().unwrap();
        let log = self.log.lock().unwrap();
        log.clone()
    }

    /// Returns how often each segment identifier is listed, over all pages.
    pub(crate) fn segments(&self, asset: &str) -> BTreeMap<String, u32> {
        let mut found = BTreeMap::new();
        let mut cursor = String::new();
        loop {
            let page = self.get(&format!("/v1/assets/{asset}/segments?limit=1000{cursor}"));
            for item in page["items"].as_array().unwrap() {
                *found.entry(item["id"].as_str().unwrap().to_owned()).or_default() += 1;
            }
            match page["next_cursor"].as_str() {
                Some(next) => cursor = format!("&cursor={next}"),
                None => return found,
            }
        }
    }

    /// Returns all values of all records in time order.
    pub(crate) fn history(&self, asset: &str) -> Vec<Value> {
        let mut rows = Vec::new();
        for path in ["wear/history", "indicators"] {
            let answer = self.get(&format!("/v1/assets/{asset}/{path}?max_points=200000"));
            let mut items = answer["items"].as_array().unwrap().clone();
            for item in &mut items {
                item.as_object_mut().unwrap().remove("segment_id");
            }
            rows.push(json!(items));
        }
        rows
    }
}
