//! Uploads of single records and the resulting segments.

use flankwatch::recording::{BlockEncoding, encode_block};
use flankwatch::signal::{OperatingPoint, Record};
use serde_json::{Value, json};

use crate::running::{Service, gearbox_24_26, minute, plain_asset, record, samples, wav};

fn close(a: &Value, b: f64, tolerance: f64) -> bool {
    (a.as_f64().unwrap() - b).abs() <= tolerance
}

#[test]
fn a_wav_becomes_a_segment_with_its_indicators() {
    let service = Service::start();
    service.plain_asset("pump");
    let samples = samples(1);
    let path = "/v1/assets/pump/segments?start_time=2026-03-01T12:00:00.000000001Z&shaft_speed_hz=10&torque_nm=60&channel=gearbox/x&reference_wear_um=12.5";
    let segment = service.post(path, "audio/wav", &wav(std::slice::from_ref(&samples))).expect(201).json();
    assert_eq!(segment["asset_id"], "pump");
    assert_eq!(segment["channel"], "gearbox/x");
    assert_eq!(segment["start_time"], "2026-03-01T12:00:00.000000001Z");
    assert_eq!(segment["received_at"], "2026-01-01T00:00:00Z");
    assert_eq!(segment["sample_rate_hz"], 4000.0);
    assert_eq!(segment["samples"], 2000);
    assert_eq!(segment["unit"], "m/s2");
    assert_eq!(segment["operating_point"], json!({ "shaft_speed_hz": 10.0, "torque_nm": 60.0 }));
    assert_eq!(segment["shaft_speed"]["mesh_frequency_hz"], 310.0);
    assert_eq!(segment["shaft_speed"]["source"], "record");
    assert_eq!(segment["reference_wear_um"], 12.5);
    assert_eq!(segment["raw"]["media_type"], "audio/wav");
    // The definition: the square root of the mean square.
    let rms = (samples.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>() / samples.len() as f64).sqrt();
    assert!(close(&segment["indicators"]["rms"], rms, 1e-9 * rms));
    assert_eq!(segment["wear"]["status"], "collecting_baseline");
    let shown = service.get(&format!("/v1/segments/{}", segment["id"].as_str().unwrap())).expect(200).json();
    assert_eq!(shown, segment);
}

#[test]
fn the_same_samples_as_wav_protobuf_and_json_give_the_same_indicators() {
    let service = Service::start();
    service.plain_asset("pump");
    let record = record("1", 4);
    let path = "/v1/assets/pump/segments";
    let from_json = service
        .post(path, "application/json", &encode_block(&record, BlockEncoding::Json))
        .expect(201)
        .json();
    service.plain_asset("pump2");
    let path = "/v1/assets/pump2/segments";
    let protobuf = encode_block(&record, BlockEncoding::Protobuf);
    let from_protobuf = service.post(path, "application/x-protobuf", &protobuf).expect(201).json();
    service.plain_asset("pump3");
    let path = "/v1/assets/pump3/segments?start_time=2026-01-01T00:04:00Z";
    let from_wav = service.post(path, "audio/wav", &wav(&[record.samples().to_vec()])).expect(201).json();
    for segment in [&from_protobuf, &from_wav] {
        for key in ["indicators", "features", "start_time", "channel", "unit", "sample_rate_hz"] {
            assert_eq!(segment[key], from_json[key], "{key}");
        }
    }
}

#[test]
fn a_wav_of_several_channels_becomes_as_many_segments() {
    let service = Service::start();
    service.plain_asset("pump");
    let path = "/v1/assets/pump/segments?start_time=2026-01-01T00:00:00Z";
    let bytes = wav(&[samples(1), samples(2), samples(3)]);
    let answer = service.post(path, "audio/wav", &bytes).expect(201).json();
    let segments = answer["segments"].as_array().unwrap();
    let channels: Vec<&Value> = segments.iter().map(|segment| &segment["channel"]).collect();
    assert_eq!(channels, ["1", "2", "3"]);
    assert_eq!(service.post(path, "audio/wav", &bytes).expect(201).json(), answer);
    for (segment, n) in segments.iter().zip(1..) {
        let id = segment["id"].as_str().unwrap();
        let waveform = service.get(&format!("/v1/segments/{id}/waveform")).expect(200).json();
        let value: Vec<f32> =
            waveform["value"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap() as f32).collect();
        assert_eq!(value, samples(n));
    }
}

