//! Recordings of many records: uploads and replays.

use std::collections::BTreeMap;

use flankwatch::recording::{BlockEncoding, RecordDefaults, decode_block, encode_block};
use flankwatch::signal::Record;
use serde_json::{Value, json};

use crate::command::flankwatch;
use crate::running::{Service, mcap, plain_asset, record, samples, wav};

fn wait_for_end(service: &Service, replay: &Value) -> Value {
    let path = format!("/v1/replays/{}", replay["id"].as_str().unwrap());
    service.wait_for(&path, |replay| replay["state"] != "running")
}

#[test]
fn an_mcap_is_stored_record_by_record_and_a_repeat_stores_nothing() {
    let service = Service::start();
    service.plain_asset("one");
    service.plain_asset("two");
    let records: Vec<_> = (0..12).flat_map(|n| [record("x", n), record("y", n)]).collect();
    let bytes = mcap(&records);
    let path = "/v1/assets/one/segments";
    let answer = service.post(path, "application/mcap", &bytes).expect(201).json();
    assert_eq!(
        (&answer["records"], &answer["stored"], &answer["repeated"]),
        (&json!(24), &json!(24), &json!(0))
    );
    assert_eq!(answer["refused"], json!([]));
    assert_eq!(answer["channels"], json!(["x", "y"]));
    assert_eq!(answer["first_start_time"], "2026-01-01T00:00:00Z");
    assert_eq!(answer["last_start_time"], "2026-01-01T00:11:00Z");
    assert_eq!(answer["wear"]["status"], "no_library");
    let again = service.post(path, "application/mcap", &bytes).expect(201).json();
    assert_eq!((&again["stored"], &again["repeated"]), (&json!(0), &json!(24)));
    assert_eq!(service.get("/v1/assets/one").expect(200).json()["summary"]["segments"], 24);
    // Uploaded one by one: the same indicators.
    for record in &records {
        service.upload("two", record);
    }
    for channel in ["x", "y"] {
        let trend = |asset: &str| {
            let path = format!("/v1/assets/{asset}/indicators?channel={channel}");
            let mut trend = service.get(&path).expect(200).json();
            for item in trend["items"].as_array_mut().unwrap() {
                item.as_object_mut().unwrap().remove("segment_id");
            }
            trend
        };
        assert_eq!(trend("one"), trend("two"));
    }
    assert_eq!(std::fs::read_dir(service.folder().join("uploads")).unwrap().count(), 0);
}

#[test]
fn a_segment_of_an_mcap_returns_its_samples() {
    let service = Service::start();
    service.plain_asset("pump");
    let sent = record("x", 3);
    service
        .post("/v1/assets/pump/segments", "application/mcap", &mcap(std::slice::from_ref(&sent)))
        .expect(201);
    let list = service.get("/v1/assets/pump/segments").expect(200).json();
    let id = list["items"][0]["id"].as_str().unwrap();
    let waveform = service.get(&format!("/v1/segments/{id}/waveform")).expect(200).json();
    let value: Vec<f32> =
        waveform["value"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap() as f32).collect();
    assert_eq!(value, sent.samples());
}

#[test]
fn a_replay_sends_a_recording_and_reports_its_progress() {
    let service = Service::start();
    service.plain_asset("pump");
    let records: Vec<_> = (0..40).map(|n| record("1", n)).collect();
    std::fs::write(service.folder().join("recordings/run.mcap"), mcap(&records)).unwrap();
    let started = service
        .post_json("/v1/replays", &json!({ "asset": "pump", "file": "run.mcap", "pace": "max" }))
        .expect(202);
    let replay = started.json();
    assert_eq!(started.header("location"), format!("/v1/replays/{}", replay["id"].as_str().unwrap()));
    assert_eq!(
        (&replay["asset"], &replay["file"], &replay["pace"]),
        (&json!("pump"), &json!("run.mcap"), &json!("max"))
    );
    let ended = wait_for_end(&service, &replay);
    assert_eq!(ended["state"], "finished", "{ended}");
    assert_eq!(
        (&ended["records_done"], &ended["records_total"], &ended["stored"]),
        (&json!(40), &json!(40), &json!(40))
    );
    assert_eq!(ended["record_seconds_done"], 20.0);
    assert!(ended["times_real_time"].as_f64().unwrap() > 0.0);
    assert_eq!(ended["error"], json!(null));
    assert_eq!(service.get("/v1/assets/pump").expect(200).json()["summary"]["segments"], 40);
    let again =
        service.post_json("/v1/replays", &json!({ "asset": "pump", "file": "run.mcap" })).expect(202).json();
    assert_eq!(wait_for_end(&service, &again)["repeated"], 40);
    let list = service.get("/v1/replays?limit=1").expect(200).json();
    assert_eq!(list["items"][0]["id"], again["id"]);
    let next = service
        .get(&format!("/v1/replays?cursor={}", list["next_cursor"].as_str().unwrap()))
        .expect(200)
        .json();
    assert_eq!(next["items"][0]["id"], replay["id"]);
}

