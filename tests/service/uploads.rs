//! Uploads in every format.

use std::io::Write;

use flankwatch::recording::{RecordDefaults, decode_flac};
use serde_json::{Value, json};

use crate::running::{Service, mcap, plain_asset, record, samples, wav};

const SEGMENTS: &str = "/v1/assets/pump/segments";

fn waveform(service: &Service, segment: &Value) -> Vec<f32> {
    let path = format!("/v1/segments/{}/waveform?max_points=200000", segment["id"].as_str().unwrap());
    let answer = service.get(&path).expect(200).json();
    answer["value"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap() as f32).collect()
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn csv_is_accepted_with_its_own_rate_and_units() {
    let service = Service::start();
    service.plain_asset("pump");
    let lines: String =
        samples(1).iter().enumerate().map(|(n, x)| format!("{};{x}\n", n as f64 / 4000.0)).collect();
    let text = format!("Messung;7\nZeit [s];a1 [m/s2]\n{lines}").replace('.', ",");
    let path = format!("{SEGMENTS}?start_time=2026-01-01T00:00:00Z");
    let segment = service.post(&path, "text/csv; charset=utf-8", text.as_bytes()).expect(201).json();
    assert_eq!((&segment["channel"], &segment["unit"]), (&"a1".into(), &"m/s2".into()));
    assert_eq!(segment["sample_rate_hz"], 4000.0);
    assert_eq!(waveform(&service, &segment), samples(1));
    service
        .post(&format!("{path}&sample_rate_hz=4010"), "text/csv", text.as_bytes())
        .expect_problem(422, &["4010", "expected 4000"]);
    let ramp = b"n,in [g],out\n0,1,5\n1,-2,6\n2,3,7\n3,4,9\n";
    service.post(&path, "text/csv", ramp).expect_problem(422, &["column \"n\"", "rises by the same step"]);
    let query = "&sample_rate_hz=1000&columns=2,3&channel_names=a,b&unit=m/s2";
    let taken = service.post(&format!("{path}{query}"), "text/csv", ramp).expect(201).json();
    let [a, b] = &taken["segments"].as_array().unwrap()[..] else { panic!("{taken}") };
    assert_eq!([&a["channel"], &b["channel"]], ["a", "b"]);
    // The query's parameters apply whenever the file is read again.
    let kept =
        service.get(&format!("/v1/segments/{}/waveform", b["id"].as_str().unwrap())).expect(200).json();
    assert_eq!(b["samples"], 4, "{kept}");
    service.post(&format!("{path}&columns=2,x"), "text/csv", ramp).expect_problem(400, &["columns", "\"x\""]);
    service.post(&format!("{path}&columns=9"), "text/csv", ramp).expect_problem(422, &["columns is 9"]);
    service.post(&path, "text/csv", b"a\n1\n2\n").expect_problem(422, &["the sampling rate"]);
    // The rate of the query is stored for reading the file again.
    let bare = service
        .post(&format!("{path}&sample_rate_hz=1000&channel=a2&unit=m/s2"), "text/csv", b"1\n2.5\n")
        .expect(201)
        .json();
    assert_eq!(waveform(&service, &bare), [1.0, 2.5]);
}

#[test]
fn raw_samples_are_accepted_with_query_parameters() {
    let service = Service::start();
    service.plain_asset("pump");
    let bare = "application/octet-stream";
    let floats: Vec<u8> = samples(1).iter().flat_map(|x| x.to_le_bytes()).collect();
    let time = "start_time=2026-01-01T00:00:00Z";
    let path = format!("{SEGMENTS}?sample=f32&sample_rate_hz=4000&unit=m/s2&channel=a1&{time}");
    let segment = service.post(&path, bare, &floats).expect(201).json();
    assert_eq!((&segment["channel"], &segment["samples"]), (&"a1".into(), &2000.into()));
    assert_eq!(waveform(&service, &segment), samples(1));
    // The same samples as WAV have the same indicators.
    let as_wav = format!("{SEGMENTS}?channel=a2&unit=m/s2&{time}");
    let from_wav = service.post(&as_wav, "audio/wav", &wav(&[samples(1)])).expect(201).json();
    assert_eq!(segment["indicators"], from_wav["indicators"]);
    let integers: Vec<u8> = (0..4000_i16).flat_map(|n| (n % 100).to_le_bytes()).collect();
    let path =
        format!("{SEGMENTS}?sample=i16&sample_rate_hz=4000&channels=2&scale=0.5&channel_names=in,out&{time}");
    let both = service.post(&path, bare, &integers).expect(201).json();
    assert_eq!(both["segments"][1]["channel"], "out");
    assert_eq!(waveform(&service, &both["segments"][1])[..3], [0.5, 1.5, 2.5]);
    for (query, word) in [
        ("sample_rate_hz=4000", "sample"),
        ("sample=f32", "sample_rate_hz"),
        ("sample=f64&sample_rate_hz=4000", "f64"),
    ] {
        let answer = service.post(&format!("{SEGMENTS}?{query}"), bare, &floats);
        assert!(matches!(answer.status, 400 | 422), "{}", answer.status);
        let status = answer.status;
        answer.expect_problem(status, &[word]);
    }
    service
        .post(&format!("{SEGMENTS}?sample=f32&sample_rate_hz=4000"), bare, &floats[..7])
        .expect_problem(422, &["7"]);
    service
        .post(&format!("{SEGMENTS}?channel_names=a,b"), "audio/wav", &wav(&[samples(1)]))
        .expect_problem(422, &["channel_names"]);
    // Each channel of a WAV file in a unit of its own; the second in that of all.
    let two = wav(&[samples(1), samples(2)]);
    let query = format!("{SEGMENTS}?channel_names=p,q&unit=mm/s2&start_time=2026-02-01T00:00:00Z");
    let stored =
        service.post(&format!("{query}&channel_units=g,"), "audio/wav", &two).expect(201).json()["segments"]
            .clone();
    let came_in = |n: usize| (&stored[n]["channel"], &stored[n]["raw"]["media_type"]);
    assert_eq!(came_in(0), (&json!("p"), &json!("audio/wav; unit=g")));
    assert_eq!(came_in(1), (&json!("q"), &json!("audio/wav; unit=mm/s2")));
    service
        .post(&format!("{query}&channel_units=g"), "audio/wav", &two)
        .expect_problem(422, &["channel_units", "channel_names"]);
}

#[test]
fn compressed_bodies_are_decoded_and_limited() {
    let service = Service::start_with(|config| {
        config.http.record_bytes = 100_000;
        config.http.recording_bytes = 100_000;
    });
    service.plain_asset("pump");
    let whole = wav(&[samples(1)]);
    let time = format!("{SEGMENTS}?start_time=2026-01-01T00:00:00Z");
    let plain = service.post(&time, "audio/wav", &whole).expect(201).json();
    for (coding, coded) in [("gzip", gzip(&whole)), ("zstd", zstd::bulk::compress(&whole, 3).unwrap())] {
        let headers = [("content-type", "audio/wav"), ("content-encoding", coding)];
        assert_eq!(service.send("POST", &time, &headers, &coded).expect(201).json(), plain);
        service
            .send("POST", &time, &headers, &coded[..coded.len() / 2])
            .expect_problem(400, &["content-encoding"]);
        service.send("POST", &time, &headers, b"not coded").expect_problem(400, &["content-encoding"]);
    }
    // 64 MiB of zeros in a few kilobytes.
    let zeros = vec![0; 64 << 20];
    for (coding, coded) in [("gzip", gzip(&zeros)), ("zstd", zstd::bulk::compress(&zeros, 3).unwrap())] {
        assert!(coded.len() < 500_000);
        for media_type in ["audio/wav", "application/mcap"] {
            let headers = [("content-type", media_type), ("content-encoding", coding)];
            service.send("POST", SEGMENTS, &headers, &coded).expect_problem(413, &["100000"]);
        }
    }
}

#[test]
fn an_upload_with_an_idempotency_key_happens_once() {
    let mut service = Service::start();
    service.plain_asset("pump");
    let bytes = wav(&[samples(1)]);
    let headers = |key: &'static str, media_type: &'static str| {
        [("idempotency-key", key), ("content-type", media_type)]
    };
    let first = service.send("POST", SEGMENTS, &headers("one", "audio/wav"), &bytes).expect(201).json();
    service.clock.advance(3600);
    let again = service.send("POST", SEGMENTS, &headers("one", "audio/wav"), &bytes).expect(201).json();
    assert_eq!(again, first);
    service.restart();
    // Also if the segment has changed meanwhile.
    let mut changed = plain_asset("pump");
    changed["gear"]["teeth"] = serde_json::json!([37, 62]);
    service.put_json("/v1/assets/pump", &changed).expect(200);
    let segment = format!("/v1/segments/{}", first["id"].as_str().unwrap());
    service.wait_for(&segment, |now| now["indicators"] != first["indicators"]);
    let again = service.send("POST", SEGMENTS, &headers("one", "audio/wav"), &bytes).expect(201);
    assert_eq!(again.header("idempotency-replayed"), "true");
    assert_eq!(again.json(), first);
    service
        .send("POST", SEGMENTS, &headers("one", "audio/wav"), &wav(&[samples(2)]))
        .expect_problem(409, &["one"]);
    // Under another key it is another record, of another time.
    let other = service.send("POST", SEGMENTS, &headers("two", "audio/wav"), &bytes).expect(201).json();
    assert_ne!(other["id"], first["id"]);
    let recording = mcap(&[record("2", 1), record("2", 2)]);
    let stored =
        service.send("POST", SEGMENTS, &headers("three", "application/mcap"), &recording).expect(201);
    let replayed =
        service.send("POST", SEGMENTS, &headers("three", "application/mcap"), &recording).expect(201);
    assert_eq!(
        (replayed.header("idempotency-replayed"), stored.header("idempotency-replayed")),
        ("true", "")
    );
    assert_eq!(replayed.json(), stored.json());
    // A record that was deleted is stored again.
    service.delete(&segment).expect(204);
    let stored = service.send("POST", SEGMENTS, &headers("one", "audio/wav"), &bytes).expect(201);
    assert_eq!((stored.header("idempotency-replayed"), &stored.json()["id"]), ("", &first["id"]));
    service.get(&segment).expect(200);
    let replayed = service.send("POST", SEGMENTS, &headers("one", "audio/wav"), &bytes).expect(201);
    assert_eq!((replayed.header("idempotency-replayed"), replayed.json()), ("true", stored.json()));
    service.clock.advance(8 * 24 * 3600);
    let later = service.send("POST", SEGMENTS, &headers("one", "audio/wav"), &bytes).expect(201).json();
    assert_ne!(later["id"], first["id"], "the key is forgotten");
}

#[test]
fn a_matlab_file_is_accepted_with_its_variables_as_channels() {
    let service = Service::start();
    service.plain_asset("pump");
    let path = &format!("{SEGMENTS}?start_time=2026-01-05T08:00:00Z&unit=m/s2");
    let file = include_bytes!("../../fixtures/matlab/bearing-two-channels.mat");
    let matlab = "application/x-matlab-data";
    service.post(path, matlab, file).expect_problem(422, &["the sampling rate", "fs or t"]);
    let answer = service.post(&format!("{path}&sample_rate_hz=12000"), matlab, file).expect(201).json();
    let channels: Vec<&str> =
        answer["segments"].as_array().unwrap().iter().map(|one| one["channel"].as_str().unwrap()).collect();
    assert_eq!(channels, ["X097_DE_time", "X097_FE_time"]);
    assert_eq!(answer["segments"][0]["sample_rate_hz"], 12_000.0);
    // The file is stored unchanged, with everything needed to read it again.
    let id = answer["segments"][1]["id"].as_str().unwrap();
    let raw = service.get(&format!("/v1/segments/{id}/raw")).expect(200);
    assert_eq!(raw.header("content-type"), matlab);
    assert_eq!(raw.bytes, file);
    let count = |k: usize| (((37 * k + 11) % 201) as f32 - 100.0) / 8.0;
    assert_eq!(waveform(&service, &answer["segments"][1]), (0..100).map(count).collect::<Vec<_>>());
    service.post(path, matlab, b"MATLAB 5.0 MAT-file").expect_problem(422, &["mat: header"]);
}

#[test]
fn flac_and_numpy_files_are_accepted_with_a_scale_that_is_stored() {
    let service = Service::start();
    service.plain_asset("pump");
    let at = |minute: u32| format!("{SEGMENTS}?start_time=2026-01-05T08:{minute:02}:00Z");
    let raw_type = |segment: &Value| segment["raw"]["media_type"].as_str().unwrap().to_owned();
    let flac = include_bytes!("../../fixtures/flac/mono-16.flac");
    let stored = service
        .post(&format!("{}&scale=5&sensitivity_mv_per_g=100", at(0)), "audio/flac", flac)
        .expect(201)
        .json();
    assert_eq!(
        (stored["sample_rate_hz"].as_f64(), raw_type(&stored)),
        (Some(20_000.0), "audio/flac;scale=5;sensitivity=100; unit=g".into())
    );
    let defaults = RecordDefaults { scale: Some(50.0), unit: Some("g".into()), ..RecordDefaults::default() };
    let expected = decode_flac(flac, &defaults).unwrap().remove(0);
    let unit = stored["unit"].as_str().unwrap();
    assert_eq!(waveform(&service, &stored), expected.in_unit(unit).unwrap().samples());

    let npy = include_bytes!("../../fixtures/npy/int16-two-channels.npy");
    service.post(&at(1), "application/x-npy", npy).expect_problem(422, &["sample rate", "missing"]);
    let path = format!("{}&sample_rate_hz=12800&scale=0.5&unit=m/s2", at(1));
    let stored = service.post(&path, "application/x-npy", npy).expect(201).json();
    let segments = stored["segments"].as_array().unwrap();
    assert_eq!(
        (segments.len(), raw_type(&segments[1])),
        (2, "application/x-npy;rate=12800;scale=0.5".into())
    );
    let raw = service.get(&format!("/v1/segments/{}/raw", segments[1]["id"].as_str().unwrap())).expect(200);
    assert_eq!((raw.header("content-type"), raw.bytes.as_slice()), ("application/x-npy", &npy[..]));

    let csv = "a [m/s2]\n1\n2\n3\n";
    let path = format!("{}&sample_rate_hz=100&scale=-2", at(2));
    let stored = service.post(&path, "text/csv", csv.as_bytes()).expect(201).json();
    assert_eq!(waveform(&service, &stored), [-2.0, -4.0, -6.0]);
}

#[test]
fn a_csv_file_is_read_again_with_its_sensitivity_and_without_its_counters() {
    let service = Service::start();
    service.plain_asset("pump");
    let path = format!("{SEGMENTS}?start_time=2026-01-05T08:00:00Z&sensitivity_mv_per_g=100");
    let text = "index,time,acc [mV]\n0,0,100\n1,0.5,-50\n2,1,20\n3,1.5,70\n";
    let stored = service.post(&path, "text/csv", text.as_bytes()).expect(201).json();
    assert_eq!((&stored["channel"], &stored["unit"]), (&json!("acc"), &json!("m/s2")));
    let raw_type = stored["raw"]["media_type"].as_str().unwrap();
    assert_eq!(raw_type, "text/csv;sensitivity=100; channels=vibration; unit=g");
    let expected = [1.0_f32, -0.5, 0.2, 0.7].map(|g| (f64::from(g) * 9.806_65) as f32);
    assert_eq!(waveform(&service, &stored), expected);
    let other = text.replace("mV", "furlong/s2");
    service.post(&path, "text/csv", other.as_bytes()).expect_problem(422, &["furlong/s2", "expected V, mV"]);
    let without = path.replace("&sensitivity_mv_per_g=100", "");
    service.post(&without, "text/csv", other.as_bytes()).expect_problem(422, &["furlong/s2", "m/s2"]);
}

#[test]
fn a_repeat_that_contradicts_the_stored_record_is_refused() {
    let service = Service::start();
    service.plain_asset("pump");
    let bytes = wav(&[samples(1)]);
    let send = |query: &str| {
        let path = format!("{SEGMENTS}?start_time=2026-01-05T08:00:00Z&unit=g&{query}");
        service.post(&path, "audio/wav", &bytes)
    };
    let stored = send("scale=2&torque_nm=5").expect(201).json();
    // A value that is not given contradicts nothing.
    assert_eq!(send("scale=2").expect(201).json()["id"], stored["id"]);
    for (query, words) in [
        ("scale=3&torque_nm=5", "media_type is audio/wav;scale=3"),
        ("scale=2&torque_nm=6", "torque_nm is 6, but the record is stored with 5: delete it"),
        ("scale=2&reference_wear_um=20", "reference_wear_um is 20, but the record is stored with none"),
    ] {
        let problem = send(query).expect_problem(409, &[words]);
        assert_eq!(problem["field"], words.split(' ').next().unwrap());
    }
}

#[test]
fn parameters_that_a_format_does_not_use_are_refused() {
    let service = Service::start();
    service.plain_asset("pump");
    for (query, media_type, words) in [
        ("sample_rate_hz=100", "audio/wav", ["sample_rate_hz", "content-type"]),
        ("columns=1", "audio/flac", ["columns", "content-type"]),
        ("scale=2", "application/json", ["scale", "content-type"]),
        ("scale=0", "audio/wav", ["scale", "other than 0"]),
        ("sensitivity_mv_per_g=-1", "audio/wav", ["sensitivity_mv_per_g", "above 0"]),
        ("sensitivity_mv_per_g=100&unit=m/s2", "audio/wav", ["unit", "sensitivity_mv_per_g"]),
        (
            "sensitivity_mv_per_g=100&channel_names=a,b&channel_units=g,m/s2",
            "audio/wav",
            ["channel_units", "sensitivity_mv_per_g"],
        ),
        ("sample_rate_hz=0", "application/x-npy", ["sample_rate_hz", "above 0"]),
        (
            "sample=f32&sample_rate_hz=10&sensitivity_mv_per_g=1",
            "application/octet-stream",
            ["sensitivity", "scale"],
        ),
    ] {
        service.post(&format!("{SEGMENTS}?{query}"), media_type, b"x").expect_problem(400, &words);
    }
}

#[test]
fn a_file_of_another_format_is_named() {
    let service = Service::start();
    service.plain_asset("pump");
    for (bytes, name) in
        [(&b"\x89HDF\r\n\x1a\n...."[..], "HDF5"), (b"TDSm........", "TDMS"), (b"PAR1....", "Parquet")]
    {
        for media_type in ["audio/wav", "text/csv", "application/x-matlab-data"] {
            service.post(SEGMENTS, media_type, bytes).expect_problem(422, &[name]);
        }
    }
}

#[test]
fn a_time_of_day_is_the_last_one_before_the_receipt() {
    let service = Service::start();
    service.plain_asset("pump");
    let text = "at,x [g]\n08:00:00.5,1\n08:00:00.6,2\n08:00:00.7,3\n";
    let start = |path: &str| {
        let stored = service.post(path, "text/csv", text.as_bytes()).expect(201).json();
        stored["start_time"].as_str().unwrap().parse::<jiff::Timestamp>().unwrap()
    };
    let found = start(SEGMENTS);
    assert_eq!(found.as_millisecond().rem_euclid(86_400_000), 8 * 3_600_000 + 500);
    let given = "2026-01-05T09:00:00Z";
    assert_eq!(start(&format!("{SEGMENTS}?start_time={given}")).to_string(), given);
}

#[test]
fn a_csv_preview_matches_the_upload() {
    let service = Service::start();
    let preview = |query: &str, text: &str| {
        service.post(&format!("/v1/csv-preview{query}"), "text/csv", text.as_bytes())
    };
    let text = "Messung;7\nZeit [s];in [g];n\n0;0,5;1\n0,5;-1;2\n1;2;3\n";
    let seen = preview("", text).expect(200).json();
    let columns = seen["columns"].as_array().unwrap();
    let roles: Vec<_> = columns.iter().map(|column| (&column["number"], &column["role"])).collect();
    assert_eq!(
        roles,
        [(&json!(1), &json!("time")), (&json!(2), &json!("channel")), (&json!(3), &json!("channel"))]
    );
    assert_eq!(
        (&columns[1]["name"], &columns[1]["unit"], &columns[1]["label"]),
        (&json!("in"), &json!("g"), &json!("in [g]"))
    );
    assert_eq!(columns[1]["envelope"], json!([[0.5, 0.5], [-1.0, -1.0], [2.0, 2.0]]));
    assert_eq!(
        (&seen["sample_rate_hz"], &seen["rate_source"], &seen["lines"]),
        (&json!(2.0), &json!("times"), &json!(3))
    );
    let seen = preview("?columns=3&time_column=0&sample_rate_hz=5", text).expect(200).json();
    assert_eq!((&seen["columns"][0]["role"], &seen["sample_rate_hz"]), (&json!("left_out"), &json!(5.0)));
    let seen = preview("", "t,a\n0,1\n1,none\n").expect(200).json();
    assert!(seen["fault"].as_str().unwrap().contains("line 3"), "{seen}");
    assert_eq!(seen["columns"].as_array().unwrap().len(), 2);
    preview("", "").expect_problem(422, &["empty (0 bytes)"]);
    preview("?time_column=300", text).expect_problem(422, &["time_column", "256"]);
    preview("", &"1\n".repeat(1 << 20)).expect_problem(413, &["1048576"]);
    assert_eq!(service.get("/v1/assets").expect(200).json()["items"], json!([]));
}

#[test]
fn the_same_bytes_with_other_values_at_the_same_time_are_a_conflict() {
    let service = Service::start();
    service.plain_asset("pump");
    let bytes = wav(&[samples(1)]);
    for round in 1..=8 {
        let statuses: Vec<u16> = std::thread::scope(|scope| {
            let send = |torque_nm| {
                let (service, bytes) = (&service, &bytes);
                let path = format!(
                    "/v1/assets/pump/segments?start_time=2026-01-0{round}T00:00:00Z&torque_nm={torque_nm}"
                );
                scope.spawn(move || service.post(&path, "audio/wav", bytes).status)
            };
            let sent: Vec<_> = [5, 6, 7].map(send).into();
            sent.into_iter().map(|sender| sender.join().unwrap()).collect()
        });
        let stored = statuses.iter().filter(|status| **status == 201).count();
        assert!(stored == 1 && statuses.iter().all(|status| [201, 409].contains(status)), "{statuses:?}");
    }
}
