//! Authentication, authorisation and rate limits.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::time::Duration;

use flankwatch::http::{ServiceConfig, StartError, TlsFiles, start};
use flankwatch::service::SystemClock;
use flankwatch::store::Scope;

use crate::certificate::{certificate, self_signed};
use crate::command::flankwatch;
use crate::running::{Answer, Service, mcap, plain_asset, record};
use crate::tokens::Tokens;

fn with_token(service: &Service, token: &str, method: &str, path: &str, body: &str) -> Answer {
    let authorization = format!("Bearer {token}");
    let headers = [("authorization", authorization.as_str()), ("content-type", "application/json")];
    service.send(method, path, &headers, body.as_bytes())
}

#[test]
fn a_token_grants_its_scope_until_it_is_revoked() {
    let service = Service::start();
    service.plain_asset("pump");
    let tokens = Tokens::of(service.folder());
    let make = |scope| tokens.create("test", scope);
    let (read, write, admin) = (make(Scope::Read), make(Scope::Write), make(Scope::Admin));
    let refused = service.get("/v1/assets");
    assert_eq!(refused.header("www-authenticate"), "Bearer");
    refused.expect_problem(401, &["token"]);
    with_token(&service, "fwt_00000000_0", "GET", "/v1/assets", "").expect_problem(401, &["revoked"]);
    for path in ["/", "/static/app.js", "/docs", "/openapi.json", "/healthz", "/readyz"] {
        service.get(path).expect(200);
    }
    service.get("/metrics").expect_problem(401, &[]);
    service.get("/v1/nothing").expect_problem(401, &[]);
    with_token(&service, &read, "GET", "/metrics", "").expect(200);
    let other = plain_asset("other").to_string();
    let block =
        flankwatch::recording::encode_block(&record("1", 1), flankwatch::recording::BlockEncoding::Json);
    let block = String::from_utf8(block).unwrap();
    let segments = "/v1/assets/pump/segments";
    with_token(&service, &read, "POST", segments, &block).expect_problem(403, &["read", "write"]);
    with_token(&service, &write, "POST", segments, &block).expect(201);
    with_token(&service, &write, "POST", "/v1/assets", &other).expect_problem(403, &["admin"]);
    with_token(&service, &write, "DELETE", "/v1/assets/pump", "").expect_problem(403, &["admin"]);
    with_token(&service, &admin, "POST", "/v1/assets", &other).expect(201);
    for token in tokens.list().unwrap().iter() {
        tokens.revoke(&token.id).unwrap();
    }
    with_token(&service, &admin, "GET", "/v1/assets", "").expect_problem(401, &[]);
    std::fs::remove_file(service.folder().join("tokens.db")).unwrap();
    service.get("/v1/assets").expect_problem(401, &[]);
}

#[test]
fn a_browser_logs_in_with_a_token_and_logs_out() {
    let service = Service::start();
    service.plain_asset("pump");
    assert_eq!(service.get("/v1/session").expect(200).json()["token"], serde_json::Value::Null);
    let tokens = Tokens::of(service.folder());
    let token = tokens.create("desk", Scope::Write);
    service.get("/v1/assets/pump/report").expect_problem(401, &["token"]);
    with_token(&service, "fwt_00000000_0", "POST", "/v1/session", "").expect_problem(401, &["revoked"]);
    let begun = with_token(&service, &token, "POST", "/v1/session", "").expect(200);
    assert_eq!(begun.json()["token"]["name"], "desk");
    assert_eq!(begun.json()["token"]["scope"], "write");
    let cookie = begun.header("set-cookie").to_owned();
    assert!(cookie.ends_with("; Path=/; HttpOnly; SameSite=Strict"), "{cookie}");
    let session = cookie.split(';').next().unwrap();
    let send = |method: &str, path: &str, more: &[(&str, &str)], body: &[u8]| {
        let headers: Vec<_> =
            [("cookie", session), ("content-type", "application/json")].iter().chain(more).copied().collect();
        service.send(method, path, &headers, body)
    };
    send("GET", "/v1/assets/pump/report", &[], b"").expect(200);
    assert_eq!(send("GET", "/v1/session", &[], b"").expect(200).json()["token"]["name"], "desk");

    let block =
        flankwatch::recording::encode_block(&record("1", 1), flankwatch::recording::BlockEncoding::Json);
    let segments = "/v1/assets/pump/segments";
    let others: [&[(&str, &str)]; 3] =
        [&[], &[("sec-fetch-site", "cross-site")], &[("sec-fetch-site", "same-site")]];
    for other in others {
        send("POST", segments, other, &block).expect_problem(403, &["cookie", "page of this service"]);
    }
    let own = [("sec-fetch-site", "same-origin")];
    send("POST", segments, &own, &block).expect(201);
    send("DELETE", "/v1/assets/pump", &own, b"").expect_problem(403, &["write", "admin"]);

    let ended = send("DELETE", "/v1/session", &own, b"").expect(204);
    assert!(ended.header("set-cookie").contains("Max-Age=0"));
    tokens.revoke(&tokens.list().unwrap()[0].id).unwrap();
    send("GET", "/v1/assets", &[], b"").expect_problem(401, &["revoked"]);
}

