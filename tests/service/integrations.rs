//! Other programs that work with the service: Prometheus, Python's MCAP reader.

use std::net::TcpListener;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::running::{Service, record};
use flankwatch_test_support::needed;

/// A process that is killed with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn on_path(name: &str) -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&path).map(|folder| folder.join(name)).find(|path| path.is_file())
}

#[test]
#[ignore = "needs prometheus (apt install prometheus)"]
fn prometheus_scrapes_service_and_assets() {
    let program = needed(on_path("prometheus"), "prometheus (apt install prometheus)");
    let service = Service::start();
    service.plain_asset("pump");
    let segment = service.upload("pump", &record("1", 1));
    let folder = tempfile::tempdir().unwrap();
    let target = service.url("").trim_start_matches("http://").to_string();
    let job = |name: &str, path: &str| {
        format!("- job_name: {name}\n  metrics_path: {path}\n  static_configs:\n  - targets: ['{target}']\n")
    };
    let jobs = job("flankwatch", "/metrics") + &job("flankwatch-machines", "/metrics/machines");
    let config = format!("global: {{scrape_interval: 1s}}\nscrape_configs:\n{jobs}");
    std::fs::write(folder.path().join("prometheus.yml"), config).unwrap();
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let child = Command::new(program)
        .arg(format!("--config.file={}", folder.path().join("prometheus.yml").display()))
        .arg(format!("--storage.tsdb.path={}", folder.path().join("data").display()))
        .arg(format!("--web.listen-address={free}"))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let _prometheus = Running(child);
    let value = |query: &str| -> Option<f64> {
        let mut answer =
            ureq::get(format!("http://{free}/api/v1/query")).query("query", query).call().ok()?;
        let answer: Value = serde_json::from_str(&answer.body_mut().read_to_string().ok()?).ok()?;
        answer["data"]["result"][0]["value"][1].as_str()?.parse().ok()
    };
    let wait = |query: &str| {
        let began = Instant::now();
        loop {
            if let Some(value) = value(query) {
                return value;
            }
            assert!(began.elapsed() < Duration::from_secs(90), "no value of {query}");
            std::thread::sleep(Duration::from_millis(200));
        }
    };
    let rms = wait("flankwatch_indicator{asset=\"pump\",indicator=\"rms\"}");
    assert_eq!(Some(rms), segment["indicators"]["rms"].as_f64());
    assert_eq!(wait("flankwatch_segments"), 1.0);
    assert_eq!(
        wait(
            "flankwatch_request_duration_seconds_bucket{method=\"POST\",route=\"/v1/assets/{asset}/segments\",le=\"+Inf\"}"
        ),
        1.0
    );
    assert_eq!(wait("up{job=\"flankwatch\"}"), 1.0);
}

/// Prints the messages of an MCAP file, one JSON object per line.
const READ: &str = r#"
import json, sys
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
    assert reader.get_summary().statistics.message_count > 0
    for metadata in reader.iter_metadata():
        print(json.dumps({"topic": "metadata", "name": metadata.name, "entries": metadata.metadata}))
    for schema, channel, message, decoded in reader.iter_decoded_messages():
        out = {"topic": channel.topic, "schema": schema.name, "publish_time": message.publish_time}
        if schema.name.endswith("Indicators"):
            out["rms"] = decoded.values["rms"]
        elif schema.name.endswith("WearEstimate"):
            out["status"] = decoded.status
        else:
            out["peak"] = max(decoded.amplitude)
            out["points"] = len(decoded.frequency_hz)
            assert len(decoded.frequency_hz) == len(decoded.amplitude)
        print(json.dumps(out))
"#;

#[test]
fn the_spectra_of_an_export_are_spread_over_its_records() {
    let service = Service::start();
    service.plain_asset("pump");
    for n in 0..12 {
        service.upload("pump", &record("1", n));
    }
    let range = "from=2026-01-01T00:04:00Z&to=2026-01-01T00:08:00Z";
    for (spectra, expected) in [(4, 4), (2, 2), (0, 0)] {
        let export = service.get(&format!("/v1/assets/pump/export?{range}&spectra={spectra}")).expect(200);
        let messages = mcap::MessageStream::new(&export.bytes).unwrap().map(Result::unwrap);
        let count = messages.filter(|message| message.channel.topic == "/pump/1/spectrum").count();
        assert_eq!(count, expected, "{spectra}");
    }
}

