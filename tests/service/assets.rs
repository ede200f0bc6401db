//! Creating, listing, updating and deleting assets.

use flankwatch::asset::AssetId;
use flankwatch::store::RecordRange;
use serde_json::json;

use crate::durability::raw_objects;
use crate::running::{Service, mcap, plain_asset, record, samples, wav};

#[test]
fn an_asset_is_created_read_updated_and_deleted() {
    let service = Service::start();
    let made = service.post_json("/v1/assets", &plain_asset("pump-1")).expect(201);
    assert_eq!(made.header("location"), "/v1/assets/pump-1");
    let made = made.json();
    assert_eq!(made["gear"]["teeth"], json!([31, 62]));
    assert_eq!(made["created_at"], "2026-01-01T00:00:00Z");
    assert_eq!(made["summary"]["segments"], 0);
    assert_eq!(made["summary"]["library_state"], "none");
    assert_eq!(made["summary"]["library_id"], json!(null));
    assert_eq!(service.get("/v1/assets/pump-1").expect(200).json(), made);
    service.post_json("/v1/assets", &plain_asset("pump-1")).expect_problem(409, &["pump-1", "exists"]);

    service.clock.advance(60);
    let mut changed = plain_asset("pump-1");
    changed["name"] = json!("Feed pump");
    changed["limits"] = json!({ "warning_um": 100.0 });
    let changed = service.put_json("/v1/assets/pump-1", &changed).expect(200).json();
    assert_eq!(changed["name"], "Feed pump");
    assert_eq!(changed["created_at"], made["created_at"]);
    assert_eq!(changed["updated_at"], "2026-01-01T00:01:00Z");
    service.put_json("/v1/assets/pump-2", &plain_asset("pump-2")).expect_problem(404, &["pump-2"]);
    service.put_json("/v1/assets/pump-2", &plain_asset("pump-1")).expect_problem(422, &["pump-1", "pump-2"]);

    assert!(service.delete("/v1/assets/pump-1").expect(204).bytes.is_empty());
    service.get("/v1/assets/pump-1").expect_problem(404, &["pump-1"]);
    service.delete("/v1/assets/pump-1").expect_problem(404, &["pump-1"]);
}

#[test]
fn a_description_in_toml_is_accepted() {
    let service = Service::start();
    let toml = "id = \"fan\"\n[gear]\nteeth = [31, 62]\nshaft_speed_hz = 10.0\n";
    let fan = service.post("/v1/assets", "application/toml", toml.as_bytes()).expect(201).json();
    assert_eq!(fan["baseline"]["records"], 20);
    for (wrong, words, field) in [
        (
            toml.replace("shaft_speed_hz", "shaft_sped_hz"),
            "unknown field `shaft_sped_hz`",
            "gear.shaft_sped_hz",
        ),
        (toml.replace("10.0", "\"10\""), "line 4", "gear.shaft_speed_hz"),
        (toml.replace("[31, 62]", "[2, 62]"), "[2, 62]", "gear.teeth"),
        (
            format!("{toml}[gear.pair.geometry]\nteeth = [31, 62]\n"),
            "missing field",
            "gear.pair.geometry.module_mm",
        ),
        (format!("colour = 1\n{toml}"), "unknown field `colour`", "colour"),
    ] {
        let problem = service.post("/v1/assets", "application/toml", wrong.as_bytes());
        assert_eq!(problem.expect_problem(422, &[words])["field"], field);
    }
    let wrong = toml.replace("[gear]", "[gear");
    let problem = service.post("/v1/assets", "application/toml", wrong.as_bytes());
    assert!(problem.expect_problem(422, &["line 2"]).get("field").is_none());
}

#[test]
fn an_invalid_description_is_rejected_with_its_field() {
    let service = Service::start();
    let mut asset = plain_asset("pump");
    asset["gear"]["teeth"] = json!([2, 62]);
    let problem = service.post_json("/v1/assets", &asset).expect_problem(422, &["gear.teeth", "[2, 62]"]);
    assert_eq!(problem["field"], "gear.teeth");
    assert_eq!(problem["value"], "[2, 62]");
    assert!(problem["expected"].as_str().unwrap().contains("4 to 1000"));
    let mut asset = plain_asset("pump");
    asset["colour"] = json!("red");
    assert_eq!(service.post_json("/v1/assets", &asset).expect_problem(422, &["colour"])["field"], "colour");
    service.post_json("/v1/assets", &plain_asset("../etc")).expect_problem(422, &["../etc"]);
    let mut asset = plain_asset("pump");
    asset.as_object_mut().unwrap().remove("gear");
    assert_eq!(service.post_json("/v1/assets", &asset).expect_problem(422, &["gear"])["field"], "gear");
}

