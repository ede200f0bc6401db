//! Resumable uploads: received data is kept and read when it is complete, whatever happens to the client, the
//! service or the disk.

use std::io::Write;
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::program::Program;
use crate::resumable_client::{OFFSET_TYPE, TUS, ask, begin, expect_read, offset, patch, pieces, recording};
use crate::running::{Service, mcap, plain_asset, record};

fn base64(text: &str) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let chunk = |chunk: &[u8]| -> String {
        let word = (0..3).fold(0_u32, |word, n| word << 8 | u32::from(chunk.get(n).copied().unwrap_or(0)));
        let digit = |n: usize| {
            if n <= chunk.len() { char::from(DIGITS[(word >> (18 - 6 * n) & 63) as usize]) } else { '=' }
        };
        (0..4).map(digit).collect()
    };
    text.as_bytes().chunks(3).map(chunk).collect()
}

#[test]
fn a_large_recording_is_resumed_also_after_a_restart() {
    let mut service = Service::start();
    service.plain_asset("pump");
    let recording = mcap(&(0..5).map(|n| record("1", n)).collect::<Vec<_>>());
    let tus = ("tus-resumable", "1.0.0");
    let length = recording.len().to_string();
    let metadata = format!("asset {}", base64("pump"));
    let options = service.send("OPTIONS", "/v1/uploads", &[], b"").expect(204);
    assert_eq!(
        (options.header("tus-version"), options.header("tus-extension")),
        ("1.0.0", "creation,termination,expiration")
    );
    let begin = |metadata: &str, length: &str| {
        service.send(
            "POST",
            "/v1/uploads",
            &[tus, ("upload-length", length), ("upload-metadata", metadata)],
            b"",
        )
    };
    begin("asset eA==", &length).expect_problem(404, &["x"]);
    begin("", &length).expect_problem(400, &["asset"]);
    begin(&metadata, "9999999999999").expect_problem(413, &[]);
    let other = service.send("POST", "/v1/uploads", &[("upload-length", "1")], b"");
    assert_eq!((other.header("tus-resumable"), other.header("tus-version")), ("1.0.0", "1.0.0"));
    other.expect_problem(412, &["tus-resumable"]);
    let location = begin(&metadata, &length).expect(201).header("location").to_string();
    let given_up = begin(&metadata, &length).expect(201).header("location").to_string();
    service.send("DELETE", &given_up, &[tus], b"").expect(204);
    service.send("HEAD", &given_up, &[tus], b"").expect(404);
    let patch = |service: &Service, at: usize, bytes: &[u8]| {
        let at = at.to_string();
        let headers =
            [tus, ("upload-offset", at.as_str()), ("content-type", "application/offset+octet-stream")];
        service.send("PATCH", &location, &headers, bytes)
    };
    let half = recording.len() / 2;
    assert_eq!(patch(&service, 0, &recording[..half]).expect(204).header("upload-offset"), half.to_string());
    patch(&service, 0, &recording[..half]).expect_problem(409, &["upload-offset"]);
    service.restart();
    let head = service.send("HEAD", &location, &[tus], b"").expect(200);
    assert_eq!(
        (head.header("upload-offset"), head.header("upload-length")),
        (half.to_string().as_str(), length.as_str())
    );
    patch(&service, half, &[&recording[half..], b"more"].concat()).expect_problem(413, &[]);
    let head = service.send("HEAD", &location, &[tus], b"").expect(200);
    let at: usize = head.header("upload-offset").parse().unwrap();
    patch(&service, at, &recording[at..]).expect(204);
    let done = service.wait_for(&location, |upload| upload["state"] == "finished");
    assert_eq!((&done["result"]["stored"], &done["error"]), (&5.into(), &Value::Null));
    patch(&service, at, b"more").expect_problem(409, &["the upload is complete"]);
    service.let_uploads_expire();
    begin_again(&service, &metadata);
    service.get(&location).expect_problem(404, &[]);
}

fn begin_again(service: &Service, metadata: &str) {
    let headers = [("tus-resumable", "1.0.0"), ("upload-length", "1"), ("upload-metadata", metadata)];
    service.send("POST", "/v1/uploads", &headers, b"").expect(201);
}