#[test]
fn too_many_requests_with_one_token_are_answered_with_429() {
    let service = Service::start_with(|config| config.http.requests_per_s = 1.try_into().unwrap());
    let tokens = Tokens::of(service.folder());
    let token = tokens.create("a", Scope::Read);
    let other = tokens.create("b", Scope::Read);
    let answers: Vec<Answer> =
        (0..20).map(|_| with_token(&service, &token, "GET", "/v1/assets", "")).collect();
    assert_eq!(answers[0].status, 200);
    let put_off = answers.into_iter().find(|answer| answer.status == 429).unwrap();
    assert!(put_off.header("retry-after").parse::<u32>().unwrap() >= 1);
    put_off.expect_problem(429, &["too many"]);
    with_token(&service, &other, "GET", "/v1/assets", "").expect(200);
}

fn start_on(address: &str, change: impl FnOnce(&mut ServiceConfig)) -> Result<(), StartError> {
    let folder = tempfile::tempdir().unwrap();
    let mut config = ServiceConfig::new(address.parse::<SocketAddr>().unwrap(), folder.path());
    change(&mut config);
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async { start(config, Arc::new(SystemClock)).await?.stop().await })
}

#[test]
fn a_public_address_requires_tokens() {
    for address in ["0.0.0.0:0", "[::]:0"] {
        let error = start_on(address, |_| {}).unwrap_err();
        assert!(matches!(error, StartError::NoTokens(_)), "{error}");
        assert!(error.to_string().contains("create one with `flankwatch token create`"), "{error}");
    }
    start_on("127.0.0.1:0", |_| {}).unwrap();
    start_on("0.0.0.0:0", |config| config.insecure_no_tokens = true).unwrap();
    start_on("0.0.0.0:0", |config| {
        Tokens::of(&config.data_dir).create("a", Scope::Read);
    })
    .unwrap();
}

#[test]
fn an_unconfigured_host_name_is_rejected() {
    let service = Service::start_with(|config| config.host_names = vec!["wear.example".to_owned()]);
    let as_host = |host: &str, path: &str| service.send("GET", path, &[("host", host)], b"");
    as_host("evil.example:8600", "/v1/assets").expect_problem(403, &["evil.example", "--host-name"]);
    as_host("wear.example", "/v1/assets").expect(200);
    as_host("localhost", "/v1/assets").expect(200);
    // The static pages contain no data.
    as_host("evil.example:8600", "/").expect(200);
    let token = Tokens::of(service.folder()).create("a", Scope::Read);
    let authorization = format!("Bearer {token}");
    let headers = [("host", "evil.example"), ("authorization", authorization.as_str())];
    service.send("GET", "/v1/assets", &headers, b"").expect(200);
}

