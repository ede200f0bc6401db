//! The live view of streams: several frames a second, the same for all viewers, until the asset, the token or
//! the service ends.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use flankwatch::store::Scope;
use serde_json::{Value, json};

use crate::event_stream::EventStream;
use crate::running::Service;
use crate::stream_socket::StreamSocket;
use crate::tokens::Tokens;

const RATE_HZ: u64 = 8000;
const TONE_HZ: f64 = 1250.0;
const AMPLITUDE: f64 = 2.5;
const PATH: &str = "/v1/assets/pump/stream/live";

fn asset() -> Value {
    json!({ "id": "pump", "gear": { "teeth": [20, 40], "shaft_speed_hz": 15.0 }, "sensor": { "unit": "m/s2" } })
}

/// Returns samples with a tone on the first channel and one of half the frequency on the second.
fn frames(first: u64, count: u64) -> Vec<u8> {
    let value =
        |k: u64, hz: f64| (AMPLITUDE * (std::f64::consts::TAU * hz * k as f64 / RATE_HZ as f64).sin()) as f32;
    (first..first + count)
        .flat_map(|k| [value(k, TONE_HZ), value(k, 0.5 * TONE_HZ)])
        .flat_map(f32::to_le_bytes)
        .collect()
}

fn open(service: &Service, more: &str, headers: &[(&'static str, &str)]) -> StreamSocket {
    let format = format!("sample=f32&sample_rate_hz={RATE_HZ}&channels=2&channel_names=in,out&first_index=0");
    let path = format!("/v1/assets/pump/stream?{format}{more}");
    StreamSocket::open(&service.url(&path), headers).unwrap()
}

/// Sends a stream in real time until it is dropped.
struct Sensor {
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Sensor {
    fn start(mut socket: StreamSocket) -> Self {
        let is_over = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&is_over);
        let thread = std::thread::spawn(move || {
            let (began, mut sent) = (Instant::now(), 0);
            while !ended.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(20));
                let due = (began.elapsed().as_secs_f64() * RATE_HZ as f64) as u64;
                socket.send(sent, 0, &frames(sent, due - sent));
                socket.wait_for(due);
                sent = due;
            }
        });
        Self { is_over, thread: Some(thread) }
    }
}

impl Drop for Sensor {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        let _ = self.thread.take().unwrap().join();
    }
}

/// Returns the frequency and amplitude of the highest line of a channel.
fn highest(frame: &Value, channel: usize) -> (f64, f64) {
    let channel = &frame["channels"][channel];
    let numbers = |name: &str| -> Vec<f64> {
        channel[name].as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect()
    };
    let (bins, amplitudes) = (numbers("bin"), numbers("amplitude"));
    let top = (0..bins.len()).max_by(|a, b| amplitudes[*a].total_cmp(&amplitudes[*b])).unwrap();
    (bins[top] * frame["resolution_hz"].as_f64().unwrap(), amplitudes[top])
}

