//! Senders of streams of too much or invalid data get the reason.

use flankwatch::store::Scope;
use serde_json::{Value, json};

use crate::running::Service;
use crate::stream_socket::StreamSocket;
use crate::streams::{FORMAT, address, asset, frames, open, service, status, time_ns};
use crate::tokens::Tokens;

#[test]
fn a_count_that_restarts_is_refused_and_a_repeat_is_not() {
    let mut service = service();
    let post = |service: &Service, first: u64, count: u64, more: &str| {
        let path = format!("/v1/assets/pump/stream?{FORMAT}&first_index={first}{more}");
        service.post(&path, "application/octet-stream", &frames(first, count))
    };
    let (begin, later) = ("&start_time=2026-01-01T00:00:00Z", "&start_time=2026-01-01T01:00:00Z");
    post(&service, 0, 4000, begin).expect(200);
    let repeated = |answer: Value| (answer["next"].clone(), answer["repeated"].clone());
    assert_eq!(repeated(post(&service, 0, 4000, begin).expect(200).json()), (json!(4000), json!(4000)));
    // Without a clock nobody can tell.
    assert_eq!(repeated(post(&service, 0, 1000, "").expect(200).json()), (json!(4000), json!(1000)));
    service.restart();
    let problem = post(&service, 0, 1000, later).expect_problem(
        409,
        &["first_index is 0, expected at least 4000", "a sender whose count restarts needs another stream"],
    );
    assert_eq!(problem["field"], "first_index");
    let mut socket = open(&service, "");
    socket.send(1000, time_ns(1000), &frames(1000, 1000));
    socket.wait_for(4000);
    socket.send(0, time_ns(3_600_000), &frames(0, 1000));
    let (code, reason) = socket.receive().unwrap_err();
    assert!(code == 4400 && reason.contains("first_index is 0, expected at least 4000"), "{code} {reason}");
    // The clock is set by an hour, back and ahead: what was sent before and after it is repeated.
    for (first, set) in [(4000, -3600), (5000, 3600)] {
        let at_ns = time_ns(first) + set * 1_000_000_000;
        let mut socket = open(&service, "");
        socket.send(first, at_ns, &frames(first, 1000));
        socket.send(first, at_ns, &frames(first, 1000));
        socket.send(0, time_ns(0), &frames(0, 1000));
        socket.wait_for(first + 1000);
        socket.send_json(&json!({ "type": "end" }));
        let closed = loop {
            if let Err(closed) = socket.receive() {
                break closed;
            }
        };
        assert_eq!(closed.0, 1000, "{closed:?}");
    }
    assert_eq!(status(&service)["next"], 6000);
}

#[test]
fn a_unit_that_no_record_can_have_is_refused_before_the_samples() {
    let service = service();
    let post = |more: &str| {
        let path = format!("/v1/assets/pump/stream?sample=f32&sample_rate_hz=1000&{more}");
        service.post(&path, "application/octet-stream", &[0; 4000])
    };
    let problem = post("name=a&unit=V").expect_problem(422, &["V", "m/s2"]);
    assert_eq!((&problem["field"], &problem["value"]), (&json!("unit"), &json!("V")));
    post("name=a&unit=").expect_problem(422, &["unit is \"\""]);
    assert_eq!(
        StreamSocket::open(&service.url("/v1/assets/pump/stream?sample=f32&sample_rate_hz=1000&unit=V"), &[])
            .map(|_| ())
            .unwrap_err(),
        422
    );
    post("name=b&unit=g").expect(200);
    post("name=c").expect(200);
    // A point has a unit of its own, and a tachometer none.
    let mut asset = asset(2.0, 10.0);
    asset["points"] = json!([{ "channel": "volts", "unit": "V" }]);
    service.put_json("/v1/assets/pump", &asset).expect(200);
    post("name=d&unit=V&channel_names=volts").expect(200);
    let tachometer = "channels=2&tachometer_channel=tacho&tachometer_level=1";
    post(&format!("name=e&unit=V&channel_names=volts,tacho&{tachometer}")).expect(200);
    post("name=f&unit=V&channels=2&channel_names=volts,tacho").expect_problem(422, &["tacho", "V", "m/s2"]);
    let names: Vec<Value> = service.get("/v1/assets/pump/streams").expect(200).json()["items"]
        .as_array()
        .unwrap()
        .iter()
        .map(|stream| stream["name"].clone())
        .collect();
    assert_eq!(names, ["b", "c", "d", "e"]);
}