#[test]
fn each_channel_has_its_share_of_the_spectra_of_an_export() {
    let service = Service::start();
    service.plain_asset("pump");
    for n in 0..6 {
        for channel in ["1", "2"] {
            service.upload("pump", &record(channel, n));
        }
    }
    let export = service.get("/v1/assets/pump/export?spectra=6").expect(200);
    let messages = mcap::MessageStream::new(&export.bytes).unwrap().map(Result::unwrap);
    let topics: Vec<String> = messages.map(|message| message.channel.topic.clone()).collect();
    for topic in ["/pump/1/spectrum", "/pump/2/spectrum"] {
        assert_eq!(topics.iter().filter(|name| *name == topic).count(), 3, "{topic}");
    }
}

#[test]
fn an_export_has_only_records_of_the_requested_statuses() {
    let service = Service::start();
    service.plain_asset("pump");
    let segments: Vec<Value> = (0..10).map(|n| service.upload("pump", &record("1", n))).collect();
    let last = segments[9]["wear"]["status"].as_str().unwrap();
    assert_ne!(segments[0]["wear"]["status"], last);
    let count = |query: &str, kind: &str| {
        let export = service.get(&format!("/v1/assets/pump/export?{query}")).expect(200);
        let topic = format!("/pump/1/{kind}");
        let messages = mcap::MessageStream::new(&export.bytes).unwrap().map(Result::unwrap);
        messages.filter(|message| message.channel.topic == topic).count()
    };
    for query in [format!("status={last}&spectra=1"), format!("status={last}&spectra=1&waveforms=true")] {
        assert_eq!((count(&query, "wear"), count(&query, "spectrum")), (2, 1), "{query}");
    }
    assert_eq!(count("status=collecting_baseline,excluded", "indicators"), 8);
    service
        .get("/v1/assets/pump/export?status=healthy")
        .expect_problem(400, &["status", "healthy", "collecting_baseline"]);
}

#[test]
#[ignore = "needs Python's MCAP reader (pip install mcap mcap-protobuf-support)"]
fn pythons_reader_opens_an_exported_history() {
    let python = on_path("python3").filter(|python| {
        let has_reader =
            Command::new(python).args(["-c", "import mcap.reader, mcap_protobuf.decoder"]).output();
        has_reader.is_ok_and(|output| output.status.success())
    });
    let python = needed(python, "Python's MCAP reader (pip install mcap mcap-protobuf-support)");
    let service = Service::start();
    service.plain_asset("pump");
    let segments: Vec<Value> = (0..6).map(|n| service.upload("pump", &record("in", n))).collect();
    service.upload("pump", &record("out", 9));
    let export = service.get("/v1/assets/pump/export?channel=in&spectra=3").expect(200);
    assert_eq!(export.header("content-type"), "application/mcap");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pump.mcap");
    std::fs::write(&path, &export.bytes).unwrap();
    let output = Command::new(python).args(["-c", READ]).arg(&path).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines = String::from_utf8(output.stdout).unwrap();
    let messages: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let (metadata, messages): (Vec<Value>, Vec<Value>) =
        messages.into_iter().partition(|message| message["topic"] == "metadata");
    let names: Vec<&str> = metadata.iter().map(|record| record["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["asset", "sensor", "gear_pair", "acquisition"]);
    assert_eq!(metadata[2]["entries"]["teeth"], "[31,62]");
    assert_eq!(metadata[3]["entries"]["channel"], "in");
    let of = |kind: &str| -> Vec<&Value> {
        messages.iter().filter(|message| message["topic"] == format!("/pump/in/{kind}")).collect()
    };
    assert_eq!(messages.len(), 6 + 6 + 3);
    let rms: Vec<&Value> = of("indicators").iter().map(|message| &message["rms"]).collect();
    let expected: Vec<&Value> = segments.iter().map(|segment| &segment["indicators"]["rms"]).collect();
    assert_eq!(rms, expected);
    assert!(of("wear").iter().all(|message| message["status"] == "collecting_baseline"));
    assert_eq!(of("spectrum").len(), 3);
    let spectrum = service
        .get(&format!("/v1/segments/{}/spectrum?max_points=200000", segments[0]["id"].as_str().unwrap()));
    let spectrum = spectrum.expect(200).json();
    let peak =
        spectrum["amplitude"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).fold(0.0, f64::max);
    assert_eq!(of("spectrum")[0]["peak"].as_f64(), Some(peak));
    let left: Vec<_> = std::fs::read_dir(service.folder().join("uploads")).unwrap().collect();
    assert!(left.is_empty(), "{left:?}");
    service.get("/v1/assets/none/export").expect_problem(404, &["none"]);
    service.get("/v1/assets/pump/export?spectra=99999").expect_problem(400, &["spectra"]);
}
