//! Invalid requests and their problem responses.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use flankwatch::recording::{BlockEncoding, encode_block};
use serde_json::json;

use crate::running::{Service, mcap, record, samples, wav};

#[test]
fn an_invalid_path_method_type_or_parameter_is_answered_with_a_problem() {
    let service = Service::start();
    service.plain_asset("pump");
    service.get("/v1/nothing").expect_problem(404, &["/v1/nothing"]);
    let wrong_method = service.send("PATCH", "/v1/assets", &[], b"");
    assert_eq!(wrong_method.header("allow"), "GET,HEAD,POST");
    wrong_method.expect_problem(405, &["PATCH"]);
    let segments = "/v1/assets/pump/segments";
    service.post(segments, "image/png", b"x").expect_problem(415, &["image/png", "audio/wav"]);
    service.send("POST", segments, &[], b"x").expect_problem(415, &["content-type is"]);
    service.post("/v1/assets", "text/plain", b"x").expect_problem(415, &["text/plain"]);
    let gzip = [("content-type", "audio/wav"), ("content-encoding", "br")];
    service.send("POST", segments, &gzip, b"x").expect_problem(415, &["content-encoding"]);
    assert_eq!(service.get("/v1/assets?limt=3").expect_problem(400, &["limt"])["field"], "limt");
    for query in ["limit=0", "limit=1001", "limit=x", "cursor=x", "from=yesterday", "order=random"] {
        service.get(&format!("{segments}?{query}")).expect_problem(400, &[]);
    }
    service.get("/v1/assets/pump/wear/history?max_points=1").expect_problem(400, &["max_points"]);
    service.get("/v1/assets/pump/waterfall?max=1e300").expect_problem(400, &["max is 1e300"]);
    service.get("/v1/assets/pump/wear?channel=9").expect_problem(404, &["9"]);
    service.get("/v1/assets/none/segments").expect_problem(404, &["none"]);
    service.get("/v1/assets/NONE").expect_problem(404, &["NONE"]);
    service.get("/v1/segments/0123").expect_problem(404, &["0123"]);
    service.get("/v1/libraries/none").expect_problem(404, &["none"]);
    service.get("/v1/libraries/..%2Fsecret").expect_problem(404, &[]);
    service.get(&format!("/v1/libraries/{}", "a".repeat(300))).expect_problem(404, &["library"]);
    for (query, field, expected) in [
        ("assets?limit=-1", "limit", "a whole number"),
        ("assets/pump/segments?from=yesterday", "from", "a time"),
        ("assets/pump/segments?order=random", "order", "asc"),
        ("assets/pump/indicators?operating_bin=full", "operating_bin", "operating_bins"),
        ("recomputations?asset=NONE", "asset", "a-z"),
        ("alarms?asset=NONE", "asset", "a-z"),
    ] {
        let problem = service.get(&format!("/v1/{query}")).expect_problem(400, &[field, expected]);
        assert_eq!(problem["field"], field, "{problem}");
    }
    service.get("/v1/replays/77").expect_problem(404, &["77"]);
    service.post("/v1/assets/none/segments", "audio/wav", &wav(&[samples(1)])).expect_problem(404, &["none"]);
}

#[test]
fn a_value_of_the_wrong_type_is_answered_with_its_path() {
    let service = Service::start();
    let described = |place: &str, value: serde_json::Value| {
        let mut asset = crate::running::plain_asset("pump");
        asset["gear"]["pair"] = json!({
            "geometry": {
                "teeth": [31, 62], "module_mm": 2.0, "face_width_mm": 20.0, "bore_radius_mm": [10.0, 20.0],
            },
            "operation": { "torque_nm": 10.0, "shaft_speed_hz": 10.0 },
        });
        asset["points"] = json!([{ "channel": "1", "calibration_due": "2027-01-31" }]);
        *asset.pointer_mut(place).unwrap() = value;
        service.post_json("/v1/assets", &asset)
    };
    let pair = "/gear/pair/geometry";
    for (place, value, field, words) in [
        (format!("{pair}/teeth"), json!([31, 62, 27]), "gear.pair.geometry.teeth", "too many elements"),
        (format!("{pair}/module_mm"), json!("2"), "gear.pair.geometry.module_mm", "expected a number"),
        ("/points/0/calibration_due".to_owned(), json!("soon"), "points[0].calibration_due", "year"),
    ] {
        let problem = described(&place, value).expect_problem(422, &[field, words]);
        assert_eq!(problem["field"], field, "{problem}");
    }
    for (place, value, field) in [
        (pair, json!({ "teeth": [31, 62] }), "gear.pair.geometry.module_mm"),
        ("/gear", json!({ "teeth": [31, 62], "colour": "red" }), "gear.colour"),
        ("/points/0", json!({ "colour": "red" }), "points[0].colour"),
    ] {
        let name = field.rsplit('.').next().unwrap();
        let problem = described(place, value).expect_problem(422, &[name]);
        assert_eq!(problem["field"], field, "{problem}");
    }
    let huge = described("/gear/shaft_speed_hz", json!(1e308));
    assert_eq!(huge.expect_problem(422, &["gear.shaft_speed_hz is 1e308"])["value"], "1e308");
    service.post("/v1/assets", "application/json", b"{ \"id\": ").expect_problem(400, &["invalid body"]);
}