#[test]
fn a_replay_of_any_format_takes_what_the_file_lacks() {
    let service = Service::start();
    service.plain_asset("pump");
    let folder = service.folder().join("recordings");
    std::fs::copy("fixtures/npy/int16-two-channels.npy", folder.join("a.npy")).unwrap();
    let clock: String = (0..50).map(|k| format!("9,30,10,{},{k},1\n", 10_000 * k)).collect();
    std::fs::write(folder.join("acc.csv"), clock).unwrap();
    let replay = |body: Value| service.post_json("/v1/replays", &body);
    let start = "2026-01-05T08:00:00Z";
    let recording = json!({ "sample_rate_hz": 100.0, "unit": "m/s2", "scale": 0.5, "record_seconds": 0.5, "start_time": start });
    let started =
        replay(json!({ "asset": "pump", "file": "a.npy", "recording": recording })).expect(202).json();
    assert_eq!(started["recording"], recording);
    let ended = wait_for_end(&service, &started);
    assert_eq!((&ended["state"], &ended["stored"]), (&json!("finished"), &json!(4)), "{ended}");
    assert_eq!(
        (&ended["first_start_time"], &ended["last_start_time"]),
        (&json!(start), &json!("2026-01-05T08:00:00.5Z"))
    );
    // The scale is stored with the record.
    let first = service.get("/v1/assets/pump/segments?limit=1").json()["items"][0].clone();
    let raw = service.get(&format!("/v1/segments/{}/raw", first["id"].as_str().unwrap()));
    let record = decode_block(&raw.bytes, BlockEncoding::Protobuf, &RecordDefaults::default()).unwrap();
    assert_eq!((record.source_scale(), record.unit()), (Some(0.5), "m/s2"));
    // A time of day is the last one before the replay, or the first one from a given start.
    let started = replay(json!({ "asset": "pump", "file": "acc.csv" })).expect(202).json();
    let ended = wait_for_end(&service, &started);
    let (first, asked) = (&ended["first_start_time"], &ended["started_at"]);
    assert!(first.as_str() < asked.as_str() && first.as_str().unwrap().ends_with("T09:30:10Z"), "{ended}");
    let recording = json!({ "start_time": start });
    let started =
        replay(json!({ "asset": "pump", "file": "acc.csv", "recording": recording })).expect(202).json();
    assert_eq!(wait_for_end(&service, &started)["first_start_time"], "2026-01-05T09:30:10Z");
    let started = replay(json!({ "asset": "pump", "file": "a.npy" })).expect(202).json();
    let error = wait_for_end(&service, &started)["error"].as_str().unwrap().to_owned();
    assert!(error.contains("sample rate is missing"), "{error}");
    for (field, value) in [("sample_rate_hz", 0), ("scale", 0), ("record_seconds", -1)] {
        replay(json!({ "asset": "pump", "file": "a.npy", "recording": { field: value } }))
            .expect_problem(422, &[field, "recording"]);
    }
}

#[test]
fn a_paced_replay_waits_and_can_be_stopped() {
    let service = Service::start();
    service.plain_asset("pump");
    let records: Vec<_> = (0..40).map(|n| record("1", n)).collect();
    std::fs::write(service.folder().join("recordings/run.mcap"), mcap(&records)).unwrap();
    let body = json!({ "asset": "pump", "file": "run.mcap", "pace": "realtime" });
    let replay = service.post_json("/v1/replays", &body).expect(202).json();
    let path = format!("/v1/replays/{}", replay["id"].as_str().unwrap());
    service.wait_for(&path, |replay| replay["records_done"] == 1);
    let stopped = service.delete(&path).expect(200).json();
    assert_eq!((&stopped["state"], &stopped["records_done"]), (&json!("stopped"), &json!(1)));
    assert_ne!(stopped["finished_at"], json!(null));
    assert_eq!(service.delete(&path).expect(200).json(), stopped);
}