#[test]
fn cross_origin_requests_are_rejected() {
    let service = Service::start();
    let headers = [("origin", "http://evil.example"), ("content-type", "application/json")];
    let body = plain_asset("pump").to_string();
    service.send("POST", "/v1/assets", &headers, body.as_bytes()).expect_problem(403, &["evil.example"]);
    let answer = service.get("/v1/assets").expect(200);
    assert_eq!(answer.header("access-control-allow-origin"), "");
    assert_eq!(answer.header("x-content-type-options"), "nosniff");
    assert!(answer.header("content-security-policy").starts_with("default-src 'self'"));
}

#[test]
fn a_client_without_a_request_is_disconnected_and_others_are_served() {
    let service = Service::start_with(|config| {
        config.http.header_timeout = Duration::from_millis(300);
        config.http.connections = 2;
    });
    let address = service.url("").trim_start_matches("http://").to_string();
    let mut slow: Vec<TcpStream> = (0..2).map(|_| TcpStream::connect(&address).unwrap()).collect();
    for stream in &mut slow {
        stream.write_all(b"GET / HTTP/1.1\r\nhost:").unwrap();
    }
    // Both slots are taken until the slow clients are disconnected.
    service.get("/healthz").expect(200);
    for stream in &mut slow {
        let mut answer = String::new();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        stream.read_to_string(&mut answer).unwrap();
        assert!(!answer.contains(" 200 "), "{answer}");
    }
}

#[test]
fn invalid_certificates_are_rejected_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let (certificate, key) = (folder.path().join("c.pem"), folder.path().join("k.pem"));
    std::fs::write(&certificate, "no certificate").unwrap();
    std::fs::write(&key, "no key").unwrap();
    let error =
        start_on("127.0.0.1:0", |config| config.tls = Some(TlsFiles { certificate, key })).unwrap_err();
    assert!(error.to_string().contains("c.pem") || error.to_string().contains("k.pem"), "{error}");
}

