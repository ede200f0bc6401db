//! The dashboard's files and the headers of every response.

use crate::running::Service;

#[test]
fn the_page_has_its_headers_and_an_etag() {
    let service = Service::start();
    let page = service.get("/").expect(200);
    assert_eq!(page.header("content-type"), "text/html; charset=utf-8");
    assert!(page.header("content-security-policy").starts_with("default-src 'self'"));
    assert_eq!(page.header("x-content-type-options"), "nosniff");
    let etag = page.header("etag").to_string();
    assert!(etag.len() > 10);
    let again = service.send("GET", "/", &[("if-none-match", &etag)], b"").expect(304);
    assert!(again.bytes.is_empty());
    service.get("/static/none.js").expect_problem(404, &["none.js"]);
    service.get("/static/..%2F..%2FCargo.toml").expect_problem(404, &[]);
}

#[test]
fn plotly_is_sent_compressed_if_accepted() {
    let service = Service::start();
    let plain = service.send("GET", "/static/plotly.js", &[("accept-encoding", "identity")], b"").expect(200);
    assert_eq!(plain.header("content-type"), "text/javascript; charset=utf-8");
    assert!(String::from_utf8_lossy(&plain.bytes[..200]).contains("plotly.js (cartesian"));
    let packed =
        service.send("GET", "/static/plotly.js", &[("accept-encoding", "br, gzip;q=0.8")], b"").expect(200);
    assert_eq!(packed.header("content-encoding"), "gzip");
    assert!(packed.bytes.len() * 2 < plain.bytes.len());
    assert_eq!(packed.header("etag"), plain.header("etag"));
    let etag = packed.header("etag").to_string();
    service.send("GET", "/static/plotly.js", &[("if-none-match", &etag)], b"").expect(304);
}

#[test]
fn liveness_and_readiness_are_ok() {
    let service = Service::start();
    assert_eq!(service.get("/healthz").expect(200).json()["status"], "ok");
    let ready = service.get("/readyz").expect(200).json();
    assert_eq!((ready["status"].as_str(), ready["database"].as_str()), (Some("ok"), Some("ok")));
}