#[test]
fn a_repeated_upload_gets_the_first_response() {
    let service = Service::start();
    service.plain_asset("pump");
    let first = service.upload("pump", &record("1", 1));
    service.clock.advance(3600);
    let second = service.upload("pump", &record("1", 2));
    assert_eq!(service.upload("pump", &record("1", 1)), first);
    assert_eq!(service.upload("pump", &record("1", 2)), second);
    assert_eq!(service.get("/v1/assets/pump").expect(200).json()["summary"]["segments"], 2);
    let metrics = String::from_utf8(service.get("/metrics").expect(200).bytes).unwrap();
    for line in [
        "flankwatch_records_total{outcome=\"stored\"} 2",
        "flankwatch_records_total{outcome=\"repeated\"} 2",
        "flankwatch_segments 2",
        "flankwatch_request_duration_seconds_count{method=\"POST\",route=\"/v1/assets/{asset}/segments\"} 4",
    ] {
        assert!(metrics.lines().any(|found| found == line), "{line} in\n{metrics}");
    }
}

#[test]
fn a_large_raw_recording_is_downloaded_as_received() {
    let service = Service::start();
    service.plain_asset("pump");
    let bytes: Vec<u8> = (0..400_000).flat_map(|n| ((n % 97) as f32).to_le_bytes()).collect();
    let path = "/v1/assets/pump/segments?sample=f32&sample_rate_hz=12800&unit=m/s2";
    let stored = service.post(path, "application/octet-stream", &bytes).expect(201).json();
    let raw = service.get(&format!("/v1/segments/{}/raw", stored["id"].as_str().unwrap())).expect(200);
    assert_eq!(raw.header("content-length"), bytes.len().to_string());
    assert!(raw.bytes == bytes);
}

#[test]
fn eight_clients_with_the_same_record_store_it_once() {
    let service = Service::start();
    service.plain_asset("pump");
    let answers: Vec<Value> = std::thread::scope(|scope| {
        let clients: Vec<_> =
            (0..8).map(|_| scope.spawn(|| service.upload("pump", &record("1", 1)))).collect();
        clients.into_iter().map(|client| client.join().unwrap()).collect()
    });
    assert!(answers.iter().all(|answer| *answer == answers[0]));
    assert_eq!(service.get("/v1/assets/pump").expect(200).json()["summary"]["segments"], 1);
}

#[test]
fn a_record_without_a_time_has_the_time_of_receipt() {
    let service = Service::start();
    service.plain_asset("pump");
    service.clock.advance(90);
    let segment =
        service.post("/v1/assets/pump/segments", "audio/wav", &wav(&[samples(1)])).expect(201).json();
    assert_eq!(segment["start_time"], "2026-01-01T00:01:30Z");
    assert_eq!(segment["channel"], "1");
}

#[test]
fn a_list_of_segments_is_paged_in_either_order_over_all_channels() {
    let service = Service::start();
    service.plain_asset("pump");
    for n in [5, 1, 3] {
        service.upload("pump", &record("a", n));
        service.upload("pump", &record("b", n));
        service.upload("pump", &record("b", n + 1));
    }
    let walk = |query: &str| {
        let mut found = Vec::new();
        let mut cursor = String::new();
        loop {
            let page =
                service.get(&format!("/v1/assets/pump/segments?limit=2&{query}{cursor}")).expect(200).json();
            for item in page["items"].as_array().unwrap() {
                assert!(item.get("features").is_none() && item["wear"].get("posterior").is_none());
                let time = item["start_time"].as_str().unwrap();
                found.push(format!("{}{}", item["channel"].as_str().unwrap(), &time[15..16]));
            }
            match page["next_cursor"].as_str() {
                Some(next) => cursor = format!("&cursor={next}"),
                None => return found,
            }
        }
    };
    let all = walk("order=asc");
    let minutes: Vec<&str> = all.iter().map(|entry| &entry[1..]).collect();
    assert_eq!(minutes, ["1", "1", "2", "3", "3", "4", "5", "5", "6"]);
    let mut backwards = walk("order=desc");
    backwards.reverse();
    assert_eq!(backwards, all);
    assert_eq!(walk("channel=a"), ["a1", "a3", "a5"]);
    assert_eq!(walk("channel=c"), [""; 0]);
    assert_eq!(walk("channel=b&from=2026-01-01T00:02:00Z&to=2026-01-01T00:04:00Z"), ["b2", "b3"]);
}