#[test]
#[ignore = "needs openssl"]
fn openssl_speaks_tls_with_the_service() {
    let folder = tempfile::tempdir().unwrap();
    let files = certificate(folder.path());
    let authority = files.certificate.clone();
    let mut config = ServiceConfig::new("127.0.0.1:0".parse().unwrap(), folder.path().join("data"));
    config.tls = Some(files);
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let service = runtime.block_on(start(config, Arc::new(SystemClock))).unwrap();
    assert!(service.url().starts_with("https://"));
    let mut client = std::process::Command::new("openssl")
        .args(["s_client", "-quiet", "-verify_return_error", "-CAfile"])
        .arg(&authority)
        .args(["-connect", &service.address().to_string()])
        .stdin(std::process::Stdio::piped())
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let mut input = client.stdin.take().unwrap();
    input.write_all(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n").unwrap();
    let mut output = String::new();
    client.stdout.take().unwrap().read_to_string(&mut output).unwrap();
    client.wait().unwrap();
    assert!(output.starts_with("HTTP/1.1 200 ") && output.contains("\"status\":\"ok\""), "{output}");
    runtime.block_on(service.stop()).unwrap();
}

#[test]
#[ignore = "needs openssl"]
fn a_replay_is_sent_over_tls_to_a_trusted_server_only() {
    let folder = tempfile::tempdir().unwrap();
    let files = certificate(folder.path());
    let authority = files.certificate.display().to_string();
    let mut config = ServiceConfig::new("127.0.0.1:0".parse().unwrap(), folder.path().join("data"));
    config.tls = Some(files);
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let service = runtime.block_on(start(config, Arc::new(SystemClock))).unwrap();
    let asset = serde_json::from_value(plain_asset("pump")).unwrap();
    runtime.block_on(service.service().assets.create(&asset)).unwrap();
    let recording = folder.path().join("run.mcap");
    std::fs::write(&recording, mcap(&[record("1", 1), record("1", 2)])).unwrap();
    let (recording, url) = (recording.display().to_string(), service.url());
    let words = ["replay", recording.as_str(), "--asset", "pump", "--url", url.as_str(), "--ca"];
    let with_ca = |file: &str| flankwatch(&[&words[..], &[file]].concat());
    let output = with_ca(&authority).expect_success();
    assert!(output.out().contains("2 records sent to https://"), "{}", output.out());
    let stored = runtime.block_on(service.service().store.segment_count()).unwrap();
    assert_eq!(stored, 2);
    with_ca(&recording).expect_failure(&["--ca", "run.mcap", "PEM"]);
    with_ca("nowhere.pem").expect_failure(&["nowhere.pem"]);
    // None of these is tried again.
    let began = std::time::Instant::now();
    let public = ["replay", &recording, "--asset", "pump", "--url"];
    flankwatch(&[&public[..], &[&url]].concat())
        .expect_failure(&[&url, "the server's certificate is of an unknown authority, expected one"]);
    let plain = Service::start();
    let to_plain = plain.url("").replace("http://", "https://");
    flankwatch(&[&public[..], &[&to_plain]].concat())
        .expect_failure(&[&to_plain, "the server does not use TLS, expected a URL with http://"]);
    let to_tls = url.replace("https://", "http://");
    flankwatch(&[&public[..], &[&to_tls]].concat())
        .expect_failure(&[&to_tls, "a server with TLS needs a URL with https://"]);
    let stream = ["stream", &recording, "--sample", "f32", "--rate", "1000", "--asset", "pump"];
    let start = ["--start-time", "2026-01-01T00:00:00Z", "--url", &url];
    flankwatch(&[&stream[..], &start].concat())
        .expect_failure(&[&url, "the server's certificate is of an unknown authority"]);
    assert!(began.elapsed() < Duration::from_secs(20), "{:?}", began.elapsed());
    runtime.block_on(service.stop()).unwrap();
}

#[test]
#[ignore = "needs openssl"]
fn a_certificate_of_an_authority_is_none_of_a_server() {
    let folder = tempfile::tempdir().unwrap();
    let files = self_signed(folder.path(), "CA:TRUE");
    let authority = files.certificate.display().to_string();
    let mut config = ServiceConfig::new("127.0.0.1:0".parse().unwrap(), folder.path().join("data"));
    config.tls = Some(files);
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let service = runtime.block_on(start(config, Arc::new(SystemClock))).unwrap();
    let recording = folder.path().join("run.mcap");
    std::fs::write(&recording, mcap(&[record("1", 1)])).unwrap();
    let (recording, url) = (recording.display().to_string(), service.url());
    flankwatch(&["replay", &recording, "--asset", "pump", "--url", &url, "--ca", &authority]).expect_failure(
        &[&url, "certificate is that of an authority", "-addext basicConstraints=critical,CA:FALSE"],
    );
    runtime.block_on(service.stop()).unwrap();
}

#[test]
fn a_request_head_that_is_too_large_is_rejected() {
    let service = Service::start_with(|config| config.http.header_bytes = 16 << 10);
    let address = service.url("").trim_start_matches("http://").to_string();
    let many: String = (0..200).map(|n| format!("x-{n}: 1\r\n")).collect();
    // Slightly too large: it fits into the last chunk read.
    let long = format!("x: {}\r\n", "a".repeat(20 << 10));
    for (fields, status) in [
        (many.as_str(), "431 Request Header Fields Too Large"),
        (long.as_str(), "431 Request Header Fields Too Large"),
        ("no field\r\n", "400 Bad Request"),
        ("host: evil.example\r\n", "400 Bad Request"),
        ("host: localhost\r\n", "400 Bad Request"),
    ] {
        let mut stream = TcpStream::connect(&address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let head = format!("GET /v1/assets HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n{fields}\r\n");
        stream.write_all(head.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with(&format!("HTTP/1.1 {status}\r\n")), "{answer}");
    }
    let mut stream = TcpStream::connect(&address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    stream.write_all(b"GET /v1/assets HTTP/1.1\r\nconnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 400 ") && answer.contains("0 host fields"), "{answer}");
    service.get("/v1/assets").expect(200);
}