#[test]
fn the_length_of_a_name_is_counted_in_characters() {
    let service = Service::start();
    let mut asset = crate::running::plain_asset("pump");
    asset["name"] = json!("ä".repeat(200));
    service.post_json("/v1/assets", &asset).expect(201);
    asset["name"] = json!("ä".repeat(201));
    service.put_json("/v1/assets/pump", &asset).expect_problem(422, &["name", "200 characters"]);
}

#[test]
fn invalid_records_are_rejected_and_not_stored() {
    let service = Service::start();
    service.plain_asset("pump");
    let segments = "/v1/assets/pump/segments";
    let whole = wav(&[samples(1)]);
    for bytes in [&b""[..], b"RIFF", b"hello, world", &whole[..30]] {
        service.post(segments, "audio/wav", bytes).expect_problem(422, &[]);
    }
    service.post(segments, "application/json", b"{").expect_problem(422, &[]);
    service.post(segments, "application/json", b"[]").expect_problem(422, &[]);
    service.post(segments, "application/mcap", b"hello, world").expect_problem(422, &[]);
    let mut broken = samples(1);
    broken[7] = f32::NAN;
    service.post(segments, "audio/wav", &wav(&[broken])).expect_problem(422, &["NaN"]);
    for query in ["shaft_speed_hz=-1", "channel=", "reference_wear_um=-3", "torque_nm=NaN"] {
        service.post(&format!("{segments}?{query}"), "audio/wav", &whole).expect_problem(422, &[]);
    }
    assert_eq!(service.get(segments).expect(200).json(), json!({ "items": [], "next_cursor": null }));
    assert_eq!(crate::durability::raw_objects(service.folder()).len(), 0);
}