#[test]
fn recordings_that_may_be_replayed_are_listed() {
    let service = Service::start();
    assert_eq!(service.get("/v1/replay-files").expect(200).json(), json!({ "items": [] }));
    std::fs::create_dir_all(service.folder().join("recordings/line 1")).unwrap();
    std::fs::write(service.folder().join("recordings/line 1/run.mcap"), b"abc").unwrap();
    let listed = service.get("/v1/replay-files").expect(200).json();
    assert_eq!(
        (&listed["items"][0]["file"], &listed["items"][0]["bytes"]),
        (&json!("line 1/run.mcap"), &json!(3))
    );
}

#[test]
fn only_recordings_inside_the_folder_are_replayed() {
    let service = Service::start();
    service.plain_asset("pump");
    std::fs::write(service.folder().join("secret.mcap"), b"x").unwrap();
    let absolute = service.folder().join("secret.mcap");
    for file in ["../secret.mcap", "", ".", "none.mcap", absolute.to_str().unwrap(), "a/../../secret.mcap"] {
        let problem = service.post_json("/v1/replays", &json!({ "asset": "pump", "file": file }));
        assert_eq!(problem.expect_problem(422, &[])["field"], "file");
    }
    service.post_json("/v1/replays", &json!({ "asset": "none", "file": "x" })).expect_problem(404, &["none"]);
    std::fs::write(service.folder().join("recordings/broken.mcap"), b"not a recording").unwrap();
    let replay = service
        .post_json("/v1/replays", &json!({ "asset": "pump", "file": "broken.mcap" }))
        .expect(202)
        .json();
    let ended = wait_for_end(&service, &replay);
    assert_eq!(ended["state"], "failed");
    assert!(!ended["error"].as_str().unwrap().is_empty());
}

#[test]
fn every_measuring_point_has_its_unit_in_every_format() {
    let service = Service::start();
    let mut asset = plain_asset("pump");
    asset["sensor"] = json!({ "unit": "m/s2" });
    asset["points"] = json!([{ "channel": "velocity", "unit": "mm/s" }, { "channel": "elsewhere" }]);
    service.post_json("/v1/assets", &asset).expect(201);
    let units = || -> BTreeMap<String, String> {
        let segments = service.get("/v1/assets/pump/segments").expect(200).json();
        let items = segments["items"].as_array().unwrap().iter();
        let text = |value: &Value| value.as_str().unwrap().to_owned();
        items.map(|segment| (text(&segment["channel"]), text(&segment["unit"]))).collect()
    };
    let expected = |pairs: &[(&str, &str)]| -> BTreeMap<String, String> {
        let owned = |(channel, unit): &(&str, &str)| ((*channel).to_owned(), (*unit).to_owned());
        pairs.iter().map(owned).collect()
    };
    let both = wav(&[samples(1), samples(2)]);
    let names = "/v1/assets/pump/segments?channel_names=velocity,other&start_time=2026-01-01T00:00:00Z";
    service.post(names, "audio/wav", &both).expect(201);
    assert_eq!(units(), expected(&[("velocity", "mm/s"), ("other", "m/s2")]));
    // The query applies to all records, and each stays in its channel.
    let named = |names: &str| {
        let path = format!(
            "/v1/assets/pump/segments?channel_names={names}&unit=g&temperature_c=62.5&start_time=2026-01-02T00:00:00Z"
        );
        service.post(&path, "audio/wav", &both)
    };
    named("velocity,other").expect_problem(422, &["velocity", "\"g\"", "mm/s"]);
    let stored = named("further,other").expect(201).json();
    assert_eq!(
        (&stored["segments"][0]["unit"], &stored["segments"][1]["unit"]),
        (&json!("m/s2"), &json!("m/s2"))
    );
    assert_eq!(stored["segments"][1]["operating_point"], json!({ "temperature_c": 62.5 }));
    service.delete("/v1/assets/pump").expect(204);

    service.post_json("/v1/assets", &asset).expect(201);
    let block = json!({ "channel": "velocity", "sample_rate_hz": 4096.0, "start_time": "2026-01-01T00:00:00Z", "samples": samples(1) });
    service.post_json("/v1/assets/pump/segments", &block).expect(201);
    let without_unit = |channel: &str, n: u32| {
        let record = record(channel, n);
        Record::new(channel, record.start_time(), record.sample_rate_hz(), "", record.samples().to_vec())
            .unwrap()
    };
    let recording = mcap(&[without_unit("velocity", 3), without_unit("elsewhere", 3)]);
    service.post("/v1/assets/pump/segments", "application/mcap", &recording).expect(201);
    assert_eq!(units(), expected(&[("velocity", "mm/s"), ("elsewhere", "m/s2")]));
}

