//! Commands that send to a server: what they refuse, and what they say about what they did.

use std::fs;
use std::io::Write;
use std::process::{Child, ChildStdin, Command, Stdio};

use flankwatch::signal::Record;
use serde_json::json;

use crate::command::flankwatch;
use crate::running::{Service, mcap, plain_asset, record, wav};

/// Raw samples as 32-bit floats.
fn raw(count: usize) -> Vec<u8> {
    (0..count).flat_map(|n| (n as f32).to_le_bytes()).collect()
}

#[test]
fn stream_names_what_differs_and_refuses_a_time_that_the_stream_has_passed() {
    let service = Service::start();
    service.plain_asset("pump");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("samples.raw");
    fs::write(&path, raw(2000)).unwrap();
    let (path, url) = (path.to_str().unwrap(), service.url(""));
    let words = |rate: &'static str, start: &'static str| {
        ["--asset", "pump", "--url", &url, "--sample", "f32", "--rate", rate, "--start-time", start]
    };
    let stream = |rate, start| flankwatch(&[&["stream", path], &words(rate, start)[..]].concat());
    let sent = stream("1000", "2026-01-01T00:00:00Z").expect_success().out();
    assert!(sent.starts_with("2000 samples of each channel sent to "), "{sent}");
    let again = stream("1000", "2026-01-01T00:00:00Z").expect_success().out();
    assert!(again.starts_with("0 samples") && again.ends_with("which had 2000 already\n"), "{again}");
    let part = stream("1000", "2026-01-01T00:00:01Z").expect_success().out();
    assert!(part.starts_with("1000 samples") && part.ends_with("which had 1000 already\n"), "{part}");
    let continues = ["stream main already continues to 2026-01-01T00:00:03Z", "--start-time", "--name"];
    stream("1000", "2025-12-31T23:59:00Z").expect_failure(&continues);
    let differs = ["409", "sample_rate_hz is 2000, expected 1000 as in stream \"main\""];
    stream("2000", "2025-12-31T23:59:00Z").expect_failure(&differs);

    let mut piped = Command::new(env!("CARGO_BIN_EXE_flankwatch"))
        .args(["stream", "-"])
        .args(words("1000", "2025-12-31T23:59:00Z"))
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    piped.stdin.take().unwrap().write_all(&raw(500)).unwrap();
    let ended = piped.wait_with_output().unwrap();
    let error = String::from_utf8_lossy(&ended.stderr);
    assert!(!ended.status.success() && error.contains(continues[0]), "{error}");
}

