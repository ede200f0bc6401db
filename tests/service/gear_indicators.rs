//! Indicators over the shaft angle, from the upload to the trend and on the command line.

use std::io::Cursor;

use flankwatch::recording::{BlockEncoding, McapOptions, McapReader, McapWriter, encode_block};
use flankwatch::signal::{GEAR_PREPROCESSING, OperatingPoint, PREPROCESSING, Quality, Record, Tachometer};
use prost::Message;
use serde_json::{Value, json};

use crate::command::flankwatch;
use crate::running::{Service, minute, plain_asset};
#[cfg(not(feature = "cluster"))]
use crate::stream_socket::StreamSocket;

const RATE_HZ: f64 = 4000.0;

/// Returns the revolutions after `t` seconds of a shaft at 10 Hz with 2 % speed fluctuation.
fn revolutions(t: f64) -> f64 {
    10.0 * (t + 0.02 * (1.0 - (2.0 * t).cos()) / 2.0)
}

/// Returns two seconds of a 31-tooth mesh, modulated once per revolution, with an impact per revolution and
/// noise that grow with `n`.
fn turning(n: u32) -> Record {
    let mut state = n.wrapping_mul(2_654_435_761).wrapping_add(99);
    let samples = (0..8000).map(|k| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let noise = f64::from(state >> 8) / f64::from(1 << 24) - 0.5;
        let angle = std::f64::consts::TAU * revolutions(f64::from(k) / RATE_HZ);
        let mesh = (1.0 + 0.1 * angle.cos()) * ((31.0 * angle).sin() + 0.4 * (62.0 * angle).sin());
        let impact = 0.05 * f64::from(n) * (8.0 * (angle.cos() - 1.0)).exp() * (43.0 * angle).sin();
        (mesh + impact + 0.02 * f64::from(n) * noise) as f32
    });
    Record::new("1", minute(n.into()), RATE_HZ, "m/s2", samples.collect()).unwrap()
}

/// Returns two seconds of white noise.
fn noise() -> Vec<f32> {
    let mut state = 5u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32 - 0.5
    };
    (0..8000).map(|_| next()).collect()
}

/// Returns a pulse per revolution from the first sample on; 21 revolutions exceed a record.
fn pulse_times_s(turns: u32) -> Vec<f64> {
    (0..=turns)
        .map(|turn| {
            let mut t = f64::from(turn) / 10.0;
            for _ in 0..50 {
                t += (f64::from(turn) - revolutions(t)) / 10.0;
            }
            t
        })
        .collect()
}

fn with_tachometer(n: u32) -> Record {
    turning(n)
        .with_tachometer(Some(Tachometer { pulse_times_s: pulse_times_s(21), pulses_per_revolution: 1 }))
}

fn value(segment: &Value, name: &str) -> f64 {
    segment["indicators"][name].as_f64().unwrap_or_else(|| panic!("{name} in {segment}"))
}

#[test]
fn a_record_has_gear_indicators_and_the_source_of_its_shaft_angle() {
    let service = Service::start();
    service.plain_asset("pump");
    let segment = service.upload("pump", &turning(3));
    assert_eq!(segment["preprocessing"], format!("{PREPROCESSING}+{GEAR_PREPROCESSING}"));
    assert_eq!(segment["shaft_angle"]["source"], "mesh_phase");
    assert!(segment["shaft_angle"]["angle_error_deg"].as_f64().unwrap() < 2.0);
    // The generated amplitude, despite the fluctuating speed.
    assert!((value(&segment, "omx_tracked") - 1.0).abs() < 0.03, "{segment}");
    for name in [
        "fm0",
        "fm4",
        "m6a",
        "m8a",
        "energy_ratio",
        "sideband_energy_ratio",
        "sideband_level_factor",
        "na4",
        "nb4",
    ] {
        assert!(value(&segment, name) > 0.0);
    }
    let by_pulses = service.upload("pump", &with_tachometer(3));
    let angle = &by_pulses["shaft_angle"];
    assert_eq!((&angle["source"], &angle["pulses"]), (&json!("tachometer"), &json!(22)), "{angle}");
    assert_eq!(by_pulses["shaft_speed"]["source"], "tachometer");
    assert!((value(&by_pulses, "omx_tracked") - 1.0).abs() < 0.01);

    let uneven = turning(4).with_tachometer(Some(Tachometer {
        pulse_times_s: vec![0.0, 0.1, 0.2, 0.4, 0.5],
        pulses_per_revolution: 1,
    }));
    let angle = service.upload("pump", &uneven)["shaft_angle"].clone();
    assert_eq!(angle["source"], "mesh_phase");
    assert!(angle["tachometer_refused"].as_str().unwrap().contains("a pulse is missing"), "{angle}");
}

