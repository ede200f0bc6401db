//! How live streams begin and end: with a possible time, at their first sample, until they are removed.

use serde_json::{Value, json};

use crate::streams::{FORMAT, frames, open, records, service, status, time_ns};

#[test]
fn a_stream_does_not_start_with_an_impossible_time() {
    let service = service();
    let day_ns = 24 * 3_600_000_000_000;
    let mut wrong = open(&service, "&first_index=0");
    wrong.send(0, time_ns(0) + 20 * 365 * day_ns, &frames(0, 100));
    let (code, reason) = wrong.receive().unwrap_err();
    assert!(code == 4400 && reason.contains("start_time"), "{code} {reason}");
    let post = |time: &str| {
        let path = format!("/v1/assets/pump/stream?{FORMAT}&start_time={time}");
        service.post(&path, "application/octet-stream", &frames(0, 100))
    };
    for time in ["1600-01-01T00:00:00Z", "9999-01-01T00:00:00Z", "2100-01-01T00:00:00Z"] {
        assert_eq!(post(time).expect_problem(422, &["start_time", "expected"])["field"], "start_time");
    }
    service.get("/v1/assets/pump/stream").expect_problem(404, &["main"]);
    // Later ones are jumps of the sender's clock.
    let mut right = open(&service, "&first_index=0");
    right.send(0, time_ns(0), &frames(0, 2500));
    right.send(2500, time_ns(2500) + 400 * day_ns, &frames(2500, 100));
    right.wait_for(2600);
    assert_eq!(records(&service, "in", 1)[0]["start_time"], "2026-01-01T00:00:00Z");
    assert_eq!(status(&service)["last_refusal"], Value::Null);
}

#[test]
fn a_stream_exists_from_its_first_sample_until_it_is_removed() {
    let service = service();
    let post = |name: &str, more: &str| {
        let path = format!("/v1/assets/pump/stream?{FORMAT}&name={name}{more}");
        service.post(&path, "application/octet-stream", &frames(0, 10))
    };
    for n in 0..20 {
        post(&format!("refused-{n}"), "&after_gap=true").expect_problem(400, &["first_index"]);
        drop(open(&service, &format!("&name=opened-{n}")));
    }
    assert_eq!(service.get("/v1/assets/pump/streams").expect(200).json()["items"], json!([]));
    for n in 0..16 {
        post(&format!("sent-{n}"), "").expect(200);
    }
    post("one-more", "").expect_problem(422, &["name", "16"]);
    service.delete("/v1/assets/pump/stream?name=sent-3").expect(204);
    service.delete("/v1/assets/pump/stream?name=sent-3").expect_problem(404, &["sent-3"]);
    assert_eq!(
        service.get("/v1/assets/pump/streams").expect(200).json()["items"].as_array().unwrap().len(),
        15
    );
    assert_eq!(post("sent-3", "&first_index=5").expect(200).json()["next"], 15);
}