#[test]
fn malformed_json_and_invalid_fields_have_different_statuses() {
    let service = Service::start();
    service.post("/v1/assets", "application/json", b"{\"id\": ").expect_problem(400, &["line 1"]);
    service.post("/v1/assets", "application/json", b"[1, 2]").expect_problem(422, &["an array"]);
    service.post("/v1/tokens", "application/json", br#"["x", "admin"]"#).expect_problem(422, &["an array"]);
    service.plain_asset("pump");
    for (record, field, words) in [
        (json!(["a"]), None, "an object"),
        (json!({ "sample_rate_hz": "1", "samples": [1] }), Some("sample_rate_hz"), "expected a number"),
        (json!({ "sample_rate_hz": 1e308, "samples": [1] }), Some("sample_rate_hz"), "is 1e308, expected"),
        (json!({ "sample_rate_hz": 1, "samples": [1, "x"] }), Some("samples[1]"), "expected a number"),
        (json!({ "sample_rate_hz": 1, "samples": [] }), Some("samples"), "no samples"),
        (json!({ "sample_rate_hz": 1, "samples": [1], "volume": 3 }), Some("volume"), "unknown field"),
        (
            json!({ "sample_rate_hz": 1, "samples": [1],
                "tachometer": { "pulse_time_ns": [1, 2], "pulses_per_revolution": 0 } }),
            Some("tachometer.pulses_per_revolution"),
            "at least 1",
        ),
        (
            json!({ "sample_rate_hz": 1, "samples": [1],
                "tachometer": { "pulse_time_ns": [2, 1], "pulses_per_revolution": 1 } }),
            Some("tachometer.pulse_time_ns"),
            "ascending",
        ),
    ] {
        let problem = service.post_json("/v1/assets/pump/segments", &record).expect_problem(422, &[words]);
        assert_eq!(problem["field"].as_str(), field, "{problem}");
        assert!(!problem.to_string().contains("f64"), "{problem}");
    }
    service
        .post("/v1/replays", "application/json", b"{\"asset\": \"a\", \"file\": \"f\", \"pace\": \"slow\"}")
        .expect_problem(422, &["slow"]);
}

#[test]
fn a_body_too_large_is_rejected_with_and_without_content_length() {
    let service = Service::start_with(|config| {
        config.http.record_bytes = 10_000;
        config.http.recording_bytes = 10_000;
        config.http.description_bytes = 1000;
    });
    service.plain_asset("pump");
    let large = wav(&[samples(1), samples(2)]);
    assert!(large.len() > 10_000);
    service.post("/v1/assets/pump/segments", "audio/wav", &large).expect_problem(413, &["10000"]);
    service.post("/v1/assets/pump/segments", "application/mcap", &large).expect_problem(413, &["10000"]);
    service.post("/v1/assets", "application/json", &[b' '; 1001]).expect_problem(413, &["1000"]);
    // Chunked, without a content length.
    let mut large_mcap = mcap(&[record("1", 1)]);
    large_mcap.resize(large.len(), 0);
    for (media_type, large) in [("audio/wav", &large), ("application/mcap", &large_mcap)] {
        let answer = in_pieces(&service, media_type, large);
        assert!(
            answer.starts_with("HTTP/1.1 413 ") && answer.contains("application/problem+json"),
            "{answer}"
        );
    }
    let small = wav(&[samples(1)[..1000].to_vec()]);
    service.post("/v1/assets/pump/segments", "audio/wav", &small).expect(201);
}

/// Sends a chunked body and reads the response.
fn in_pieces(service: &Service, media_type: &str, body: &[u8]) -> String {
    let address = service.url("").trim_start_matches("http://").to_string();
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let head = format!(
        "POST /v1/assets/pump/segments HTTP/1.1\r\nhost: localhost\r\ncontent-type: {media_type}\r\ntransfer-encoding: chunked\r\nconnection: close\r\n\r\n"
    );
    stream.write_all(head.as_bytes()).unwrap();
    for piece in body.chunks(4000) {
        let mut chunk = format!("{:x}\r\n", piece.len()).into_bytes();
        chunk.extend_from_slice(piece);
        chunk.extend_from_slice(b"\r\n");
        // The service may have responded and closed the connection.
        if stream.write_all(&chunk).is_err() {
            break;
        }
    }
    let _ = stream.write_all(b"0\r\n\r\n");
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).into_owned()
}