#[test]
fn a_list_is_paged_without_loss() {
    let service = Service::start();
    for n in [3, 1, 5, 2, 4] {
        service.plain_asset(&format!("pump-{n}"));
    }
    let mut ids = Vec::new();
    let mut cursor = String::new();
    loop {
        let page = service.get(&format!("/v1/assets?limit=2{cursor}")).expect(200).json();
        let items = page["items"].as_array().unwrap().clone();
        assert!((1..=2).contains(&items.len()));
        ids.extend(items.iter().map(|asset| asset["id"].as_str().unwrap().to_string()));
        match page["next_cursor"].as_str() {
            Some(next) => cursor = format!("&cursor={next}"),
            None => break,
        }
    }
    assert_eq!(ids, ["pump-1", "pump-2", "pump-3", "pump-4", "pump-5"]);
}

#[test]
fn deleting_an_asset_removes_its_records_and_only_its_own_raw_bytes() {
    let service = Service::start();
    service.plain_asset("one");
    service.plain_asset("two");
    let (shared, own) = (wav(&[samples(1)]), wav(&[samples(2)]));
    let upload = |asset: &str, bytes: &[u8]| {
        let path = format!("/v1/assets/{asset}/segments?start_time=2026-01-01T00:00:00Z");
        service.post(&path, "audio/wav", bytes).expect(201).json()
    };
    let (first, kept) = (upload("one", &shared), upload("two", &shared));
    let lost = upload("one", &own);
    assert_eq!(first["raw"], kept["raw"]);
    assert_ne!(first["id"], kept["id"]);
    let object = |segment: &serde_json::Value| {
        let name = segment["raw"]["sha256"].as_str().unwrap();
        service.folder().join("raw").join(&name[..2]).join(name)
    };
    assert!(object(&lost).is_file() && object(&kept).is_file());
    service.delete("/v1/assets/one").expect(204);
    assert!(!object(&lost).exists() && object(&kept).is_file());
    service.get(&format!("/v1/segments/{}", lost["id"].as_str().unwrap())).expect_problem(404, &[]);
    service.get(&format!("/v1/segments/{}/waveform", kept["id"].as_str().unwrap())).expect(200);
    // The identifier is free again, and no old data reappears.
    service.plain_asset("one");
    let wear = service.get("/v1/assets/one/wear").expect(200).json();
    assert_eq!((&wear["segment_id"], &wear["status"]), (&json!(null), &json!("collecting_baseline")));
    service.upload("one", &record("1", 7));
    assert_eq!(
        service.get("/v1/assets/one/indicators?names=rms").expect(200).json()["items"]
            .as_array()
            .unwrap()
            .len(),
        1
    );
}

#[test]
fn a_summary_covers_all_channels() {
    let service = Service::start();
    service.plain_asset("pump");
    for n in [2, 1] {
        service.upload("pump", &record("b", n));
    }
    service.upload("pump", &record("a", 3));
    let summary = service.get("/v1/assets/pump").expect(200).json()["summary"].clone();
    assert_eq!(summary["segments"], 3);
    assert_eq!(summary["channels"], json!(["b", "a"]));
    assert_eq!(summary["wear_channel"], "b");
    assert_eq!(summary["first_start_time"], "2026-01-01T00:01:00Z");
    assert_eq!(summary["last_start_time"], "2026-01-01T00:03:00Z");
    assert_eq!(summary["wear"]["posterior"], json!(null));
    let parts = |answer: &serde_json::Value| -> Vec<String> {
        let parts = answer.as_array().unwrap().iter();
        parts.map(|part| format!("{} {}", part["channel"], part["status"]).replace('"', "")).collect()
    };
    let both = ["b collecting_baseline", "a collecting_baseline"];
    assert_eq!(parts(&summary["wear_channels"]), both);
    let together = service.get("/v1/assets/pump/wear").expect(200);
    assert_eq!(parts(&together.json()["channels"]), both);
    // The ETag changes when another channel has a record.
    let tag = together.header("etag").to_owned();
    service.send("GET", "/v1/assets/pump/wear", &[("if-none-match", &tag)], b"").expect(304);
    service.upload("pump", &record("a", 4));
    service.send("GET", "/v1/assets/pump/wear", &[("if-none-match", &tag)], b"").expect(200);
    let one = service.get("/v1/assets/pump/wear?channel=a").expect(200).json();
    assert_eq!((&one["channel"], &one["channels"]), (&json!("a"), &json!(null)));
    service.get("/v1/assets/pump/wear?channel=c").expect_problem(404, &["\"c\""]);
    // A channel that ended while the other continues is listed as silent and ignored.
    service.upload("pump", &record("a", 30));
    let together = service.get("/v1/assets/pump/wear").expect(200).json();
    let silent = &together["channels"][1];
    assert_eq!((&silent["channel"], &silent["silent_since"]), (&json!("b"), &json!("2026-01-01T00:02:00Z")));
    assert!(together["reason"].as_str().unwrap().contains("channel b is not included"), "{together}");
}