/// Pulses arrive before their samples and survive a restart.
#[cfg(not(feature = "cluster"))]
#[test]
fn pulses_accompany_the_records_of_a_stream() {
    let mut service = Service::start();
    let mut asset = plain_asset("pump");
    asset["stream"] = json!({ "record_s": 2, "interval_s": 2 });
    service.post_json("/v1/assets", &asset).expect(201);
    let path = format!("/v1/assets/pump/stream?sample=f32&sample_rate_hz={RATE_HZ}&channels=2&first_index=0");
    let open = |service: &Service| StreamSocket::open(&service.url(&path), &[]).unwrap();
    let frames = |from: u64, until: u64| -> Vec<u8> {
        let values = (from..until).flat_map(|k| {
            let mesh = (31.0 * std::f64::consts::TAU * revolutions(k as f64 / RATE_HZ)).sin() as f32;
            [mesh, 2.0 * mesh]
        });
        values.flat_map(f32::to_le_bytes).collect()
    };
    let pulses: Vec<f64> = pulse_times_s(41).into_iter().map(|time_s| time_s * RATE_HZ).collect();
    let begin_ns = 1_767_225_600_000_000_000;
    let mut socket = open(&service);
    socket
        .send_json(&json!({ "type": "tachometer", "from": 0, "pulses": pulses, "pulses_per_revolution": 1 }));
    socket.send(0, begin_ns, &frames(0, 9000));
    socket.wait_for(9000);
    service.restart();
    let mut socket = open(&service);
    // Among samples already received: too late.
    socket.send_json(&json!({ "type": "tachometer", "from": 8500, "pulses": [1, 2, 3] }));
    socket.send(9000, begin_ns + 2_250_000_000, &frames(9000, 16_000));
    socket.wait_for(16_000);
    service.wait_for("/v1/assets/pump/stream", |status| status["records"] == 2);
    let page = service.get("/v1/assets/pump/segments").expect(200).json();
    let segments = page["items"].as_array().unwrap();
    assert_eq!(segments.len(), 4, "{page}");
    for segment in segments {
        let angle = &segment["shaft_angle"];
        assert_eq!(
            (&angle["source"], &angle["tachometer_refused"]),
            (&json!("tachometer"), &Value::Null),
            "{angle}"
        );
        assert_eq!(segment["shaft_speed"]["source"], "tachometer");
        let amplitude = if segment["channel"] == "1" { 1.0 } else { 2.0 };
        assert!((value(segment, "omx_tracked") - amplitude).abs() < 0.02, "{segment}");
    }
    socket.send_json(&json!({ "type": "tachometer", "from": 16_000, "pulses": [5, 5] }));
    let (code, reason) = socket.receive().unwrap_err();
    assert!(code == 4400 && reason.contains("pulses is 5 and then 5"), "{code} {reason}");
}

#[test]
fn indicators_that_cannot_be_computed_are_absent_with_a_reason() {
    let service = Service::start();
    service.plain_asset("pump");
    let upload = |record: Record| service.upload("pump", &record);
    let flagged = |quality| upload(turning(2).with_quality(quality));
    let clipped = flagged(Quality { clipped: true, gap: false });
    assert_eq!(clipped["quality"], json!({ "clipped": true, "gap": false }));
    for name in ["fm4", "na4", "nb4", "omx_tracked", "kurtosis", "crest_factor", "peak"] {
        assert_eq!(clipped["absent"][name], "clipped", "{name}");
    }
    assert!(clipped["indicators"]["rms"].is_number());
    // A gap before the record leaves the record whole.
    let after_gap = flagged(Quality { clipped: false, gap: true });
    assert_eq!(after_gap["quality"]["gap"], true);
    assert!(after_gap["indicators"]["fm4"].is_number());

    let of =
        |n: u32, samples: Vec<f32>| Record::new("1", minute(n.into()), RATE_HZ, "m/s2", samples).unwrap();
    let mut gap = turning(5).samples().to_vec();
    gap[1000..1200].fill(0.0);
    assert_eq!(upload(of(5, gap))["absent"]["fm4"], "gaps");
    assert_eq!(upload(of(6, turning(6).samples()[..1200].to_vec()))["absent"]["na4"], "too_few_turns");
    assert_eq!(upload(of(7, vec![1.5; 4000]))["absent"]["fm0"], "constant");
    assert_eq!(upload(of(8, noise()))["absent"]["m8a"], "no_speed");

    let mut without = plain_asset("without");
    without["gear_indicators"] = json!(false);
    service.post_json("/v1/assets", &without).expect(201);
    let segment = service.upload("without", &turning(1));
    assert!(segment["indicators"].get("fm4").is_none() && segment["absent"].get("fm4").is_none());
    assert!(segment["absent"].get("na4").is_none() && segment.get("shaft_angle").is_none());
}