#[test]
fn a_reduced_waveform_and_spectrum_hide_no_peak() {
    let service = Service::start();
    service.plain_asset("pump");
    let mut spiked = samples(1);
    spiked[1234] = 77.0;
    spiked[321] = -55.0;
    let path = "/v1/assets/pump/segments?start_time=2026-01-01T00:00:00Z&shaft_speed_hz=10";
    let segment = service.post(path, "audio/wav", &wav(&[spiked])).expect(201).json();
    let id = segment["id"].as_str().unwrap();
    let waveform = service.get(&format!("/v1/segments/{id}/waveform?max_points=50")).expect(200).json();
    let values: Vec<f64> =
        waveform["value"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
    let times = waveform["time_s"].as_array().unwrap();
    assert_eq!(waveform["reduced"], true);
    assert!(values.len() <= 50 && times.len() == values.len());
    for (value, index) in [(77.0, 1234.0), (-55.0, 321.0)] {
        let position = values.iter().position(|x| *x == value).unwrap();
        assert!(close(&times[position], index / 4000.0, 1e-12));
    }
    let numbers = |spectrum: &Value, key: &str| -> Vec<f64> {
        let list = spectrum[key].as_array().unwrap();
        list.iter().map(|x| x.as_f64().unwrap()).collect()
    };
    let most = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    for kind in ["spectrum", "envelope"] {
        let whole = service.get(&format!("/v1/segments/{id}/{kind}")).expect(200).json();
        let reduced = service.get(&format!("/v1/segments/{id}/{kind}?max_points=20")).expect(200).json();
        assert_eq!((&whole["reduced"], &reduced["reduced"]), (&json!(false), &json!(true)));
        assert_eq!(whole["quantity"], "amplitude_peak");
        assert_eq!(whole["unit"], "m/s2");
        assert!(numbers(&reduced, "amplitude").len() <= 20);
        assert_eq!(most(&numbers(&reduced, "amplitude")), most(&numbers(&whole, "amplitude")));
        assert_eq!(numbers(&whole, "amplitude").len(), numbers(&whole, "frequency_hz").len());
        assert!(most(&numbers(&whole, "frequency_hz")) <= 2000.0);
        assert_eq!(whole["mesh_frequency_hz"], 310.0);
        assert!(close(&whole["mesh_harmonics"][0]["frequency_hz"], 310.0, 4.0));
        let part = format!("/v1/segments/{id}/{kind}?from_hz=200&to_hz=500");
        let range = service.get(&part).expect(200).json();
        let within = |hz: &f64| (200.0..=500.0).contains(hz);
        let lines = numbers(&whole, "frequency_hz").into_iter().zip(numbers(&whole, "amplitude"));
        let (frequency_hz, amplitude): (Vec<f64>, Vec<f64>) = lines.filter(|(hz, _)| within(hz)).unzip();
        assert_eq!(numbers(&range, "frequency_hz"), frequency_hz, "every line of the range and no other");
        assert_eq!(numbers(&range, "amplitude"), amplitude);
        let reduced = service.get(&format!("{part}&max_points=20")).expect(200).json();
        assert_eq!(reduced["reduced"], true);
        assert!(numbers(&reduced, "frequency_hz").iter().all(within));
        for query in ["from_hz=-1", "from_hz=500&to_hz=200", "to_hz=0", "from_hz=NaN"] {
            let refused = service.get(&format!("/v1/segments/{id}/{kind}?{query}"));
            refused.expect_problem(400, &["from_hz, to_hz", "at least 0"]);
        }
    }
    let envelope = service
        .get(&format!("/v1/segments/{id}/envelope?band_low_hz=200&band_high_hz=900"))
        .expect(200)
        .json();
    assert_eq!((&envelope["band_hz"], &envelope["band_source"]), (&json!([200.0, 900.0]), &json!("query")));
    for band in [
        "band_low_hz=200",
        "band_low_hz=900&band_high_hz=200",
        "band_low_hz=100&band_high_hz=2001",
        "band_low_hz=NaN&band_high_hz=9",
    ] {
        service.get(&format!("/v1/segments/{id}/envelope?{band}")).expect_problem(400, &["band"]);
    }
}

#[test]
fn a_speed_in_doubt_is_said_with_its_reason() {
    let service = Service::start();
    let mut asset = plain_asset("pump");
    // The record has a mesh of 310 Hz: 31 teeth at 10 Hz.
    asset["gear"] = json!({ "teeth": [23, 62], "shaft_speed_hz": 10.0 });
    service.post_json("/v1/assets", &asset).expect(201);
    let long = (0..16).flat_map(samples).collect();
    let record = Record::new("1", minute(0), 4000.0, "m/s2", long).unwrap();
    let segment = service.upload("pump", &record);
    assert_eq!(segment["shaft_speed"]["doubt"]["reason"], "other_mesh", "{segment}");
    assert_eq!(segment["wear"]["status"], "speed_in_doubt", "{segment}");
    let reason = segment["wear"]["reason"].as_str().unwrap();
    let readings = ["a mesh frequency of 310.", " Hz (23 × 13.4", " Hz or 30.7 × 10.", " better than "];
    assert!(readings.iter().all(|part| reason.contains(part)), "{reason}");
    assert!(reason.ends_with("are the tooth counts and the speed correct?"), "{reason}");
    assert_eq!(segment["wear"]["baseline"]["have"], 0);
}

/// An asset with 32 and 80 teeth that is sent the gearbox of another one, with 24 and 26 teeth.
#[test]
fn first_records_of_another_gearbox_ask_whether_teeth_and_speed_are_right() {
    let service = Service::start();
    let mut asset = plain_asset("pump");
    asset["gear"] = json!({ "teeth": [32, 80], "shaft_speed_hz": 30.0 });
    service.post_json("/v1/assets", &asset).expect(201);
    let upload = |at: i64, speed: OperatingPoint| {
        let record = Record::new("1", minute(at), 10_000.0, "m/s2", gearbox_24_26()).unwrap();
        service.upload("pump", &record.with_operating_point(speed).unwrap())
    };
    let given = OperatingPoint { shaft_speed_hz: Some(30.0), ..OperatingPoint::default() };
    let cases = [(OperatingPoint::default(), "speed_in_doubt", 0), (given, "collecting_baseline", 1)];
    for (at, (speed, status, have)) in cases.into_iter().enumerate() {
        let segment = upload(at as i64, speed);
        let doubt = &segment["shaft_speed"]["doubt"];
        assert_eq!((&doubt["reason"], &doubt["teeth"]), (&json!("other_mesh"), &json!(24)), "{segment}");
        let wear = &segment["wear"];
        assert_eq!((&wear["status"], &wear["baseline"]["have"]), (&json!(status), &json!(have)), "{wear}");
        let reason = wear["reason"].as_str().unwrap();
        assert!(reason.contains("the lines fit 24 × 16.64 Hz better than 32 × "), "{reason}");
        assert!(reason.ends_with("; are the tooth counts and the speed correct?"), "{reason}");
    }
}

#[test]
fn a_record_that_is_not_comparable_says_briefly_what_it_lacks() {
    let service = Service::start();
    let mut asset = plain_asset("pump");
    asset["gear"] = json!({ "teeth": [24, 26], "shaft_speed_hz": 16.64 });
    asset["baseline"] = json!({ "records": 8 });
    service.post_json("/v1/assets", &asset).expect(201);
    let samples = gearbox_24_26();
    let upload = |at: i64, samples: &[f32]| {
        let record = Record::new("1", minute(at), 10_000.0, "m/s2", samples.to_vec()).unwrap();
        service.upload("pump", &record)["wear"].clone()
    };
    let baseline: Vec<Value> = (0..8).map(|at| upload(at, &samples[at as usize..])).collect();
    assert!(baseline.iter().all(|wear| wear["short_reason"].is_null()));
    let short = upload(8, &samples[..1000]);
    assert_eq!(short["status"], "not_comparable", "{short}");
    assert_eq!(short["short_reason"], "0.1 s, 0.3 s needed");
}