#[test]
fn a_full_queue_sends_retry_after() {
    let service = Service::start_with(|config| config.work.requests_at_once = 1);
    service.plain_asset("pump");
    let block = encode_block(&record("1", 1), BlockEncoding::Json);
    let address = service.url("").trim_start_matches("http://").to_string();
    // One upload takes the only slot and does not end.
    let mut slow = TcpStream::connect(address).unwrap();
    let head = format!(
        "POST /v1/assets/pump/segments HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: {}\r\n\r\n",
        block.len()
    );
    slow.write_all(head.as_bytes()).unwrap();
    slow.write_all(&block[..10]).unwrap();
    let began = std::time::Instant::now();
    while service.get("/readyz").status != 503 {
        assert!(began.elapsed() < Duration::from_secs(20), "the slow upload never took its place");
    }
    let refused = service.post("/v1/assets/pump/segments", "application/json", &block);
    assert!(refused.header("retry-after").parse::<u32>().unwrap() >= 1);
    refused.expect_problem(503, &["full"]);
    service.get("/v1/assets/pump").expect(200);
    drop(slow);
    let began = std::time::Instant::now();
    while service.post("/v1/assets/pump/segments", "application/json", &block).status != 201 {
        assert!(began.elapsed() < Duration::from_secs(20));
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Sends a request on a persistent connection; returns the response's head and body.
fn exchange(stream: &mut BufReader<TcpStream>, request: &[u8]) -> (String, Vec<u8>) {
    stream.get_mut().write_all(request).unwrap();
    let mut head = String::new();
    while !head.ends_with("\r\n\r\n") {
        assert!(stream.read_line(&mut head).unwrap() > 0, "the connection ended after {head:?}");
    }
    let length = head.lines().find_map(|line| line.strip_prefix("content-length: ")).unwrap();
    let mut body = vec![0; length.parse().unwrap()];
    stream.read_exact(&mut body).unwrap();
    (head, body)
}

#[test]
fn a_rejection_before_the_body_keeps_the_connection() {
    let service = Service::start_with(|config| config.http.record_bytes = 1000);
    service.plain_asset("pump");
    let address = service.url("").trim_start_matches("http://").to_string();
    let mut stream = BufReader::new(TcpStream::connect(address).unwrap());
    stream.get_ref().set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let body = vec![b'x'; 3_000_000];
    for (path, media_type, status) in [
        ("/v1/assets/pump/segments", "image/png", "415"),
        ("/v1/assets/none/segments", "audio/wav", "404"),
        ("/v1/nothing", "audio/wav", "404"),
        ("/v1/assets/pump", "audio/wav", "405"),
        ("/v1/assets/pump/segments", "audio/wav", "413"),
    ] {
        let head = format!(
            "POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: {media_type}\r\ncontent-length: {}\r\n\r\n",
            body.len()
        );
        let (head, _) = exchange(&mut stream, &[head.as_bytes(), &body].concat());
        assert!(head.starts_with(&format!("HTTP/1.1 {status} ")), "{path} {media_type}: {head}");
        let (head, _) = exchange(&mut stream, b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n");
        assert!(head.starts_with("HTTP/1.1 200 "), "after {path} {media_type}: {head}");
    }
}

#[test]
fn a_rejection_instead_of_100_continue_closes_the_connection() {
    let service = Service::start();
    let address = service.url("").trim_start_matches("http://").to_string();
    let mut stream = BufReader::new(TcpStream::connect(address).unwrap());
    stream.get_ref().set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let request =
        b"POST /v1/nothing HTTP/1.1\r\nhost: localhost\r\ncontent-type: audio/wav\r\ncontent-length: 9\r\nexpect: 100-continue\r\n\r\n";
    let (head, _) = exchange(&mut stream, request);
    assert!(head.starts_with("HTTP/1.1 404 ") && head.contains("connection: close\r\n"), "{head}");
    assert_eq!(stream.read(&mut [0]).unwrap(), 0);
}

#[test]
fn a_stalled_body_releases_its_slot() {
    let service = Service::start_with(|config| {
        config.work.requests_at_once = 1;
        config.http.body_idle = Duration::from_millis(300);
        config.http.body_bytes_per_s = 10_000;
    });
    service.plain_asset("pump");
    let stored = service.upload("pump", &record("1", 1));
    let address = service.url("").trim_start_matches("http://").to_string();
    let head = "POST /v1/assets/pump/segments HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: 100000\r\n\r\n";
    // Nothing at all; then a byte at a time.
    for trickles in [false, true] {
        let mut slow = TcpStream::connect(&address).unwrap();
        slow.write_all(head.as_bytes()).unwrap();
        while service.get("/readyz").status != 503 {}
        // Reads do not wait for senders.
        service.get(&format!("/v1/segments/{}/spectrum", stored["id"].as_str().unwrap())).expect(200);
        let mut reader = BufReader::new(slow.try_clone().unwrap());
        let done = std::sync::atomic::AtomicBool::new(!trickles);
        let mut answer = String::new();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while !done.load(std::sync::atomic::Ordering::Relaxed) {
                    std::thread::sleep(Duration::from_millis(20));
                    if slow.write_all(b" ").is_err() {
                        break;
                    }
                }
            });
            reader.read_line(&mut answer).unwrap();
            done.store(true, std::sync::atomic::Ordering::Relaxed);
        });
        assert!(answer.starts_with("HTTP/1.1 408"), "{answer}");
        service.wait_for("/readyz", |ready| ready["status"] == "ok");
    }
}

#[test]
fn every_response_is_counted_including_those_outside_operations() {
    let service = Service::start();
    service.get("/nowhere").expect(404);
    service.delete("/v1/assets").expect(405);
    service.send("POST", "/v1/assets", &[("origin", "http://evil.example")], b"").expect(403);
    service.send("TRACE", "/v1/assets", &[], b"").expect(405);
    let metrics = String::from_utf8(service.get("/metrics").expect(200).bytes).unwrap();
    for labels in [
        r#"method="GET",route="unmatched",status="4xx""#,
        r#"method="DELETE",route="/v1/assets",status="4xx""#,
        r#"method="POST",route="/v1/assets",status="4xx""#,
        r#"method="other",route="/v1/assets",status="4xx""#,
    ] {
        let line = format!("flankwatch_requests_total{{{labels}}} 1");
        assert!(metrics.lines().any(|found| found == line), "{line} is not in\n{metrics}");
    }
}