/// Starts `flankwatch stream` with samples of standard input, and sends a first block.
fn piped(url: &str) -> (Child, ChildStdin) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_flankwatch"))
        .args(["stream", "-", "--asset", "pump", "--url", url, "--sample", "f32", "--rate", "1000"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut pipe = child.stdin.take().unwrap();
    pipe.write_all(&raw(250)).unwrap();
    (child, pipe)
}

#[test]
fn stream_fails_when_another_sender_sends_the_stream_too() {
    let service = Service::start();
    service.plain_asset("pump");
    let url = service.url("");
    let next = || service.get("/v1/assets/pump/streams").expect(200).json()["items"][0]["next"].as_u64();
    let stored_beyond = |before: u64| {
        let began = std::time::Instant::now();
        while next().is_none_or(|next| next <= before) {
            assert!(began.elapsed() < std::time::Duration::from_secs(60), "nothing is stored");
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
        next().unwrap()
    };
    let (first, mut first_pipe) = piped(&url);
    let to = stored_beyond(0);
    let (second, second_pipe) = piped(&url);
    stored_beyond(to);
    // The samples of the first one are of a time that the second one has sent.
    first_pipe.write_all(&raw(250)).unwrap();
    drop(first_pipe);
    let ended = first.wait_with_output().unwrap();
    let error = String::from_utf8_lossy(&ended.stderr);
    let words = ["samples of each channel at", "another sender sends stream main", "--name"];
    assert!(!ended.status.success() && words.iter().all(|word| error.contains(word)), "{error}");
    let out = String::from_utf8_lossy(&ended.stdout);
    assert!(out.starts_with("250 samples") && !out.contains("already"), "{out}");
    drop(second_pipe);
    let ended = second.wait_with_output().unwrap();
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
}

#[test]
fn stream_reports_refused_records_and_an_incomplete_frame() {
    let service = Service::start();
    let mut asset = plain_asset("pump");
    asset["stream"] = json!({ "record_s": 1, "interval_s": 1 });
    service.post_json("/v1/assets", &asset).expect(201);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("samples.raw");
    let (path, url) = (path.to_str().unwrap(), service.url(""));
    let words = ["--asset", "pump", "--url", &url, "--sample", "f32", "--rate", "1000", "--unit"];
    let stream = |unit: &str, start: &str, more: &[&str]| {
        flankwatch(&[&["stream", path], &words[..], &[unit, "--start-time", start], more].concat())
    };
    // In m/s² they are beyond the range of a sample.
    fs::write(path, 3e38_f32.to_le_bytes().repeat(2000)).unwrap();
    let refused = stream("g", "2026-01-01T00:00:00Z", &[]);
    assert!(refused.out().starts_with("2000 samples"), "{}", refused.out());
    refused.expect_failure(&["2 records refused, the last one because "]);
    // Those of earlier runs are not reported again.
    fs::write(path, raw(1000)).unwrap();
    stream("g", "2026-01-01T00:01:00Z", &[]).expect_success();
    stream("V", "2026-01-01T00:02:00Z", &["--name", "volts"]).expect_failure(&["422", "V", "m/s2"]);
    let three = ["--name", "three", "--channels", "3"];
    let ended = stream("g", "2026-01-01T00:02:00Z", &three);
    assert!(ended.out().starts_with("333 samples"), "{}", ended.out());
    ended.expect_failure(&["samples.raw: it ends within a frame: 4 bytes follow", "frames of 12 bytes"]);
}

#[test]
fn replay_needs_times_and_goes_on_after_a_file_that_cannot_be_sent() {
    let service = Service::start();
    service.plain_asset("pump");
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let good = write("a.mcap", &mcap(&[record("1", 1)]));
    let bad = write("b.mcap", b"\x89MCAP0\r\nno records");
    let undated = write("c.wav", &wav(&[vec![0.5; 4000], vec![0.25; 4000]]));
    let volts = Record::new("1", "2026-01-05T00:00:00Z".parse().unwrap(), 4000.0, "V", vec![1.0; 4000]);
    let refused = write("v.mcap", &mcap(&[volts.unwrap(), record("1", 3)]));
    let last = write("d.mcap", &mcap(&[record("1", 2)]));
    let url = service.url("");
    let to = ["--asset", "pump", "--url", &url];
    let output = flankwatch(&[&["replay", &good, &bad, &undated, &refused, &last], &to[..]].concat());
    assert!(output.out().starts_with("2 records sent to "), "{}", output.out());
    output.expect_failure(&[
        "b.mcap",
        "c.wav: no time in the recording, expected --start-time or --time-from-name",
        "v.mcap: channel 1 at 2026-01-05T00:00:00Z: the server answered 422: ",
        "3 of 5 files could not be sent completely",
    ]);
    let unknown = ["--asset", "fan", "--url", &url];
    flankwatch(&[&["replay", &good, &last], &unknown[..]].concat())
        .expect_failure(&["a.mcap: channel 1 at 2026-01-01T00:01:00Z: the server answered 404: "]);
    let one = ["--start-time", "2026-01-02T00:00:00Z", "--channels", "2"];
    let output = flankwatch(&[&["replay", &undated], &to[..], &one].concat()).expect_success();
    assert!(output.out().starts_with("1 record sent to "), "{}", output.out());
    let channels = &service.get("/v1/assets/pump").expect(200).json()["summary"]["channels"];
    assert_eq!(channels, &json!(["1", "2"]));
    let none = ["--start-time", "2026-01-02T00:00:00Z", "--channels", "3"];
    flankwatch(&[&["replay", &undated], &to[..], &none].concat()).expect_failure(&[
        "c.wav",
        "channel is \"3\"",
        "in the recording: 1, 2",
    ]);
}

#[test]
fn a_baseline_is_chosen_among_records_and_their_number_is_printed() {
    let service = Service::start();
    service.post_json("/v1/assets", &plain_asset("pump")).expect(201);
    for n in 0..12 {
        service.upload("pump", &record("1", n));
    }
    let url = service.url("");
    let baseline = |from: &str, to: &str| {
        let range = ["--from", from, "--to", to, "--by", "Ada"];
        flankwatch(&[&["baseline", "--asset", "pump", "--url", &url][..], &range].concat())
    };
    let (begin, end) = ("2026-01-01T00:00:00Z", "2026-01-01T00:10:00Z");
    let chosen = baseline(begin, end).expect_success();
    assert!(chosen.out().starts_with("10 records from ") && chosen.err().is_empty(), "{}", chosen.out());
    let few = baseline(begin, "2026-01-01T00:03:00Z").expect_success();
    assert!(few.out().starts_with("3 records from "), "{}", few.out());
    assert!(few.err().contains("a baseline needs at least 8 records"), "{}", few.err());
    baseline("2025-01-01T00:00:00Z", "2025-02-01T00:00:00Z")
        .expect_failure(&["has no record from 2025-01-01"]);
    baseline(end, begin).expect_failure(&["--to is 2026-01-01T00:00:00Z, expected a time after --from"]);
    flankwatch(&["baseline", "--asset", "pump", "--from", begin, "--to", end]).expect_failure(&["--by"]);
    flankwatch(&["delete", "--asset", "pump", "--from", end, "--to", begin]).expect_failure(&["--to is"]);
}

#[test]
fn export_says_which_channel_it_wrote() {
    let service = Service::start();
    service.plain_asset("pump");
    for channel in ["1", "gearbox/x"] {
        for n in 0..2 {
            service.upload("pump", &record(channel, n));
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let (path, url) = (folder.path().join("e.csv").display().to_string(), service.url(""));
    let words = ["export", "indicators", &path, "--asset", "pump", "--url", &url];
    let output = flankwatch(&words).expect_success().out();
    let expected =
        format!("2 records of channel \"1\" in {path} (other channels: gearbox/x; see --channel)\n");
    assert_eq!(output, expected);
    let one = flankwatch(&[&words[..], &["--channel", "gearbox/x"]].concat()).expect_success().out();
    assert_eq!(one, format!("2 records of channel \"gearbox/x\" in {path}\n"));
}