#[test]
fn an_update_can_be_conditional_on_the_etag() {
    let service = Service::start();
    service.plain_asset("pump");
    let seen = service.get("/v1/assets/pump").expect(200);
    let tag = seen.header("etag").to_owned();
    let put = |description: &serde_json::Value, headers: &[(&str, &str)]| {
        let headers = [&[("content-type", "application/json")], headers].concat();
        service.send("PUT", "/v1/assets/pump", &headers, description.to_string().as_bytes())
    };
    // Further records change the response but not the description.
    service.upload("pump", &record("1", 1));
    let unchanged = service.send("GET", "/v1/assets/pump", &[("if-none-match", &tag)], b"").expect(200);
    let tag_now = unchanged.header("etag").to_owned();
    service.send("GET", "/v1/assets/pump", &[("if-none-match", &tag_now)], b"").expect(304);
    // The response is sent back with a change.
    let mut description = seen.json();
    description["name"] = serde_json::json!("Pump 1");
    let changed = put(&description, &[("if-match", &tag)]).expect(200);
    assert_eq!(changed.json()["name"], "Pump 1");
    description["name"] = serde_json::json!("Pump 2");
    put(&description, &[("if-match", &tag)]).expect_problem(412, &["pump", "has changed"]);
    put(&description, &[("if-match", &format!("W/{}", changed.header("etag")))])
        .expect_problem(412, &["pump"]);
    put(&description, &[("if-none-match", "*")]).expect_problem(412, &["pump"]);
    assert_eq!(service.get("/v1/assets/pump").expect(200).json()["name"], "Pump 1");
    let list = format!("\"other\", {}", changed.header("etag"));
    put(&description, &[("if-match", &list)]).expect(200);
    service.send("DELETE", "/v1/assets/pump", &[("if-match", &tag)], b"").expect_problem(412, &["pump"]);
    service.send("DELETE", "/v1/assets/pump", &[("if-match", "*")], b"").expect(204);
    // Elsewhere an unknown field is still an error.
    service.post_json("/v1/assets", &description).expect_problem(422, &["created_at"]);
}

#[test]
fn an_asset_with_many_records_is_deleted_some_at_a_time() {
    let service = Service::start();
    service.plain_asset("pump");
    let records: Vec<_> = (0..450).map(|n| record("1", n)).collect();
    service.post("/v1/assets/pump/segments", "application/mcap", &mcap(&records)).expect(201);
    // A deletion that was interrupted leaves an asset with fewer records.
    let pump = AssetId::new("pump").unwrap();
    service.run(async {
        let store = service.service().store.clone();
        let some = store.records_in(&pump, &RecordRange::default(), 30).await.unwrap();
        store.remove_records(&pump, &some).await.unwrap();
    });
    assert_eq!(service.get("/v1/assets/pump").expect(200).json()["summary"]["segments"], 420);
    service.delete("/v1/assets/pump").expect(204);
    service.get("/v1/assets/pump").expect(404);
    assert_eq!(service.run(service.service().store.segment_count()).unwrap(), 0);
    if std::env::var("FLANKWATCH_TEST_DATABASE").is_err() {
        assert_eq!(raw_objects(service.folder()).len(), 30, "those of the interrupted deletion");
        service.run(service.service().sweep()).unwrap();
        assert!(raw_objects(service.folder()).is_empty());
    }
}
