//! The files in `deploy/` match the program: they parse, their options, ports and metrics exist, and their
//! settings are valid.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use flankwatch::estimate::Severity;
use flankwatch::service::QueueOverview;
use flankwatch::store::Recipient;
use serde_json::Value;

use crate::program::Program;
use crate::running::{Service, record};

pub(crate) fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy")
}

pub(crate) fn text(path: &str) -> String {
    let path = folder().join(path);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Returns the documents of a YAML file.
fn yaml(path: &str) -> Vec<Value> {
    let documents = serde_saphyr::from_multiple(&text(path));
    documents.unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Returns every file below a folder, relative to `deploy`.
fn files(below: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for entry in fs::read_dir(below).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else {
            found.push(path.strip_prefix(folder()).unwrap().to_str().unwrap().to_owned());
        }
    }
    found
}

fn ending(ends: &[&str]) -> Vec<String> {
    let found: Vec<String> =
        files(&folder()).into_iter().filter(|path| ends.iter().any(|end| path.ends_with(end))).collect();
    assert!(!found.is_empty(), "no file ends in {ends:?}");
    found
}

/// Returns the manifests that `kubectl apply -k` applies, in order.
pub(crate) fn manifests() -> Vec<String> {
    let resources = yaml("kubernetes/kustomization.yaml")[0]["resources"].as_array().unwrap().clone();
    resources.iter().map(|name| format!("kubernetes/{}", name.as_str().unwrap())).collect()
}

/// Returns the expressions of alert rules and dashboards, with their location.
pub(crate) fn expressions() -> Vec<(String, String)> {
    let mut found = Vec::new();
    for group in yaml("prometheus/rules.yaml")[0]["groups"].as_array().unwrap() {
        for rule in group["rules"].as_array().unwrap() {
            found.push((
                rule["alert"].as_str().unwrap().to_owned(),
                rule["expr"].as_str().unwrap().to_owned(),
            ));
        }
    }
    for path in ending(&["dashboards/machines.json", "dashboards/service.json"]) {
        let dashboard: Value = serde_json::from_str(&text(&path)).unwrap();
        for panel in dashboard["panels"].as_array().unwrap() {
            for target in panel["targets"].as_array().into_iter().flatten() {
                let of = format!("{path}, {}", panel["title"]);
                found.push((of, target["expr"].as_str().unwrap().to_owned()));
            }
        }
        for variable in dashboard["templating"]["list"].as_array().unwrap() {
            let query = variable["definition"].as_str().unwrap();
            let metric =
                query.strip_prefix("label_values(").and_then(|rest| rest.rsplit_once(", ")).unwrap().0;
            found.push((format!("{path}, variable {}", variable["name"]), metric.to_owned()));
        }
    }
    found
}

/// Returns the metrics of an expression, with the labels it selects.
fn metrics(expression: &str) -> Vec<(String, BTreeSet<String>)> {
    let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let mut found = Vec::new();
    let mut rest = expression;
    while let Some(at) = rest.find("flankwatch_") {
        let name: String = rest[at..].chars().take_while(|c| is_name(*c)).collect();
        rest = &rest[at + name.len()..];
        let mut labels = BTreeSet::new();
        if let Some(mut selectors) = rest.strip_prefix('{') {
            // A value may hold anything, braces too: label="value", label=~"value", …
            while let Some(compared) = selectors.find(['=', '!']) {
                labels.insert(selectors[..compared].trim_matches([' ', ',']).to_owned());
                let value = &selectors[selectors.find('"').unwrap() + 1..];
                selectors = &value[value.find('"').unwrap() + 1..];
                if selectors.starts_with('}') {
                    break;
                }
            }
        }
        found.push((name, labels));
    }
    found
}

#[test]
fn selectors_are_parsed() {
    let found = metrics("rate(flankwatch_a_total{x=\"{b}\",y!~\"c|d\"}[5m]) / flankwatch_b");
    let labels = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<BTreeSet<_>>();
    assert_eq!(
        found,
        [("flankwatch_a_total".to_owned(), labels(&["x", "y"])), ("flankwatch_b".to_owned(), labels(&[]))]
    );
}

/// Returns the service's metrics with their labels.
fn measured() -> BTreeMap<String, BTreeSet<String>> {
    let service = Service::start_with(|config| {
        let shift = Recipient { name: "shift".to_owned(), at_least: Severity::Danger };
        config.recipients.list.push(shift);
    });
    let mut asset = crate::running::plain_asset("pump");
    asset["alarms"] = serde_json::json!([{ "quantity": { "indicator": "rms" }, "warning": 0.01, "settings": crate::alarms::at_once() }]);
    service.post_json("/v1/assets", &asset).expect(201);
    for n in 0..10 {
        service.upload("pump", &record("1", n));
    }
    service.service().feeds.add("mqtt");
    let pages = ["/metrics", "/metrics/machines"];
    let page = pages.map(|path| String::from_utf8(service.get(path).expect(200).bytes).unwrap()).concat();
    // Metrics of cluster processes.
    let page = page + &flankwatch::http::queue_metrics(&QueueOverview::default(), crate::running::minute(0));
    let mut measured: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for line in page.lines() {
        if let Some(head) = line.strip_prefix("# TYPE ") {
            let (name, kind) = head.split_once(' ').unwrap();
            let ends: &[&str] = if kind == "histogram" { &["_bucket", "_sum", "_count"] } else { &[""] };
            measured.extend(ends.iter().map(|end| (format!("{name}{end}"), BTreeSet::new())));
        } else if !line.starts_with('#') {
            let (name, labels) = metrics(line).remove(0);
            measured.get_mut(&name).unwrap().extend(labels);
        }
    }
    measured
}

#[test]
fn alerts_and_dashboards_use_existing_metrics() {
    let measured = measured();
    // Labels that Prometheus adds.
    let added = ["instance", "job"];
    let mut named = BTreeSet::new();
    for (of, expression) in expressions() {
        let all = metrics(&expression);
        assert!(!all.is_empty() || expression.contains("up{job=\"flankwatch\""), "{of}: {expression}");
        for (name, labels) in all {
            let known = measured.get(&name).unwrap_or_else(|| panic!("{of}: there is no metric {name}"));
            for label in labels {
                // A metric without samples shows no labels: wear needs an asset with a pair.
                let is_known = known.contains(&label) || added.contains(&label.as_str()) || known.is_empty();
                assert!(is_known, "{of}: {name} has no label {label}, it has {known:?}");
            }
            named.insert(name);
        }
    }
    for name in measured.keys() {
        assert!(named.contains(name), "{name} is on no dashboard and in no alert");
    }
    for (name, _) in metrics(&text("prometheus/rules.test.yaml")) {
        assert!(measured.contains_key(&name), "the alerts' tests: there is no metric {name}");
    }
    let jobs = &yaml("compose/prometheus.yml")[0]["scrape_configs"];
    assert_eq!(jobs[0]["job_name"], "flankwatch", "alerts and dashboards ask for this job");
    assert_eq!(jobs[1]["metrics_path"], "/metrics/machines", "machines are asked for once");
}

#[test]
fn every_alert_has_a_test() {
    let tests = text("prometheus/rules.test.yaml");
    for group in yaml("prometheus/rules.yaml")[0]["groups"].as_array().unwrap() {
        for rule in group["rules"].as_array().unwrap() {
            let alert = rule["alert"].as_str().unwrap();
            assert!(tests.contains(alert), "{alert}");
            assert!(rule["annotations"]["summary"].is_string() && rule["labels"]["severity"].is_string());
        }
    }
}

#[test]
fn dashboards_find_their_data_source() {
    let source = &yaml("grafana/provisioning/datasources/prometheus.yaml")[0]["datasources"][0];
    let provider = &yaml("grafana/provisioning/dashboards/flankwatch.yaml")[0]["providers"][0];
    let compose = &yaml("compose/compose.yaml")[0];
    let place = provider["options"]["path"].as_str().unwrap();
    let mounted = compose["services"]["grafana"]["volumes"].as_array().unwrap();
    assert!(mounted.contains(&format!("../grafana/dashboards:{place}:ro").into()), "{mounted:?}");
    let mut names = BTreeSet::new();
    for path in ending(&["dashboards/machines.json", "dashboards/service.json"]) {
        let dashboard: Value = serde_json::from_str(&text(&path)).unwrap();
        assert!(names.insert(dashboard["uid"].to_string()), "{path}");
        let mut panels = BTreeSet::new();
        for panel in dashboard["panels"].as_array().unwrap() {
            assert!(panels.insert(panel["id"].to_string()), "{path}: {}", panel["title"]);
            if panel["type"] != "row" {
                assert_eq!(panel["datasource"]["uid"], source["uid"], "{path}: {}", panel["title"]);
            }
        }
    }
}

/// Returns the command lines of the program in `deploy`, with their location.
fn command_lines() -> Vec<(String, Vec<String>)> {
    let words = |list: &Value| -> Vec<String> {
        list.as_array().unwrap().iter().map(|word| word.as_str().unwrap().to_owned()).collect()
    };
    let mut found = Vec::new();
    let unit = text("systemd/flankwatch.service");
    let start = unit.lines().find_map(|line| line.strip_prefix("ExecStart=/usr/bin/flankwatch ")).unwrap();
    found.push(("unit".to_owned(), start.split(' ').map(str::to_owned).collect()));
    let dockerfile = text("Dockerfile");
    let command = dockerfile.lines().find_map(|line| line.strip_prefix("CMD ")).unwrap();
    found.push(("Dockerfile".to_owned(), words(&serde_json::from_str(command).unwrap())));
    let compose = &yaml("compose/compose.yaml")[0];
    for (name, service) in compose["services"].as_object().unwrap() {
        if service["image"].as_str().unwrap().starts_with("flankwatch") {
            found.push((format!("compose, {name}"), words(&service["command"])));
        }
    }
    for path in manifests() {
        for manifest in yaml(&path) {
            for container in
                manifest["spec"]["template"]["spec"]["containers"].as_array().into_iter().flatten()
            {
                found.push((path.clone(), words(&container["args"])));
            }
        }
    }
    assert!(found.len() >= 7, "{found:?}");
    found
}

#[test]
fn commands_and_their_options_exist() {
    for (of, words) in command_lines() {
        let help =
            Command::new(env!("CARGO_BIN_EXE_flankwatch")).args([&words[0], "--help"]).output().unwrap();
        assert!(help.status.success(), "{of}: {}", words[0]);
        let help = String::from_utf8(help.stdout).unwrap();
        for option in words[1..].iter().filter(|word| word.starts_with("--")) {
            assert!(help.contains(&format!("{option} <")), "{of}: {option} in {help}");
        }
    }
}

#[test]
fn ports_match_the_listen_addresses() {
    let port = |words: &[String], option: &str| -> Option<String> {
        let at = words.iter().position(|word| word == option)?;
        Some(words[at + 1].rsplit(':').next().unwrap().to_owned())
    };
    let mut listening = BTreeMap::new();
    for (of, words) in command_lines() {
        listening.insert(of, port(&words, "--listen").or_else(|| port(&words, "--health")));
    }
    let given = |of: &str| listening[of].clone().unwrap();
    assert!(text("Dockerfile").contains(&format!("EXPOSE {}\n", given("Dockerfile"))));
    let compose = &yaml("compose/compose.yaml")[0]["services"];
    for node in ["api", "edge"] {
        assert_eq!(compose[node]["expose"][0], *given(&format!("compose, {node}")));
    }
    let scraped = &yaml("compose/prometheus.yml")[0]["scrape_configs"][0]["dns_sd_configs"][0];
    assert_eq!(scraped["port"].to_string(), given("compose, api"));
    let scraped = &yaml("compose/prometheus.yml")[0]["scrape_configs"][0]["dns_sd_configs"][1];
    assert_eq!(scraped["port"].to_string(), given("compose, worker"));
    let proxy = text("compose/proxy.conf");
    assert!(proxy.contains(&format!("server api:{} resolve;", given("compose, api"))));
    // Live streams.
    assert!(proxy.contains("proxy_set_header Upgrade $http_upgrade;"), "{proxy}");
    for path in manifests() {
        for manifest in yaml(&path) {
            let template = &manifest["spec"]["template"]["spec"]["containers"][0];
            if template.is_object() {
                let port = &template["ports"][0];
                assert_eq!(port["containerPort"].to_string(), given(&path));
                for probe in ["startupProbe", "livenessProbe", "readinessProbe"] {
                    let asked = &template[probe]["httpGet"];
                    assert_eq!(asked["port"], port["name"], "{path}: {probe}");
                    let paths = ["/healthz", "/readyz?for=reading", "/readyz?for=records"];
                    assert!(paths.contains(&asked["path"].as_str().unwrap()), "{path}: {probe}");
                }
            }
        }
    }
}

#[test]
fn the_packaged_settings_are_valid() {
    let data = tempfile::tempdir().unwrap();
    let settings = folder().join("systemd/flankwatch.toml");
    let program = Program::start_with(data.path(), &["--config", settings.to_str().unwrap()]);
    assert_eq!(program.get("/readyz")["status"], "ok");
    program.kill();
    let unit = text("systemd/flankwatch.service");
    assert!(unit.contains("--config /etc/flankwatch/flankwatch.toml"), "where README.md puts it");
}

/// Returns the error of settings that the program does not start with.
#[cfg(feature = "cluster")]
fn refusal(settings: &Path, command: &str) -> String {
    let data = tempfile::tempdir().unwrap();
    let mut program = Command::new(env!("CARGO_BIN_EXE_flankwatch"));
    program.args([command, "--config"]).arg(settings).arg("--data-dir").arg(data.path());
    if command == "serve" {
        program.args(["--listen", "127.0.0.1:0"]);
    }
    for name in ["DATABASE_URL", "NATS_PASSWORD", "S3_ACCESS_KEY_ID", "S3_SECRET_ACCESS_KEY"] {
        program.env_remove(format!("FLANKWATCH_{name}"));
    }
    let output = program.output().unwrap();
    assert!(!output.status.success());
    String::from_utf8(output.stderr).unwrap()
}

#[cfg(feature = "cluster")]
#[test]
fn settings_of_brokers_and_clusters_are_valid() {
    // All settings are valid; only the files they name are missing here.
    let error = refusal(&folder().join("systemd/mqtt.toml"), "serve");
    assert!(error.contains("/etc/flankwatch/broker-ca.pem"), "{error}");
    for path in ["compose/cluster.toml", "kubernetes/cluster.toml"].map(|path| folder().join(path)) {
        for command in ["serve", "work"] {
            let error = refusal(&path, command);
            assert!(error.contains("cluster.database.url is missing"), "{}: {error}", path.display());
        }
    }
}

#[test]
fn settings_of_notifications_are_valid() {
    use flankwatch::notifications::NotificationsTable;
    let settings: toml::Table = toml::from_str(&text("systemd/notifications.toml")).unwrap();
    let table: NotificationsTable = settings["notifications"].clone().try_into().unwrap();
    // A webhook's secret is a password too.
    let secret = |_: &str| Some("whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw".to_owned());
    let recipients = table.resolve(secret).unwrap().recipients();
    let names: Vec<&str> = recipients.list.iter().map(|recipient| recipient.name.as_str()).collect();
    assert_eq!(names, ["cmms", "night-shift"]);
}

#[test]
fn a_pods_disk_is_large_enough_for_concurrent_bodies() {
    let settings: toml::Table = toml::from_str(&text("kubernetes/cluster.toml")).unwrap();
    let limit = |name: &str| settings["limits"][name].as_integer().unwrap();
    let bodies = limit("recording_bytes") * limit("recordings_at_once");
    for path in ["kubernetes/api.yaml", "kubernetes/edge.yaml"] {
        let volumes = yaml(path)[0]["spec"]["template"]["spec"]["volumes"].as_array().unwrap().clone();
        let scratch = volumes.iter().find(|volume| volume["name"] == "scratch").unwrap();
        let size = scratch["emptyDir"]["sizeLimit"].as_str().unwrap();
        let bytes = size.strip_suffix("Gi").unwrap().parse::<i64>().unwrap() << 30;
        assert!(bodies < bytes, "{path}: {bodies} of {size}");
    }
}

#[test]
fn every_file_parses() {
    for path in ending(&[".yaml", ".yml"]) {
        assert!(!yaml(&path).is_empty(), "{path}");
    }
    for path in ending(&[".json"]) {
        serde_json::from_str::<Value>(&text(&path)).unwrap_or_else(|error| panic!("{path}: {error}"));
    }
    for path in ending(&[".toml"]) {
        toml::from_str::<toml::Table>(&text(&path)).unwrap_or_else(|error| panic!("{path}: {error}"));
    }
    // README.md describes each folder, and the files that compose mounts exist.
    let readme = text("README.md");
    for entry in fs::read_dir(folder()).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(name == "README.md" || readme.contains(&name), "{name} is not in deploy/README.md");
    }
    let compose = &yaml("compose/compose.yaml")[0];
    for (name, config) in compose["configs"].as_object().unwrap() {
        let file = folder().join("compose").join(config["file"].as_str().unwrap());
        assert!(file.is_file(), "{name}: {}", file.display());
    }
}
