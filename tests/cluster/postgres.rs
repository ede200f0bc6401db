//! A PostgreSQL server of a test, which can be stopped and restarted.

use std::net::{Ipv4Addr, SocketAddr};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use super::processes::{Process, free_port, wait_for_port};
use flankwatch_test_support::needed;

/// How a server is stopped.
#[derive(Debug, Clone, Copy)]
pub(super) enum Stop {
    /// Fast shutdown: closes connections and writes a checkpoint.
    Fast,
    /// Immediate shutdown, as in a crash.
    Immediate,
}

/// The user that a server runs as: PostgreSQL does not run as root.
#[derive(Debug, Clone, Copy)]
struct Account {
    user: u32,
    group: u32,
}

/// A PostgreSQL server in a temporary folder.
pub(super) struct PostgresServer {
    programs: PathBuf,
    account: Option<Account>,
    folder: PathBuf,
    port: u16,
    process: Process,
}

impl PostgresServer {
    pub(super) fn start() -> Self {
        let programs = needed(programs(), "PostgreSQL's programs under /usr/lib/postgresql");
        let account = (number(&["-u"]) == Some(0)).then(|| Account {
            user: number(&["-u", "postgres"]).unwrap(),
            group: number(&["-g", "postgres"]).unwrap(),
        });
        // Created by the account, which cannot access other users' folders.
        let made = as_account(Path::new("mktemp"), account).args(["-d", "--tmpdir"]).output().unwrap();
        let folder = PathBuf::from(String::from_utf8(made.stdout).unwrap().trim());
        assert!(folder.is_dir(), "{}", String::from_utf8_lossy(&made.stderr));
        let made = as_account(&programs.join("initdb"), account)
            .args(["--auth", "trust", "--username", "postgres", "--encoding", "UTF8", "--no-sync", "-D"])
            .arg(folder.join("data"))
            .output()
            .unwrap();
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        let port = free_port();
        let process = spawn(&programs, account, &folder, port);
        Self { programs, account, folder, port, process }
    }

    pub(super) fn address(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    pub(super) fn url(&self) -> String {
        format!("postgres://postgres@{}/postgres", self.address())
    }

    /// Stops the server and waits for its end.
    pub(super) fn stop(&mut self, how: Stop) {
        self.process.signal(match how {
            Stop::Fast => "INT",
            Stop::Immediate => "QUIT",
        });
    }

    pub(super) fn start_again(&mut self) {
        self.process = spawn(&self.programs, self.account, &self.folder, self.port);
    }
}

impl Drop for PostgresServer {
    fn drop(&mut self) {
        self.stop(Stop::Immediate);
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

fn spawn(programs: &Path, account: Option<Account>, folder: &Path, port: u16) -> Process {
    let mut command = as_account(&programs.join("postgres"), account);
    command.arg("-D").arg(folder.join("data")).args([
        "-p",
        &port.to_string(),
        "-c",
        "listen_addresses=127.0.0.1",
        "-c",
        "unix_socket_directories=",
    ]);
    let process = Process::spawn(command);
    wait_for_port(SocketAddr::from((Ipv4Addr::LOCALHOST, port)), &process);
    // It listens before it answers.
    let is_ready = || {
        let mut asked = Command::new(programs.join("pg_isready"));
        asked.args(["--quiet", "--host", "127.0.0.1", "--port", &port.to_string()]);
        asked.status().unwrap().success()
    };
    let began = Instant::now();
    while !is_ready() {
        assert!(began.elapsed() < Duration::from_secs(60), "does not answer: {}", process.log());
        std::thread::sleep(Duration::from_millis(50));
    }
    process
}

/// Returns the folder of the latest installed version's programs.
fn programs() -> Option<PathBuf> {
    let versions = std::fs::read_dir("/usr/lib/postgresql").ok()?.flatten();
    let mut found: Vec<PathBuf> = versions.map(|version| version.path().join("bin")).collect();
    found.retain(|programs| programs.join("initdb").is_file());
    found.sort();
    found.pop()
}

fn number(words: &[&str]) -> Option<u32> {
    let output = Command::new("id").args(words).output().ok()?;
    String::from_utf8(output.stdout).ok()?.trim().parse().ok()
}

fn as_account(program: &Path, account: Option<Account>) -> Command {
    let mut command = Command::new(program);
    command.current_dir("/");
    if let Some(account) = account {
        command.uid(account.user).gid(account.group);
    }
    command
}
