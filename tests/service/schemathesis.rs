//! The API against its description: schemathesis sends requests that are valid and invalid by the schemas.

use std::path::PathBuf;
use std::process::Command;

use flankwatch::signal::Record;
use flankwatch_test_support::needed;
use serde_json::json;

use crate::alarms::{at_once, watched};
use crate::running::{Service, gearbox_24_26, minute, plain_asset};

/// What schemathesis cannot know, with the reasons.
const CONFIG: &str = include_str!("schemathesis.toml");

/// How bodies are sent.
const HOOKS: &str = include_str!("schemathesis_hooks.py");

/// Returns the tool, from the path or the environment.
fn schemathesis() -> PathBuf {
    let named = std::env::var_os("FLANKWATCH_SCHEMATHESIS").map(PathBuf::from);
    let path = std::env::var_os("PATH").unwrap_or_default();
    let on_path = std::env::split_paths(&path).map(|folder| folder.join("schemathesis"));
    let found = named.into_iter().chain(on_path).find(|path| path.is_file());
    needed(found, "schemathesis (pip install schemathesis)")
}

#[test]
#[ignore = "needs schemathesis (pip install schemathesis)"]
fn schemathesis_finds_nothing() {
    let tool = schemathesis();
    let service = Service::start();
    let mut asset = watched("gearbox-1", &at_once());
    asset["gear"] = json!({ "teeth": [24, 26], "shaft_speed_hz": 16.64 });
    asset["operating_bins"] = json!([{ "name": "full load", "torque_nm": [80, 120] }]);
    service.post_json("/v1/assets", &asset).expect(201);
    service.post_json("/v1/assets", &plain_asset("press-4")).expect(201);
    // Long enough for averages over a turn, and loud enough for an alarm.
    let samples = gearbox_24_26().into_iter().map(|sample| 4.0 * sample).collect();
    let record = Record::new("1", minute(0), 10_000.0, "m/s2", samples).unwrap();
    let segment = service.upload("gearbox-1", &record)["id"].clone();
    let alarm = service.get("/v1/alarms").expect(200).json()["items"][0]["id"].clone();
    let folder = tempfile::tempdir().unwrap();
    let names = format!("\"path.segment\" = {segment}\n\"path.alarm\" = {alarm}\n");
    std::fs::write(folder.path().join("schemathesis.toml"), format!("{CONFIG}{names}")).unwrap();
    std::fs::write(folder.path().join("hooks.py"), HOOKS).unwrap();
    let output = Command::new(tool)
        .current_dir(folder.path())
        .arg("run")
        .arg(service.url("/openapi.json"))
        .args(["--checks", "all", "--max-examples", "15", "--seed", "1"])
        .args(["--phases", "examples,coverage,fuzzing", "--suppress-health-check", "all", "--no-color"])
        // A stream of events has no end, and after the first token nothing is answered without one; both have
        // tests of their own.
        .args(["--exclude-method", "DELETE"])
        .args(["--exclude-path", "/v1/events"])
        .args(["--exclude-path", "/v1/assets/{asset}/stream/live"])
        .args(["--exclude-path", "/v1/tokens"])
        .env("SCHEMATHESIS_HOOKS", "hooks")
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
}