#[test]
fn frames_show_the_sent_tones_and_are_the_same_for_all_viewers() {
    let service = Service::start();
    service.post_json("/v1/assets", &asset()).expect(201);
    let mut socket = open(&service, "", &[]);
    socket.send_json(&json!({ "type": "operating", "shaft_speed_hz": 12.5 }));
    let sensor = Sensor::start(socket);
    let watch = |seconds: f64| {
        let mut events = EventStream::open_path(&service.url(""), PATH, "");
        let mut seen = Vec::new();
        // The first frame is sent at once.
        events.next();
        let began = Instant::now();
        while began.elapsed().as_secs_f64() < seconds {
            let event = events.next();
            if event.kind == "frame" {
                seen.push(event.data);
            }
        }
        seen
    };
    let (one, other) = std::thread::scope(|scope| {
        let other = scope.spawn(|| watch(3.0));
        (watch(3.0), other.join().unwrap())
    });
    assert!(one.len() >= 15, "{} frames in 3 s", one.len());
    let last = one.last().unwrap();
    for (channel, hz) in [TONE_HZ, 0.5 * TONE_HZ].into_iter().enumerate() {
        let (found_hz, amplitude) = highest(last, channel);
        let resolution_hz = last["resolution_hz"].as_f64().unwrap();
        assert!((found_hz - hz).abs() <= resolution_hz && resolution_hz <= 2.0, "{found_hz}");
        assert!((amplitude / AMPLITUDE - 1.0).abs() < 0.02, "{amplitude}");
        let level = |name: &str| last["channels"][channel][name].as_f64().unwrap() / AMPLITUDE;
        assert!((level("rms") - 0.5_f64.sqrt()).abs() < 0.01 && (level("peak") - 1.0).abs() < 0.01);
    }
    assert_eq!((&last["channels"][1]["name"], &last["unit"]), (&json!("out"), &json!("m/s2")));
    assert_eq!((&last["shaft_speed_source"], &last["mesh_frequency_hz"]), (&json!("stream"), &json!(250.0)));
    let shared = one.iter().filter(|frame| other.contains(frame)).count();
    assert!(shared >= 10, "{shared} of {} frames are those of the other", one.len());
    // Frames that end with the same sample are the same.
    for frame in &one {
        assert!(other.iter().all(|each| each["next"] != frame["next"] || each == frame));
    }
    let mut events = EventStream::open_path(&service.url(""), PATH, "");
    // The first frame shows earlier samples; only later ones say when a sample arrived.
    for _ in 0..2 {
        assert_eq!(events.next().kind, "frame");
    }
    drop(sensor);
    let mut waited = Vec::new();
    while waited.len() < 2 {
        let event = events.next();
        if event.kind == "waiting" {
            waited.push(event.data["seconds"].as_u64().unwrap());
        }
    }
    assert!(waited[0] >= 2 && waited[1] == waited[0] + 1, "{waited:?}");
}

#[test]
fn a_slow_viewer_loses_frames_and_blocks_nobody() {
    let service = Service::start();
    service.post_json("/v1/assets", &asset()).expect(201);
    // Frames of maximum size, so that they do not all fit into the socket buffers.
    let path =
        format!("/v1/assets/pump/stream?sample=f32&sample_rate_hz={RATE_HZ}&channels=64&first_index=0");
    let mut socket = StreamSocket::open(&service.url(&path), &[]).unwrap();
    let chunk = |first: u64| -> Vec<u8> {
        let value = |k: u64| (k.wrapping_mul(2_654_435_761) % 65_521) as f32 / 1000.0;
        (first * 64..(first + 800) * 64).map(value).flat_map(f32::to_le_bytes).collect()
    };
    socket.send(0, 0, &chunk(0));
    socket.wait_for(800);
    let shown = Arc::new(AtomicU64::new(0));
    let nexts = |events: &mut EventStream, shown: &AtomicU64| -> Vec<u64> {
        let frames = std::iter::from_fn(|| events.next_or_end()).filter(|event| event.kind == "frame");
        let frames = frames.inspect(|_| _ = shown.fetch_add(1, Ordering::Relaxed));
        frames.map(|event| event.data["next"].as_u64().unwrap()).collect()
    };
    let mut slow = Some(EventStream::open_path(&service.url(""), PATH, ""));
    let quick = std::thread::spawn({
        let (url, shown) = (service.url(""), Arc::clone(&shown));
        move || nexts(&mut EventStream::open_path(&url, PATH, ""), &shown)
    });
    let (mut sent, mut longest, mut reading, mut left) = (800, Duration::ZERO, None, 30);
    while left > 0 {
        // Far more than the socket buffers hold: the viewer reads again.
        if shown.load(Ordering::Relaxed) >= 80
            && let Some(mut slow) = slow.take()
        {
            reading = Some(std::thread::spawn(move || nexts(&mut slow, &AtomicU64::new(0))));
        }
        left -= usize::from(reading.is_some());
        let began = Instant::now();
        socket.send(sent, 0, &chunk(sent));
        sent += 800;
        socket.wait_for(sent);
        longest = longest.max(began.elapsed());
        std::thread::sleep(Duration::from_millis(100).saturating_sub(began.elapsed()));
    }
    assert!(longest < Duration::from_secs(30), "a chunk waited for {longest:?}");
    let status = service.get("/v1/assets/pump/stream").expect(200).json();
    assert_eq!((&status["next"], &status["gaps"]), (&json!(sent), &json!(0)));
    service.delete("/v1/assets/pump").expect(204);
    let (quick, late) = (quick.join().unwrap(), reading.unwrap().join().unwrap());
    assert!(late.len() < quick.len(), "{} frames of {}", late.len(), quick.len());
    assert!(late.is_sorted() && quick.is_sorted());
    // The viewer continues with new frames, not with missed ones.
    assert!(late.windows(2).any(|pair| pair[1] - pair[0] > 2 * RATE_HZ), "{late:?}");
}