#[test]
fn channels_of_a_recording_get_other_names_and_units() {
    let service = Service::start();
    service.plain_asset("pump");
    let without_unit = |channel: &str, n: u32| {
        let record = record(channel, n);
        Record::new(channel, record.start_time(), record.sample_rate_hz(), "", record.samples().to_vec())
            .unwrap()
    };
    let recording = mcap(&[without_unit("x", 0), record("y", 0), record("z", 0), without_unit("x", 1)]);
    let send = |query: &str| {
        service.post(&format!("/v1/assets/pump/segments?{query}"), "application/mcap", &recording)
    };
    let answer = send("recorded_channels=x,y&channel_names=input,x&channel_units=g,mm/s").expect(201).json();
    assert_eq!((&answer["stored"], &answer["channels"]), (&json!(4), &json!(["input", "x", "z"])));
    let latest = |channel: &str| {
        let path = format!("/v1/assets/pump/segments?channel={channel}&order=desc&limit=1");
        service.get(&path).expect(200).json()["items"][0].clone()
    };
    let rms = |channel: &str| latest(channel)["indicators"]["rms"].as_f64().unwrap();
    // Samples without a unit are in g; those of y have their own unit, which takes precedence.
    assert_eq!((&latest("input")["unit"], &latest("x")["unit"]), (&json!("m/s2"), &json!("m/s2")));
    let first = service.get("/v1/assets/pump/segments?channel=input&limit=1").expect(200).json();
    let ratio = first["items"][0]["indicators"]["rms"].as_f64().unwrap() / rms("x");
    assert!((ratio / 9.80665 - 1.0).abs() < 1e-5, "{ratio}");
    // The stored bytes are those of the recording, and are read under the new name and unit.
    let id = latest("input")["id"].as_str().unwrap().to_owned();
    let waveform = service.get(&format!("/v1/segments/{id}/waveform?max_points=200000")).expect(200).json();
    let read = waveform["value"][7].as_f64().unwrap();
    assert!((read / (f64::from(samples(1)[7]) * 9.80665) - 1.0).abs() < 1e-5, "{read}");
    let again = send("recorded_channels=x,y&channel_names=input,x&channel_units=g,mm/s").expect(201).json();
    assert_eq!((&again["stored"], &again["repeated"]), (&json!(0), &json!(4)));
    assert!(again["missing_channels"].is_null(), "{again}");
    let odd = send("recorded_channels=X,y&channel_names=input,x").expect(201).json();
    assert_eq!(odd["missing_channels"], json!(["X"]), "{odd}");

    send("recorded_channels=x,y&channel_names=a").expect_problem(422, &["recorded_channels"]);
    send("recorded_channels=x,y&channel_names=a,a").expect_problem(422, &["channel_names", "at most once"]);
    send("channel_names=a").expect_problem(422, &["recorded_channels"]);
    send("unit=g").expect_problem(400, &["unit"]);
    let path = "/v1/assets/pump/segments?recorded_channels=x&channel_names=a";
    service.post(path, "audio/wav", &wav(&[samples(1)])).expect_problem(400, &["recorded_channels"]);
}