/// Zeros, which gzip compresses to a thousandth.
fn gzip_of_zeros(bytes: usize) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(&vec![0; bytes]).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn a_body_that_is_not_mcap_is_rejected_by_its_first_bytes() {
    // Decompressed first, it would be too large.
    let service = Service::start_with(|config| config.http.recording_bytes = 4 << 20);
    service.plain_asset("pump");
    let fields = [("content-type", "application/mcap"), ("content-encoding", "gzip")];
    service
        .send("POST", "/v1/assets/pump/segments", &fields, &gzip_of_zeros(64 << 20))
        .expect_problem(422, &["the format is unknown"]);
    let whole = wav(&[samples(1)]);
    service
        .post("/v1/assets/pump/segments", "application/mcap", &whole)
        .expect_problem(422, &["WAV", "MCAP"]);
}

#[test]
fn an_invalid_field_is_reported_with_value_and_expectation() {
    let service = Service::start();
    let mut asset = crate::running::plain_asset("pump");
    asset["gear"]["teeth"] = json!([24, 26, 27]);
    let refused =
        service.post_json("/v1/assets", &asset).expect_problem(422, &["gear.teeth is [24, 26, 27]"]);
    assert_eq!(
        (&refused["field"], &refused["value"], &refused["expected"]),
        (&json!("gear.teeth"), &json!("[24, 26, 27]"), &json!("two tooth counts from 4 to 1000"))
    );
    service.plain_asset("pump");
    for (name, value) in [("torque_nm", "1e308"), ("shaft_speed_hz", "1e308"), ("reference_wear_um", "1e308")]
    {
        let path = format!("/v1/assets/pump/segments?{name}={value}");
        service.post(&path, "audio/wav", &wav(&[samples(1)])).expect_problem(422, &[name, "expected"]);
    }
    // No names of the implementation.
    let missing = service.send("POST", "/v1/uploads", &[("tus-resumable", "1.0.0")], b"");
    let problem = missing.expect_problem(400, &["upload-length", "missing"]);
    assert!(!problem.to_string().contains("Some(") && !problem.to_string().contains("None"), "{problem}");
    let empty =
        service.send("POST", "/v1/uploads", &[("tus-resumable", "1.0.0"), ("upload-length", "")], b"");
    assert!(!empty.expect_problem(400, &["upload-length"]).to_string().contains("Some("));
}

#[test]
fn a_value_that_does_not_apply_is_refused() {
    let service = Service::start();
    service.plain_asset("pump");
    let segments = "/v1/assets/pump/segments";
    let both = wav(&[samples(1), samples(2)]);
    service
        .post(&format!("{segments}?channel=motor"), "audio/wav", &both)
        .expect_problem(422, &["channel is \"motor\"", "2 channels", "channel_names"]);
    for parameter in ["columns=2", "time_column=1", "recorded_channels=x"] {
        let path = format!("{segments}?sample=f32&sample_rate_hz=1000&{parameter}");
        let name = parameter.split('=').next().unwrap();
        service.post(&path, "application/octet-stream", &[0; 16]).expect_problem(400, &[name]);
    }
    for rate in ["nan", "0", "-5", "inf"] {
        let expected = ["sample_rate_hz", "expected a rate above 0"];
        for path in ["/v1/csv-preview", segments] {
            service
                .post(&format!("{path}?sample_rate_hz={rate}"), "text/csv", b"a\n1\n2\n")
                .expect_problem(400, &expected);
        }
    }
    let reversed = format!("{segments}?from=2027-01-01T00:00:00Z&to=2026-01-01T00:00:00Z");
    service.delete(&reversed).expect_problem(400, &["to is", "a time after 2027-01-01"]);
    let mut asset = crate::running::plain_asset("fan");
    asset["sensor"] = json!({ "unit": "x".repeat(65) });
    service.post_json("/v1/assets", &asset).expect_problem(422, &["sensor.unit", "64 bytes"]);
}