#[test]
fn a_view_ends_with_its_asset_and_needs_an_existing_stream() {
    let service = Service::start();
    service.post_json("/v1/assets", &asset()).expect(201);
    service.get(PATH).expect_problem(404, &["main"]);
    let mut socket = open(&service, "&name=end", &[]);
    service.get(&format!("{PATH}?name=end")).expect_problem(404, &["end"]);
    socket.send(0, 0, &frames(0, 1000));
    socket.wait_for(1000);
    service.get("/v1/assets/fan/stream/live").expect_problem(404, &["fan"]);
    service.get(&format!("{PATH}?name=../up")).expect_problem(404, &["../up"]);
    service.get(&format!("{PATH}?channel=in")).expect_problem(400, &["channel"]);
    let mut events = EventStream::open_path(&service.url(""), &format!("{PATH}?name=end"), "");
    assert_eq!(events.next().data["next"], 1000);
    service.delete("/v1/assets/pump").expect(204);
    while events.next_or_end().is_some() {}
    // An asset of the same name has another stream.
    service.post_json("/v1/assets", &asset()).expect(201);
    service.get(&format!("{PATH}?name=end")).expect_problem(404, &["end"]);
    let mut socket = open(&service, "&name=end", &[]);
    socket.send(0, 0, &frames(0, 1000));
    socket.wait_for(1000);
    let mut events = EventStream::open_path(&service.url(""), &format!("{PATH}?name=end"), "");
    assert_eq!(events.next().data["next"], 1000);
}

#[test]
fn a_view_starts_with_the_journal_after_a_restart_without_samples_before_a_gap() {
    let mut service = Service::start();
    service.post_json("/v1/assets", &asset()).expect(201);
    let mut socket = open(&service, "", &[]);
    socket.send(0, 0, &frames(0, 20_000));
    socket.wait_for(20_000);
    service.restart();
    let mut events = EventStream::open_path(&service.url(""), PATH, "");
    let frame = events.next().data;
    assert_eq!((&frame["next"], &frame["samples"]), (&json!(20_000), &json!(8000)));
    let mut socket = open(&service, "", &[]);
    socket.send_json(&json!({ "type": "gap", "next": 30_000 }));
    socket.send(30_000, 0, &frames(30_000, 1000));
    let frame = loop {
        let event = events.next();
        if event.kind == "frame" {
            break event.data;
        }
    };
    assert_eq!((&frame["next"], &frame["samples"]), (&json!(31_000), &json!(1000)));
}

#[test]
fn a_view_needs_a_token_and_ends_when_it_is_revoked() {
    let service = Service::start();
    service.post_json("/v1/assets", &asset()).expect(201);
    open(&service, "", &[]).send(0, 0, &frames(0, 1000));
    service.wait_for("/v1/assets/pump/streams", |list| list["items"][0]["next"] == 1000);
    let tokens = Tokens::of(service.folder());
    let admin = tokens.create("admin", Scope::Admin);
    let read = tokens.create("eyes", Scope::Read);
    service.get(PATH).expect_problem(401, &["token"]);
    let head = format!("authorization: Bearer {read}\r\n");
    let mut events = EventStream::open_path(&service.url(""), PATH, &head);
    assert_eq!(events.next().kind, "frame");
    let bearer = format!("Bearer {admin}");
    let as_admin = [("authorization", bearer.as_str())];
    let listed = service.send("GET", "/v1/tokens", &as_admin, b"").expect(200).json();
    let of_eyes = listed["items"].as_array().unwrap().iter().find(|token| token["name"] == "eyes").unwrap();
    let path = format!("/v1/tokens/{}", of_eyes["id"].as_str().unwrap());
    service.send("DELETE", &path, &as_admin, b"").expect(204);
    let began = Instant::now();
    while events.next_or_end().is_some() {}
    assert!(began.elapsed() < Duration::from_secs(10));
}