#[test]
fn recordings_are_previewed_without_being_stored() {
    let service = Service::start();
    let look = |query: &str, media_type: &str, bytes: &[u8]| {
        service.post(&format!("/v1/recording-preview{query}"), media_type, bytes).expect(200).json()
    };
    let mat = std::fs::read("fixtures/matlab/bearing-two-channels.mat").unwrap();
    let seen = look("?sample_rate_hz=12000", "application/x-matlab-data", &mat);
    let channels = seen["channels"].as_array().unwrap();
    assert_eq!(channels.len(), 2, "{seen}");
    for channel in channels {
        let envelope = channel["envelope"].as_array().unwrap();
        assert!(!envelope.is_empty() && envelope.len() <= 200);
        assert!(envelope.iter().all(|ends| ends[0].as_f64() <= ends[1].as_f64()), "{channel}");
        assert_eq!((&channel["start_time"], &channel["unit"]), (&Value::Null, &Value::Null));
        assert_eq!(channel["sample_rate_hz"], 12000.0);
    }
    assert_ne!(channels[0]["channel"], channels[1]["channel"]);
    let seen = look("", "application/x-matlab-data", b"no MATLAB file");
    assert!(seen["channels"].as_array().unwrap().is_empty() && seen["fault"].is_string(), "{seen}");

    let one = record("x", 3);
    let block = encode_block(&one, BlockEncoding::Protobuf);
    let seen = look("", "application/x-protobuf", &block);
    let [channel] = &seen["channels"].as_array().unwrap()[..] else { panic!("{seen}") };
    assert_eq!((&channel["channel"], &channel["unit"]), (&json!("x"), &json!(one.unit())));
    assert_eq!(channel["samples"], one.samples().len());
    assert_eq!(channel["start_time"], one.start_time().to_string());

    let records: Vec<_> = (0..12).flat_map(|n| [record("x", n), record("y", n)]).collect();
    let bytes = mcap(&records);
    let cut = look("", "application/mcap", &bytes[..bytes.len() / 2]);
    assert!(cut["fault"].as_str().unwrap().contains("in the middle of a record"), "{cut}");
    let seen = look("", "application/mcap", &bytes);
    let names: Vec<_> = seen["channels"].as_array().unwrap().iter().map(|each| &each["channel"]).collect();
    assert_eq!((names, &seen["fault"]), (vec![&json!("x"), &json!("y")], &Value::Null), "{seen}");
    service
        .post("/v1/recording-preview", "audio/wav", b"RIFF")
        .expect_problem(415, &["audio/wav", "application/mcap"]);
    service
        .post("/v1/recording-preview?sample_rate_hz=-1", "application/x-matlab-data", &mat)
        .expect_problem(400, &["sample_rate_hz"]);
    assert_eq!(service.get("/v1/assets").expect(200).json()["items"], json!([]));
}

/// A WAV states neither unit nor time: its samples are in the asset's unit, as in an upload of the file, and
/// the first record keeps the default start, so a repeat stores nothing.
#[test]
fn a_replayed_wav_has_the_units_of_the_asset_and_its_own_times() {
    let service = Service::start();
    let point = json!({"channel": "2", "unit": "g"});
    let mut asset = plain_asset("pump");
    asset["points"] = json!([point]);
    service.post_json("/v1/assets", &asset).expect(201);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.wav");
    std::fs::write(&path, wav(&[[samples(0), samples(1)].concat(), [samples(2), samples(3)].concat()]))
        .unwrap();
    let url = service.url("");
    let words =
        ["replay", path.to_str().unwrap(), "--asset", "pump", "--record-seconds", "0.5", "--url", &url];
    for _ in 0..2 {
        flankwatch(&[&words[..], &["--start-time", "1970-01-01T00:00:00Z"]].concat()).expect_success();
    }
    let stored = service.get("/v1/assets/pump/segments").expect(200).json();
    let mut found: Vec<_> = stored["items"].as_array().unwrap().iter().collect();
    found.sort_by_key(|segment| segment["channel"].to_string());
    let found: Vec<_> =
        found.iter().map(|s| ["channel", "unit", "start_time"].map(|name| &s[name])).collect();
    let times = ["1970-01-01T00:00:00Z", "1970-01-01T00:00:00.5Z"];
    let expected =
        [("1", "m/s2", times[0]), ("1", "m/s2", times[1]), ("2", "g", times[0]), ("2", "g", times[1])];
    assert_eq!(json!(found), json!(expected));
}