/// Sends the head of a request of `length` bytes and then `bytes`, and disconnects without waiting for a
/// response.
fn hang_up_after(service: &Service, path: &str, length: usize, bytes: &[u8]) {
    let address = service.url("").replace("http://", "");
    let mut stream = TcpStream::connect(&address).unwrap();
    let head = format!(
        "PATCH {path} HTTP/1.1\r\nhost: {address}\r\ntus-resumable: 1.0.0\r\nupload-offset: 0\r\n\
         content-type: application/offset+octet-stream\r\ncontent-length: {length}\r\n\r\n"
    );
    stream.write_all(&[head.as_bytes(), bytes].concat()).unwrap();
    stream.shutdown(Shutdown::Both).unwrap();
}

#[test]
fn data_of_a_disconnected_client_is_kept() {
    let service = Service::start();
    service.plain_asset("pump");
    let whole = recording(0, 5);
    let path = begin(&service, whole.len());
    hang_up_after(&service, &path, whole.len(), &whole[..1000]);
    let began = Instant::now();
    while offset(&service, &path) < 1000 {
        assert!(began.elapsed() < Duration::from_secs(30));
        std::thread::sleep(Duration::from_millis(10));
    }
    patch(&service, &path, 1000, &whole[1000..]).expect(204);
    expect_read(&service, &path, 5);
    for from in (10..50).step_by(5) {
        let whole = recording(from, from + 5);
        let path = begin(&service, whole.len());
        hang_up_after(&service, &path, whole.len(), &whole);
        expect_read(&service, &path, 5);
    }
}

#[test]
fn only_unfinished_uploads_count_against_the_limit() {
    let service = Service::start_with(|config| config.http.uploads_at_once = 2);
    service.plain_asset("pump");
    let whole = recording(0, 1);
    for _ in 0..65 {
        let path = begin(&service, whole.len());
        patch(&service, &path, 0, &whole).expect(204);
        expect_read(&service, &path, 1);
    }
    let broken = begin(&service, 4);
    patch(&service, &broken, 0, b"none").expect(204);
    service.wait_for(&broken, |upload| upload["state"] == "failed");
    let open = [begin(&service, 10), begin(&service, 10)];
    let refused = ask(&service, 10);
    assert_eq!(refused.header("retry-after"), "60");
    refused.expect_problem(503, &["too many uploads"]);
    service.send("DELETE", &open[0], &[TUS], b"").expect(204);
    begin(&service, 10);
    ask(&service, 10).expect_problem(503, &[]);
}

/// Tests of the folder of a single machine.
mod in_a_folder {
    use super::*;

    #[test]
    fn an_upload_acknowledged_by_a_killed_program_is_read_after_the_restart() {
        let folder = tempfile::tempdir().unwrap();
        let program = Program::start_with(folder.path(), &[]);
        program.make(&plain_asset("pump"));
        let whole = recording(0, 300);
        let length = whole.len().to_string();
        let headers = [TUS, ("upload-length", length.as_str()), ("upload-metadata", "asset cHVtcA==")];
        let path = program.send("POST", "/v1/uploads", &headers, b"").headers()["location"]
            .to_str()
            .unwrap()
            .to_owned();
        let headers = [TUS, OFFSET_TYPE, ("upload-offset", "0")];
        assert_eq!(program.send("PATCH", &path, &headers, &whole).status(), 204);
        program.kill();
        let program = Program::start_with(folder.path(), &[]);
        let began = Instant::now();
        let done = loop {
            let upload = program.get(&path);
            if upload["state"] == "finished" {
                break upload;
            }
            assert!(began.elapsed() < Duration::from_secs(100), "still {upload}");
            std::thread::sleep(Duration::from_millis(10));
        };
        assert_eq!(done["error"], Value::Null, "{done}");
        assert_eq!(program.get("/v1/assets/pump")["summary"]["segments"], 300);
        program.kill();
    }

    #[test]
    fn an_abandoned_upload_expires_without_another_request() {
        let service = Service::start();
        service.plain_asset("pump");
        let path = begin(&service, 10);
        patch(&service, &path, 0, b"12345").expect(204);
        assert!(pieces(&service, &path).is_dir());
        service.clock.advance(25 * 3600);
        let began = Instant::now();
        while pieces(&service, &path).exists() {
            assert!(began.elapsed() < Duration::from_secs(60));
            std::thread::sleep(Duration::from_millis(100));
        }
        service.get(&path).expect_problem(404, &[]);
    }
}
