//! The Debian package of this program: installed into a folder, started by its unit's command, removed.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use flankwatch_test_support::needed;

use crate::deploy::folder;

/// Runs a program and returns what it prints, without its messages.
#[track_caller]
fn run(program: &Path, words: &[&str]) -> String {
    // A program for tests is large.
    let output = Command::new(program).args(words).env("DPKG_DEB_COMPRESSOR_TYPE", "none").output().unwrap();
    let [text, errors] =
        [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    assert!(output.status.success(), "{} {words:?}: {text}{errors}", program.display());
    text
}

/// A root folder with nothing but packages installed.
struct System {
    root: tempfile::TempDir,
}

impl System {
    fn empty() -> Self {
        let root = tempfile::tempdir().unwrap();
        for folder in ["info", "updates", "parts", "triggers"] {
            fs::create_dir_all(root.path().join("var/lib/dpkg").join(folder)).unwrap();
        }
        for file in ["status", "available"] {
            fs::write(root.path().join("var/lib/dpkg").join(file), "").unwrap();
        }
        Self { root }
    }

    #[track_caller]
    fn dpkg(&self, words: &[&str]) {
        let root = format!("--root={}", self.root.path().display());
        // Its scripts run outside the folder and get its path.
        let options = [
            root.as_str(),
            "--force-not-root",
            "--force-script-chrootless",
            "--force-depends",
            "--force-bad-path",
        ];
        run(Path::new("dpkg"), &[&options[..], words].concat());
    }

    fn path(&self, path: &str) -> PathBuf {
        self.root.path().join(path.trim_start_matches('/'))
    }

    fn text(&self, path: &str) -> String {
        fs::read_to_string(self.path(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
    }
}

#[test]
#[ignore = "needs dpkg (Debian)"]
fn a_package_is_installed_started_by_its_unit_and_removed() {
    let dpkg = Path::new("/usr/bin/dpkg-deb");
    needed(dpkg.is_file().then_some(()), "dpkg-deb (Debian)");
    let built = tempfile::tempdir().unwrap();
    let out = built.path().to_str().unwrap();
    let program = env!("CARGO_BIN_EXE_flankwatch");
    run(&folder().join("package/deb"), &[program, out]);
    let package = fs::read_dir(built.path()).unwrap().next().unwrap().unwrap().path();
    let package = package.to_str().unwrap();
    assert!(package.contains(&format!("flankwatch_{}_", env!("CARGO_PKG_VERSION"))), "{package}");

    let system = System::empty();
    system.dpkg(&["--install", package]);
    for path in [
        "usr/lib/sysusers.d/flankwatch.conf",
        "usr/share/bash-completion/completions/flankwatch",
        "usr/share/zsh/vendor-completions/_flankwatch",
        "usr/share/fish/vendor_completions.d/flankwatch.fish",
        "usr/share/man/man1/flankwatch.1.gz",
        "usr/share/man/man1/flankwatch-serve.1.gz",
        "usr/share/doc/flankwatch/copyright",
    ] {
        assert!(system.path(path).is_file(), "{path}");
    }

    let unit = system.text("lib/systemd/system/flankwatch.service");
    let started = unit.lines().find_map(|line| line.strip_prefix("ExecStart=")).unwrap();
    let mut words = started.split(' ').map(|word| match word.starts_with('/') {
        true => system.path(word).to_str().unwrap().to_owned(),
        false => word.to_owned(),
    });
    let mut service = Command::new(words.next().unwrap())
        .args(words)
        .args(["--listen", "127.0.0.1:0"])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut text = String::new();
    BufReader::new(service.stdout.take().unwrap()).read_line(&mut text).unwrap();
    let url = text.trim().strip_prefix("listening on ").map(|url| format!("{url}/readyz"));
    let ready = url.map(|url| ureq::get(url).call().map(|answer| answer.status().as_u16()));
    service.kill().unwrap();
    service.wait().unwrap();
    assert_eq!(ready.unwrap().unwrap(), 200);

    fs::write(system.path("etc/flankwatch/flankwatch.toml"), "listen = \"127.0.0.1:8601\"\n").unwrap();
    system.dpkg(&["--remove", "flankwatch"]);
    assert!(!system.path("usr/bin/flankwatch").exists());
    assert!(system.text("etc/flankwatch/flankwatch.toml").contains("8601"), "settings stay");
    system.dpkg(&["--purge", "flankwatch"]);
    assert!(!system.path("etc/flankwatch/flankwatch.toml").exists());
    assert!(system.path("var/lib/flankwatch/flankwatch.db").is_file(), "records stay");
}

#[test]
fn the_bill_of_materials_lists_what_is_compiled_in() {
    let bill = run(&folder().join("package/bill"), &["cluster", "x86_64-unknown-linux-gnu"]);
    let bill: serde_json::Value = serde_json::from_str(&bill).unwrap();
    assert_eq!((&bill["bomFormat"], &bill["specVersion"]), (&"CycloneDX".into(), &"1.5".into()));
    let components = bill["components"].as_array().unwrap();
    let find = |name: &str| components.iter().find(|component| component["name"] == name);
    for name in ["rustfft", "axum", "async-nats"] {
        let found = find(name).unwrap_or_else(|| panic!("{name} is missing"));
        assert_eq!(found["hashes"][0]["content"].as_str().map(str::len), Some(64), "{found}");
        assert!(found["licenses"][0]["expression"].is_string(), "{found}");
    }
    assert!(find("proptest").is_none(), "a crate of the tests alone");
}
