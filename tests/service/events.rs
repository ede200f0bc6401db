//! Server-sent events and conditional requests.

use crate::event_stream::EventStream;
use crate::running::{Service, record};

#[test]
fn records_are_sent_live_and_missed_ones_after_a_reconnect() {
    let service = Service::start();
    service.plain_asset("pump");
    service.plain_asset("fan");
    let mut all = EventStream::open(&service, "", None);
    let mut fan = EventStream::open(&service, "?asset=fan", None);
    let segment = service.upload("pump", &record("1", 1));
    let first = all.next();
    assert_eq!((first.kind.as_str(), &first.data["segment_id"]), ("indicators", &segment["id"]));
    assert_eq!(first.data["indicators"]["rms"], segment["indicators"]["rms"]);
    let second = all.next();
    assert_eq!((second.kind.as_str(), &second.data["wear"]["status"]), ("wear", &segment["wear"]["status"]));
    drop(all);
    let of_fan = service.upload("fan", &record("1", 2));
    assert_eq!(fan.next().data["segment_id"], of_fan["id"]);
    let mut again = EventStream::open(&service, "", Some(&first.id));
    assert_eq!(again.next().id, second.id);
    assert_eq!(again.next().data["segment_id"], of_fan["id"]);
    let mut strange = EventStream::open(&service, "", Some("other-7"));
    assert_eq!(strange.next().kind, "lost");
    service.get("/v1/events?asset=none").expect_problem(404, &["none"]);
}

#[test]
fn dropped_events_are_reported_as_lost() {
    let service = Service::start_with(|config| config.http.events_kept = 4);
    service.plain_asset("pump");
    let mut stream = EventStream::open(&service, "", None);
    service.upload("pump", &record("1", 0));
    let first = stream.next();
    for n in 1..6 {
        service.upload("pump", &record("1", n));
        stream.next();
        stream.next();
    }
    // The second event of the last upload, without which fewer are lost.
    stream.next();
    let mut again = EventStream::open(&service, "", Some(&first.id));
    let lost = again.next();
    assert_eq!(lost.kind, "lost");
    assert!(lost.data["events"].as_u64().unwrap() >= 7, "{lost:?}");
    assert_eq!(again.next().kind, "indicators");
}

#[test]
fn unchanged_responses_are_answered_with_304() {
    let service = Service::start();
    service.plain_asset("pump");
    let segment = service.upload("pump", &record("1", 1));
    let segment = format!("/v1/segments/{}", segment["id"].as_str().unwrap());
    let paths = [
        "/v1/assets",
        "/v1/assets/pump",
        "/v1/assets/pump/wear",
        "/v1/assets/pump/wear/history",
        "/v1/assets/pump/indicators?names=rms",
        "/v1/assets/pump/segments",
        "/v1/replays",
        &segment,
    ];
    let marks: Vec<String> =
        paths.iter().map(|path| service.get(path).expect(200).header("etag").to_string()).collect();
    for (path, mark) in paths.iter().zip(&marks) {
        let again = service.send("GET", path, &[("if-none-match", mark)], b"").expect(304);
        assert_eq!((again.header("etag"), again.bytes.len()), (mark.as_str(), 0), "{path}");
    }
    service.upload("pump", &record("1", 2));
    for (path, mark) in paths[..6].iter().zip(&marks) {
        service.send("GET", path, &[("if-none-match", mark)], b"").expect(200);
    }
}

#[test]
fn trends_are_available_as_csv_and_parquet() {
    let service = Service::start();
    service.plain_asset("pump");
    for n in 0..3 {
        service.upload("pump", &record("1", n));
    }
    let csv = [("accept", "text/csv")];
    let answer = service.send("GET", "/v1/assets/pump/indicators?names=rms,kurtosis", &csv, b"").expect(200);
    assert_eq!(answer.header("content-type"), "text/csv; charset=utf-8");
    let text = String::from_utf8(answer.bytes.clone()).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!((lines[0], lines.len()), ("start_time,segment_id,kurtosis,rms", 4));
    let rows = service.get("/v1/assets/pump/indicators?names=rms,kurtosis").expect(200).json();
    let fields: Vec<&str> = lines[2].split(',').collect();
    assert_eq!(fields[0], rows["items"][1]["start_time"]);
    assert_eq!(fields[3].parse::<f64>().unwrap(), rows["items"][1]["rms"]);
    let answer = service.send("GET", "/v1/assets/pump/wear/history", &csv, b"").expect(200);
    let text = String::from_utf8(answer.bytes).unwrap();
    assert!(text.starts_with("start_time,segment_id,status,reason,median_um"), "{text}");
    assert_eq!(text.lines().count(), 4);
    let parquet = [("accept", "application/vnd.apache.parquet")];
    for path in ["indicators?names=rms,kurtosis", "wear/history"] {
        let answer = service.send("GET", &format!("/v1/assets/pump/{path}"), &parquet, b"").expect(200);
        assert_eq!(answer.header("content-type"), "application/vnd.apache.parquet");
        assert!(answer.bytes.starts_with(b"PAR1") && answer.bytes.ends_with(b"PAR1"));
    }
}
