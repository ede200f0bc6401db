//! Limits per client: connections, event streams, resumable uploads.

use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use flankwatch::store::Scope;

use crate::running::{Answer, Service, record};
use crate::tokens::Tokens;

fn connect(service: &Service) -> TcpStream {
    let stream = TcpStream::connect(service.url("").trim_start_matches("http://")).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    stream
}

/// Requests live events; returns the status and the rest of the response.
fn follow(service: &Service, token: Option<&str>) -> (u16, BufReader<TcpStream>) {
    let mut stream = connect(service);
    let token = token.map_or_else(String::new, |token| format!("authorization: Bearer {token}\r\n"));
    // A rejected connection may be closed before the request is sent.
    let _ = write!(stream, "GET /v1/events HTTP/1.1\r\nhost: localhost\r\n{token}\r\n");
    let (mut reader, mut line) = (BufReader::new(stream), String::new());
    reader.read_line(&mut line).unwrap();
    (line.split(' ').nth(1).unwrap().parse().unwrap(), reader)
}

#[test]
fn event_streams_of_one_client_leave_room_for_health_and_uploads() {
    let service = Service::start_with(|config| config.http.connections = 64);
    service.plain_asset("pump");
    let streams: Vec<_> = (0..80).map(|_| follow(&service, None)).collect();
    let count = |status| streams.iter().filter(|(found, _)| *found == status).count();
    assert_eq!((count(200), count(503)), (16, 64));
    service.get("/healthz").expect(200);
    service.upload("pump", &record("1", 1));
    // Open streams continue.
    drop(streams);
}

#[test]
fn health_is_answered_while_one_client_has_all_its_connections() {
    let service = Service::start_with(|config| config.http.connections = 8);
    let idle: Vec<TcpStream> = (0..20).map(|_| connect(&service)).collect();
    service.get("/healthz").expect(200);
    service.get("/readyz").expect(200);
    let refused = service.get("/v1/assets");
    assert_eq!((refused.header("connection"), refused.header("retry-after")), ("close", "1"));
    refused.expect_problem(503, &["connections"]);
    drop(idle);
    let began = std::time::Instant::now();
    while service.get("/v1/assets").status != 200 {
        assert!(began.elapsed() < Duration::from_secs(20), "its places are still taken");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn idle_connections_of_one_address_do_not_delay_another() {
    let service = Service::start_with(|config| config.http.connections = 8);
    let _idle: Vec<TcpStream> = (0..60).map(|_| connect(&service)).collect();
    let address = service.url("").trim_start_matches("http://").parse().unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let other = runtime.block_on(async {
        let socket = tokio::net::TcpSocket::new_v4().unwrap();
        socket.bind("127.0.0.2:0".parse().unwrap()).unwrap();
        socket.connect(address).await.unwrap().into_std().unwrap()
    });
    other.set_nonblocking(false).unwrap();
    other.set_read_timeout(Some(Duration::from_millis(900))).unwrap();
    write!(&other, "GET /v1/assets HTTP/1.1\r\nhost: localhost\r\n\r\n").unwrap();
    let mut line = String::new();
    BufReader::new(other).read_line(&mut line).unwrap();
    assert_eq!(line.split(' ').nth(1), Some("200"));
}

#[test]
fn a_revoked_tokens_streams_end() {
    let service = Service::start();
    let tokens = Tokens::of(service.folder());
    let (one, other) = (token(&service, "one"), token(&service, "other"));
    let (status, mut ended) = follow(&service, Some(&one));
    assert_eq!(status, 200);
    let (status, goes_on) = follow(&service, Some(&other));
    assert_eq!(status, 200);
    let id = one.split('_').nth(1).unwrap();
    tokens.revoke(id).unwrap();
    ended.get_ref().set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let mut rest = String::new();
    // The last chunk ends the stream; the connection may stay for another request.
    while !rest.ends_with("0\r\n\r\n") {
        let mut piece = [0; 1024];
        let count = ended.read(&mut piece).unwrap();
        if count == 0 {
            break;
        }
        rest.push_str(&String::from_utf8_lossy(&piece[..count]));
    }
    goes_on.get_ref().set_read_timeout(Some(Duration::from_millis(300))).unwrap();
    let mut head = String::new();
    let mut goes_on = goes_on;
    while head != "\r\n" {
        head.clear();
        goes_on.read_line(&mut head).unwrap();
    }
    assert!(goes_on.read(&mut [0; 16]).is_err(), "nothing comes, and it has not ended");
}

fn token(service: &Service, name: &str) -> String {
    let tokens = Tokens::of(service.folder());
    tokens.create(name, Scope::Write)
}

#[test]
fn uploads_of_one_client_leave_room_for_others() {
    let service = Service::start_with(|config| config.http.uploads_at_once = 8);
    service.plain_asset("pump");
    let (one, other) = (token(&service, "one"), token(&service, "other"));
    let begin = |token: &str| -> Answer {
        let authorization = format!("Bearer {token}");
        let headers = [
            ("authorization", authorization.as_str()),
            ("tus-resumable", "1.0.0"),
            ("upload-length", "10"),
            // pump
            ("upload-metadata", "asset cHVtcA=="),
        ];
        service.send("POST", "/v1/uploads", &headers, b"")
    };
    for _ in 0..6 {
        begin(&one).expect(201);
    }
    begin(&one).expect_problem(503, &["of this client"]);
    for _ in 0..2 {
        begin(&other).expect(201);
    }
    begin(&other).expect_problem(503, &["too many uploads"]);
}

#[test]
fn a_deletion_whose_client_disconnects_is_complete() {
    let service = Service::start();
    let ids: Vec<String> = (0..100).map(|n| format!("pump-{n}")).collect();
    ids.iter().for_each(|id| service.plain_asset(id));
    for (n, id) in (0..).zip(&ids) {
        let mut stream = connect(&service);
        write!(stream, "DELETE /v1/assets/{id} HTTP/1.1\r\nhost: localhost\r\n\r\n").unwrap();
        std::thread::sleep(Duration::from_millis(n % 5));
    }
    let known = || {
        let page = service.get("/v1/assets?limit=1000").expect(200).json();
        let items = page["items"].as_array().unwrap().iter();
        items.map(|asset| asset["id"].as_str().unwrap().to_owned()).collect::<BTreeSet<_>>()
    };
    let began = std::time::Instant::now();
    loop {
        let before = known();
        std::thread::sleep(Duration::from_millis(500));
        if known() == before {
            break;
        }
        assert!(began.elapsed() < Duration::from_secs(60), "assets are still being deleted");
    }
    assert!(known().len() < ids.len());
    let metadata = service.service().store.objects().all_asset_metadata();
    let written: BTreeSet<String> =
        metadata.unwrap().into_iter().map(|metadata| metadata.spec.id.to_string()).collect();
    assert_eq!(written, known());
}