/// NA4 and NB4 of a run have the same bits for any order of records and any restarts.
#[test]
fn run_means_do_not_depend_on_order_repeats_or_restarts() {
    let mut service = Service::start();
    for id in ["in-order", "shuffled", "restarted"] {
        service.plain_asset(id);
    }
    let trend = |service: &Service, id: &str| {
        let path =
            format!("/v1/assets/{id}/indicators?names=na4,nb4,residual_variance,residual_fourth_moment");
        let mut trend = service.get(&path).expect(200).json();
        for item in trend["items"].as_array_mut().unwrap() {
            item.as_object_mut().unwrap().remove("segment_id");
        }
        trend
    };
    for n in 1..=7 {
        service.upload("in-order", &turning(n));
    }
    for n in [4, 2, 7, 7, 1, 6, 3, 2, 5] {
        service.upload("shuffled", &turning(n));
        // Requested in between, so that the state in memory must be updated.
        trend(&service, "shuffled");
    }
    for n in [2, 1, 3] {
        service.upload("restarted", &turning(n));
    }
    service.restart();
    for n in [4, 5, 3] {
        service.upload("restarted", &turning(n));
    }
    service.restart();
    for n in [7, 6] {
        service.upload("restarted", &turning(n));
    }
    let expected = trend(&service, "in-order");
    assert_eq!(trend(&service, "shuffled"), expected);
    assert_eq!(trend(&service, "restarted"), expected);
    // Zakrajsek's definition from what is kept of each record.
    let items = expected["items"].as_array().unwrap();
    assert_eq!(
        (items.len(), &expected["units"]["na4"], &expected["units"]["residual_variance"]),
        (7, &json!("1"), &json!("(m/s2)^2"))
    );
    let (mut sum, mut before) = (0.0, 0.0);
    for (n, item) in items.iter().enumerate() {
        sum += item["residual_variance"].as_f64().unwrap();
        let mean = sum / (n + 1) as f64;
        let want = item["residual_fourth_moment"].as_f64().unwrap() / (mean * mean);
        let na4 = item["na4"].as_f64().unwrap();
        assert!((na4 / want - 1.0).abs() < 1e-12, "{item}");
        assert!(na4 > before, "damage that grows raises it: {items:?}");
        before = na4;
    }
}

