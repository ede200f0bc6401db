//! API nodes, workers and servers as processes that can be killed.

use std::io::{BufRead, BufReader, Read};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::client::Client;
use flankwatch_test_support::needed;

/// A process that is killed on drop.
pub(super) struct Process {
    child: Child,
    log: Arc<Mutex<String>>,
}

impl Process {
    pub(super) fn spawn(mut command: Command) -> Self {
        let mut child = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let mut err = child.stderr.take().unwrap();
        let log: Arc<Mutex<String>> = Arc::default();
        let sink = Arc::clone(&log);
        std::thread::spawn(move || {
            let mut piece = [0; 4096];
            while let Ok(count) = err.read(&mut piece)
                && count > 0
            {
                sink.lock().unwrap().push_str(&String::from_utf8_lossy(&piece[..count]));
            }
        });
        Self { child, log }
    }

    /// Returns the log so far.
    pub(super) fn log(&self) -> String {
        self.log.lock().unwrap().clone()
    }

    /// Sends a signal to the process and waits for its end, unless it has ended already.
    pub(super) fn signal(&mut self, name: &str) {
        if matches!(self.child.try_wait(), Ok(None)) {
            let id = self.child.id().to_string();
            let _ = Command::new("kill").args(["-s", name, &id]).status();
            let _ = self.child.wait();
        }
    }

    /// Kills the process.
    pub(super) fn kill(&mut self) {
        // SIGKILL
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
        if std::thread::panicking() {
            let log = self.log();
            let last: Vec<&str> = log.lines().rev().take(40).collect();
            let last: Vec<&str> = last.into_iter().rev().collect();
            eprintln!("process {} said last:\n{}\n", self.child.id(), last.join("\n"));
        }
    }
}

/// An API node, or a worker with its health server.
pub(super) struct Program {
    pub(super) process: Process,
    pub(super) client: Client,
}

impl Program {
    pub(super) fn api(program: &Path, config: &Path, folder: &Path) -> Self {
        Self::start(program, &["serve", "--listen", "127.0.0.1:0"], config, folder, &[])
    }

    pub(super) fn worker(program: &Path, config: &Path, folder: &Path) -> Self {
        Self::start(program, &["work", "--health", "127.0.0.1:0"], config, folder, &[])
    }

    /// Starts a worker whose clock is ahead by some days, or behind.
    pub(super) fn worker_at(program: &Path, config: &Path, folder: &Path, days: i32) -> Self {
        let library = ["x86_64-linux-gnu", "aarch64-linux-gnu"]
            .map(|machine| PathBuf::from(format!("/usr/lib/{machine}/faketime/libfaketime.so.1")));
        let library =
            needed(library.into_iter().find(|file| file.is_file()), "faketime (apt install faketime)");
        let (library, offset) = (library.display().to_string(), format!("{days:+}d"));
        let clock =
            [("LD_PRELOAD", &*library), ("FAKETIME", &*offset), ("FAKETIME_DONT_FAKE_MONOTONIC", "1")];
        Self::start(program, &["work", "--health", "127.0.0.1:0"], config, folder, &clock)
    }

    fn start(
        program: &Path,
        arguments: &[&str],
        config: &Path,
        folder: &Path,
        environment: &[(&str, &str)],
    ) -> Self {
        let mut command = Command::new(program);
        command
            .args(arguments)
            .arg("--config")
            .arg(config)
            .arg("--data-dir")
            .arg(folder)
            .env("FLANKWATCH_LOG", "info")
            .env("FLANKWATCH_S3_ACCESS_KEY_ID", "test")
            .env("FLANKWATCH_S3_SECRET_ACCESS_KEY", "test")
            .envs(environment.iter().copied())
            .stdout(Stdio::piped());
        let mut process = Process::spawn(command);
        let mut out = BufReader::new(process.child.stdout.take().unwrap());
        let mut line = String::new();
        while !line.contains("http://") {
            line.clear();
            let count = out.read_line(&mut line).unwrap();
            assert!(count > 0, "did not start: {}", process.log());
        }
        let url = line[line.find("http://").unwrap()..].trim().to_owned();
        Self { process, client: Client::new(url) }
    }

    /// Waits until `/readyz` reports ready or not ready.
    #[track_caller]
    pub(super) fn wait_for_readiness(&self, status: u16) -> serde_json::Value {
        let began = Instant::now();
        loop {
            let found = self.client.try_send("GET", "/readyz", "application/json", b"");
            if let Some((found, answer)) = &found
                && *found == status
            {
                return answer.clone();
            }
            assert!(began.elapsed() < Duration::from_secs(60), "still {found:?}, expected {status}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

/// Returns a free port.
pub(super) fn free_port() -> u16 {
    TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap().port()
}

pub(super) fn wait_for_port(address: SocketAddr, process: &Process) {
    let began = Instant::now();
    while TcpStream::connect(address).is_err() {
        assert!(began.elapsed() < Duration::from_secs(60), "nobody listens at {address}: {}", process.log());
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn program(name: &str) -> PathBuf {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let found = std::env::split_paths(&path).map(|folder| folder.join(name)).find(|file| file.is_file());
    needed(found, &format!("the program {name}"))
}

/// A NATS server with JetStream in a temporary folder.
pub(super) struct NatsServer {
    program: PathBuf,
    folder: PathBuf,
    port: u16,
    process: Process,
}

impl NatsServer {
    pub(super) fn start(folder: &Path) -> Self {
        let program = program("nats-server");
        let (folder, port) = (folder.join("nats"), free_port());
        let process = Self::spawn(&program, &folder, port);
        Self { program, folder, port, process }
    }

    /// The server may store more than its disk holds: by default it offers a part of what is free there.
    fn spawn(program: &Path, folder: &Path, port: u16) -> Process {
        std::fs::create_dir_all(folder).unwrap();
        let settings = folder.with_file_name("nats.conf");
        let text = format!("jetstream {{ store_dir: {folder:?}, max_file_store: 64G }}\n");
        std::fs::write(&settings, text).unwrap();
        let mut command = Command::new(program);
        command.args(["-a", "127.0.0.1", "-p", &port.to_string(), "-c"]).arg(&settings);
        let process = Process::spawn(command);
        wait_for_port(SocketAddr::from((Ipv4Addr::LOCALHOST, port)), &process);
        process
    }

    pub(super) fn url(&self) -> String {
        format!("nats://127.0.0.1:{}", self.port)
    }

    pub(super) fn kill(&mut self) {
        self.process.kill();
    }

    pub(super) fn start_again(&mut self) {
        self.process = Self::spawn(&self.program, &self.folder, self.port);
    }
}

/// An S3 server in memory, with a bucket `records`.
pub(super) struct S3Server {
    address: SocketAddr,
    _process: Process,
}

impl S3Server {
    pub(super) fn start() -> Self {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, free_port()));
        let mut command = Command::new(program("moto_server"));
        command.args(["-H", "127.0.0.1", "-p", &address.port().to_string()]).stdout(Stdio::null());
        let process = Process::spawn(command);
        wait_for_port(address, &process);
        let bucket = ureq::put(format!("http://{address}/records")).send_empty().unwrap();
        assert!(bucket.status().is_success());
        Self { address, _process: process }
    }

    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }
}
