//! The dashboard in a real browser, with a simulated run.

use std::io::Cursor;
use std::path::Path;
use std::process::Command;

use flankwatch::gear::PairSpec;
use flankwatch::recording::{BlockEncoding, McapOptions, McapWriter, WavWriter, encode_block};
use flankwatch::simulation::{Run, RunPlan};
use flankwatch::store::Scope;
use serde_json::json;

use crate::running::{Service, minute};
use crate::tokens::Tokens;
use flankwatch_test_support::needed;

const RECORDS: u32 = 120;

const PAIR: &str = include_str!("../../fixtures/pairs/shen2022.toml");

/// Browsers from the lightest on.
const BROWSERS: [&str; 2] = ["/usr/bin/chromium-headless-shell", "/usr/bin/chromium"];

#[test]
#[ignore = "needs Chromium, Node and npm install in tests/browser"]
fn the_dashboard_works_for_analysis() {
    check_in_browser("analysis");
}

#[test]
#[ignore = "needs Chromium, Node and npm install in tests/browser"]
fn the_dashboard_works_for_operation() {
    check_in_browser("operation");
}

/// Runs one part of the checks against services of its own.
fn check_in_browser(part: &str) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/browser");
    let chromium = std::env::var("FLANKWATCH_CHROMIUM").ok().or_else(|| {
        BROWSERS.iter().find(|browser| Path::new(browser).exists()).map(|&browser| browser.to_owned())
    });
    let ready = folder.join("node_modules/playwright-core").is_dir();
    let chromium = chromium.filter(|browser| ready && Path::new(browser).exists());
    let chromium = needed(chromium, "Chromium, or `npm install` in tests/browser,");
    let service = Service::start();
    let pair = PairSpec::from_toml(PAIR).unwrap();
    feed(&service, &pair);
    let (guarded, token) = guarded();
    let empty = Service::start();
    let records = tempfile::tempdir().unwrap();
    write_run(&pair, records.path());
    let recordings = service.folder().join("recordings");
    write_recording(&pair, &recordings.join("shift.mcap"));
    let output = Command::new("node")
        .arg(folder.join("dashboard.mjs"))
        .env("FLANKWATCH_PART", part)
        .env("FLANKWATCH_URL", service.url(""))
        .env("FLANKWATCH_ASSET", "gearbox")
        .env("FLANKWATCH_GUARDED_URL", guarded.url(""))
        .env("FLANKWATCH_TOKEN", token)
        .env("FLANKWATCH_EMPTY_URL", empty.url(""))
        .env("FLANKWATCH_RECORDS", records.path())
        .env("FLANKWATCH_REPLAYS", recordings)
        .env("FLANKWATCH_CHROMIUM", chromium)
        .output()
        .unwrap();
    let text =
        format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{text}");
    println!("{text}");
}

/// Writes the records of a short run to failure as WAV files with their start times in the names.
fn write_run(pair: &PairSpec, folder: &Path) {
    let run =
        Run::new(RunPlan { wear_exponent: 3.0, records: 30, interval_s: 3600.0, ..plan(pair) }).unwrap();
    for index in 0..run.plan().records {
        let record = run.record(index).unwrap().record;
        let mut bytes = Cursor::new(Vec::new());
        let mut writer = WavWriter::new(&mut bytes, 1, record.sample_rate_hz()).unwrap();
        for &sample in record.samples() {
            writer.write_frame(&[sample]).unwrap();
        }
        writer.finish().unwrap();
        let name = format!("run-{}.wav", record.start_time().strftime("%Y-%m-%dT%H-%M-%S"));
        std::fs::write(folder.join(name), bytes.get_ref()).unwrap();
    }
}

/// Writes the first records of a run as an MCAP recording.
fn write_recording(pair: &PairSpec, path: &Path) {
    let run = Run::new(plan(pair)).unwrap();
    let mut writer = McapWriter::new(Cursor::new(Vec::new()), McapOptions::default()).unwrap();
    for index in 0..6 {
        writer.write("/gearbox/x/waveform", &run.record(index).unwrap().record).unwrap();
    }
    std::fs::write(path, writer.finish().unwrap().into_inner()).unwrap();
}

/// Returns a run to failure that starts slowly enough for a healthy baseline.
fn plan(pair: &PairSpec) -> RunPlan {
    RunPlan {
        pair: pair.clone(),
        records: RECORDS,
        seconds: 1.0,
        sample_rate_hz: 20_000.0,
        max_wear_um: 245.0,
        wear_exponent: 2.0,
        start_time: minute(0),
        interval_s: 60.0,
        snr_db: 10.0,
        speed_variation: 0.005,
        torque_variation: 0.02,
        seed: 1,
        channel: "gearbox/x".to_owned(),
    }
}

/// Starts a service that requires a token, with an asset.
fn guarded() -> (Service, String) {
    let service = Service::start();
    service.plain_asset("pump");
    let token = Tokens::of(service.folder()).create("desk", Scope::Admin);
    (service, token)
}

/// Creates an asset with records of a run to failure.
fn feed(service: &Service, pair: &PairSpec) {
    let asset = json!({
        "id": "gearbox",
        "name": "Gearbox in a test",
        "gear": { "teeth": pair.geometry.teeth, "shaft_speed_hz": pair.operation.shaft_speed_hz, "pair": pair },
        "limits": { "warning_um": 120.0, "danger_um": 200.0 },
    });
    service.post_json("/v1/assets", &asset).expect(201);
    service.wait_for("/v1/assets/gearbox", |asset| asset["summary"]["library_state"] == "ready");
    let run = Run::new(plan(pair)).unwrap();
    for index in 0..RECORDS {
        let simulated = run.record(index).unwrap();
        let path = format!("/v1/assets/gearbox/segments?reference_wear_um={}", simulated.wear_um);
        let body = encode_block(&simulated.record, BlockEncoding::Protobuf);
        service.post(&path, "application/x-protobuf", &body).expect(201);
    }
    let wear = service.get("/v1/assets/gearbox/wear").expect(200).json();
    assert_eq!(wear["status"], "estimated", "{wear}");
}