/// Returns a file with tachometer messages before and after their waveforms, in protobuf and in JSON.
fn recording(encoding: &str, tachometer_first: bool) -> Vec<u8> {
    use flankwatch::recording::message;
    let mut writer = mcap::WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
    let (mut topics, mut sequence) = (Vec::new(), 0);
    for (schema, topic) in [("WaveformBlock", "/pump/1/waveform"), ("Tachometer", "/pump/tachometer")] {
        let schema = writer.add_schema(&format!("flankwatch.v1.{schema}"), encoding, &[]).unwrap();
        topics.push(writer.add_channel(schema, topic, encoding, &std::collections::BTreeMap::new()).unwrap());
    }
    for n in 1..=3 {
        let record = turning(n);
        let start_ns = i64::try_from(record.start_time().as_nanosecond()).unwrap();
        let pulse_time_ns: Vec<i64> =
            pulse_times_s(21).iter().map(|t| start_ns + (t * 1e9).round() as i64).collect();
        let (block, pulses) = if encoding == "protobuf" {
            let tachometer =
                message::Tachometer { pulse_time_ns, pulses_per_revolution: 1, shaft: "driving".to_owned() };
            (encode_block(&record, BlockEncoding::Protobuf), tachometer.encode_to_vec())
        } else {
            let tachometer = json!({ "pulse_time_ns": pulse_time_ns, "pulses_per_revolution": 1 });
            (encode_block(&record, BlockEncoding::Json), tachometer.to_string().into_bytes())
        };
        let mut messages = [(topics[0], block), (topics[1], pulses)];
        if tachometer_first {
            messages.reverse();
        }
        for (channel_id, data) in messages {
            sequence += 1;
            let header = mcap::records::MessageHeader {
                channel_id,
                sequence,
                log_time: start_ns as u64,
                publish_time: start_ns as u64,
            };
            writer.write_to_known_channel(&header, &data).unwrap();
        }
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

#[test]
fn tachometer_messages_of_a_recording_reach_its_records() {
    let service = Service::start();
    service.plain_asset("pump");
    let expected = service.upload("pump", &with_tachometer(2));
    for (n, (encoding, first)) in
        [("protobuf", false), ("protobuf", true), ("json", false)].into_iter().enumerate()
    {
        let bytes = recording(encoding, first);
        let records: Vec<_> = McapReader::new(Cursor::new(bytes.clone())).map(Result::unwrap).collect();
        assert_eq!(records.len(), 3);
        for recorded in &records {
            assert_eq!(recorded.record.tachometer().unwrap().pulse_times_s.len(), 22, "{encoding}");
            // The stored block includes the pulses.
            let again =
                flankwatch::recording::decode_block(&recorded.raw, recorded.encoding, &Default::default())
                    .unwrap();
            assert_eq!(again.tachometer(), recorded.record.tachometer());
        }
        let asset = format!("pump-{n}");
        service.plain_asset(&asset);
        let answer = service
            .post(&format!("/v1/assets/{asset}/segments"), "application/mcap", &bytes)
            .expect(201)
            .json();
        assert_eq!((&answer["stored"], &answer["refused_count"]), (&json!(3), &json!(0)), "{answer}");
        let segments = service.get(&format!("/v1/assets/{asset}/segments")).expect(200).json();
        let second = &segments["items"][1];
        assert_eq!(second["shaft_angle"], expected["shaft_angle"]);
        for name in ["omx_tracked", "fm4", "fm0"] {
            assert_eq!(second["indicators"][name], expected["indicators"][name], "{name}");
        }
    }
}

#[test]
fn the_command_line_prints_gear_indicators_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let mut writer = McapWriter::new(Cursor::new(Vec::new()), McapOptions::default()).unwrap();
    for n in 1..=4 {
        writer.write("/pump/1/waveform", &with_tachometer(n)).unwrap();
    }
    std::fs::write(at("run.mcap"), writer.finish().unwrap().into_inner()).unwrap();
    std::fs::write(at("asset.toml"), "id = \"pump\"\n[gear]\nteeth = [31, 62]\nshaft_speed_hz = 10\n")
        .unwrap();
    let analyze = |format: &str| {
        let (run, asset, report) = (at("run.mcap"), at("asset.toml"), at("report.html"));
        let mut words = vec!["analyze", &run, "--asset", &asset, "--format", format, "--report", &report];
        if format == "table" {
            words.extend(["--columns", "omx_tracked,na4,angle"]);
        }
        flankwatch(&words).expect_success().out()
    };
    let table = analyze("table");
    assert!(
        table.contains("omx_tracked") && table.contains("na4") && table.contains("tachometer ± 0."),
        "{table}"
    );
    let json: Value = serde_json::from_str(&analyze("json")).unwrap();
    assert_eq!(json[3]["shaft_angle"]["source"], "tachometer");
    let csv = analyze("csv");
    let mut rows = csv::Reader::from_reader(csv.as_bytes());
    let column = rows.headers().unwrap().iter().position(|name| name == "nb4").unwrap();
    let nb4: Vec<f64> = rows.records().map(|row| row.unwrap()[column].parse().unwrap()).collect();
    let html = std::fs::read_to_string(at("report.html")).unwrap();
    assert!(html.contains("NA4") && html.contains("tachometer ±"));

    // The service gives the same values for the same records.
    let service = Service::start();
    service.plain_asset("pump");
    for (n, nb4) in (1..=4).zip(nb4) {
        let segment = service.upload("pump", &with_tachometer(n));
        for name in ["na4", "nb4", "fm4"] {
            assert_eq!(segment["indicators"][name], json[n as usize - 1]["indicators"][name], "{name}");
        }
        assert_eq!(value(&segment, "nb4"), nb4);
    }
}

/// The tachometer's speed is used instead of searching for a mesh line, which noise hides here.
#[test]
fn a_tachometer_gives_the_speed_too() {
    let record = Record::new("1", minute(0), RATE_HZ, "m/s2", noise()).unwrap();
    let record = record.with_tachometer(with_tachometer(1).tachometer().cloned());
    assert_eq!(record.operating_point(), OperatingPoint::default());
    let service = Service::start();
    service.plain_asset("pump");
    let segment = service.upload("pump", &record);
    assert_eq!(segment["shaft_speed"]["source"], "tachometer");
    assert!((segment["shaft_speed"]["shaft_speed_hz"].as_f64().unwrap() - 10.0).abs() < 0.2);
    assert!(segment["indicators"]["fm4"].is_number() && segment["indicators"]["omx"].is_number());
}