#[test]
fn invalid_stream_data_is_rejected_with_the_reason() {
    let service = service();
    let refused = |query: &str| {
        StreamSocket::open(&service.url(&format!("/v1/assets/{query}")), &[]).map(|_| ()).unwrap_err()
    };
    assert_eq!(refused(&format!("fan/stream?{FORMAT}")), 404);
    assert_eq!(refused("pump/stream?sample_rate_hz=1000"), 400);
    assert_eq!(refused("pump/stream?sample=f64&sample_rate_hz=1000"), 422);
    assert_eq!(refused("pump/stream?sample=f32&sample_rate_hz=0"), 422);
    assert_eq!(refused(&format!("pump/stream?{FORMAT}&name=../up")), 422);
    let body = vec![0; 1001];
    service
        .post(&format!("/v1/assets/pump/stream?{FORMAT}&name=posted"), "application/octet-stream", &body)
        .expect_problem(422, &["1001 bytes, expected a multiple of 4 (one sample of each of 2 channels)"]);
    // What only a body has, and an index that is none.
    for (more, words) in [
        (
            "start_time=2026-01-01T00:00:00Z",
            "start_time is 2026-01-01T00:00:00Z, expected no start time in a GET",
        ),
        ("after_gap=true", "after_gap is true, expected false in a GET"),
        ("first_index=9007199254740992", "first_index is \"9007199254740992\", expected a number below 2^53"),
    ] {
        assert_eq!(refused(&format!("pump/stream?{FORMAT}&{more}")), 400);
        service.get(&format!("/v1/assets/pump/stream?{more}")).expect_problem(400, &[words]);
    }
    // 2 s of 256 channels at 1 MHz are too large for a record.
    assert_eq!(refused("pump/stream?sample=f32&sample_rate_hz=1000000&channels=256"), 422);
    let mut first = open(&service, "&first_index=0");
    first.send(0, time_ns(0), &frames(0, 10));
    first.wait_for(10);
    assert_eq!(refused("pump/stream?sample=f32&sample_rate_hz=1000"), 409);
    // An incomplete frame closes the connection, after the frames before it are stored.
    first.send(10, time_ns(10), &frames(10, 10));
    first.send(20, time_ns(20), &[1, 2, 3]);
    let (code, reason) = loop {
        if let Err(closed) = first.receive() {
            break closed;
        }
    };
    assert!(code == 4400 && reason.contains("length"), "{code} {reason}");
    let mut second = open(&service, "");
    assert_eq!(second.next, Some(20));
    second.send_json(&json!({ "type": "dance" }));
    assert_eq!(second.receive().unwrap_err().0, 4400);
    let mut second = open(&service, "");
    second.send_json(&json!({ "type": "operating", "torque_nm": "5" }));
    let (code, reason) = second.receive().unwrap_err();
    let words = "torque_nm: invalid type: string \"5\", expected a number";
    assert!(code == 4400 && reason.contains(words), "{code} {reason}");
    // A standstill is an operating point, unlike a speed that no record can have.
    let mut second = open(&service, "");
    second.send_json(&json!({ "type": "operating", "shaft_speed_hz": 0 }));
    second.send_json(&json!({ "type": "operating", "shaft_speed_hz": -16.6 }));
    let (code, reason) = second.receive().unwrap_err();
    assert!(code == 4400 && reason.contains("shaft_speed_hz"), "{code} {reason}");
    // The latest connection owns the stream: an earlier one may be half-open.
    let mut third = open(&service, "");
    let mut fourth = open(&service, "");
    assert_eq!(third.receive().unwrap_err().0, 4409);
    fourth.send(20, time_ns(20), &frames(20, 5));
    fourth.wait_for(25);
    service.delete("/v1/assets/pump").expect(204);
    assert!([4404, 4409].contains(&fourth.receive().unwrap_err().0));
    service.post_json("/v1/assets", &asset(2.0, 10.0)).expect(201);
    assert_eq!(open(&service, "&first_index=7").next, Some(7));
}

#[test]
fn streams_are_limited_and_require_a_write_token() {
    let service = Service::start_with(|config| config.work.streams_at_once = 4);
    service.plain_asset("pump");
    let names = ["a", "b", "c"];
    let held: Vec<StreamSocket> = names.iter().map(|name| open(&service, &format!("&name={name}"))).collect();
    let refused = StreamSocket::open(&address(&service, "&name=d"), &[]).map(|_| ());
    assert_eq!(refused, Err(503));
    drop(held);
    let tokens = Tokens::of(service.folder());
    let admin = tokens.create("admin", Scope::Admin);
    let write = tokens.create("line 3", Scope::Write);
    let read = tokens.create("eyes", Scope::Read);
    let with = |token: &str| {
        StreamSocket::open(&address(&service, "&name=a"), &[("authorization", &format!("Bearer {token}"))])
    };
    assert_eq!(StreamSocket::open(&address(&service, ""), &[]).map(|_| ()), Err(401));
    assert_eq!(with(&read).map(|_| ()), Err(403));
    let bearer = format!("Bearer {write}");
    let origin = [("origin", "http://evil.example"), ("authorization", bearer.as_str())];
    assert_eq!(StreamSocket::open(&address(&service, ""), &origin).map(|_| ()), Err(403));
    let mut socket = with(&write).unwrap();
    let bearer = format!("Bearer {admin}");
    let tokens = [("authorization", bearer.as_str())];
    let listed = service.send("GET", "/v1/tokens", &tokens, b"").expect(200).json();
    let of_line = listed["items"].as_array().unwrap().iter().find(|token| token["name"] == "line 3").unwrap();
    let path = format!("/v1/tokens/{}", of_line["id"].as_str().unwrap());
    service.send("DELETE", &path, &tokens, b"").expect(204);
    assert_eq!(socket.receive().unwrap_err().0, 4401);
}
