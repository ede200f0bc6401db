//! The dashboard's files, built into the program.

use std::io::{Read, Write};
use std::sync::LazyLock;

use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use sha2::{Digest, Sha256};

use super::plotly::plotly_js;
use super::problem::Problem;

/// A file as it is sent.
struct StaticFile {
    name: &'static str,
    bytes: &'static [u8],
}

macro_rules! files {
    ($($name:literal),* $(,)?) => {
        &[$(StaticFile { name: $name, bytes: include_bytes!(concat!("dashboard/", $name)) }),*]
    };
}

/// Every file of `dashboard/`; `index.html` is the page at `/`, the others are under `/static/`.
const FILES: &[StaticFile] = files![
    "api.js",
    "app.css",
    "app.js",
    "asset-header.js",
    "asset.css",
    "asset.js",
    "dom.js",
    "first-steps.js",
    "fleet-row.js",
    "fleet.css",
    "fleet.js",
    "format.js",
    "gauge.js",
    "icon.svg",
    "index.html",
    "live.js",
    "plot-card.js",
    "plots.js",
    "posterior-plot.js",
    "record-view.js",
    "records-dialog.js",
    "records.css",
    "replay-panel.js",
    "route.js",
    "spectrum-plot.js",
    "state.js",
    "symbols.js",
    "theme.js",
    "trend-plot.js",
    "upload-panel.js",
    "wear-plot.js",
];

/// Plotly.js from the `plotly` crate, compressed once, at most when it is first asked for.
static PLOTLY: LazyLock<Compressed> = LazyLock::new(|| Compressed::new(plotly_js().as_bytes()));

const PLOTLY_NAME: &str = "plotly.js";

struct Compressed {
    gzip: Vec<u8>,
    etag: HeaderValue,
}

impl Compressed {
    fn new(bytes: &[u8]) -> Self {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
        // Writing to a vector cannot fail; were it to, the file would be empty and the browser would say so.
        let gzip = encoder.write_all(bytes).and_then(|()| encoder.finish()).unwrap_or_default();
        Self {
            gzip,
            etag: etag_of(bytes),
        }
    }

    fn decompressed(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut decoder = GzDecoder::new(&self.gzip[..]);
        if let Err(error) = decoder.read_to_end(&mut bytes) {
            tracing::error!(%error, "embedded script cannot be decompressed");
        }
        bytes
    }
}

pub(super) async fn index(headers: HeaderMap) -> Response {
    match FILES.iter().find(|file| file.name == "index.html") {
        Some(file) => send(&headers, file),
        None => Problem::not_found("there is no dashboard in this build").into_response(),
    }
}

pub(super) async fn file(path: Result<Path<String>, PathRejection>, headers: HeaderMap) -> Response {
    let Ok(Path(name)) = path else {
        return Problem::not_found("there is no such file").into_response();
    };
    if name == PLOTLY_NAME {
        return send_plotly(&headers).await;
    }
    match FILES.iter().find(|file| file.name == name && name != "index.html") {
        Some(file) => send(&headers, file),
        None => Problem::not_found(format!("there is no file {name:?}")).into_response(),
    }
}

fn send(headers: &HeaderMap, file: &'static StaticFile) -> Response {
    let etag = etag_of(file.bytes);
    // Revalidated each time: a new version of the program may bring a new file under the same name.
    let caching = HeaderValue::from_static("no-cache");
    if is_known(headers, &etag) {
        return (StatusCode::NOT_MODIFIED, [(header::ETAG, etag), (header::CACHE_CONTROL, caching)]).into_response();
    }
    let fields = [
        (header::CONTENT_TYPE, HeaderValue::from_static(content_type(file.name))),
        (header::ETAG, etag),
        (header::CACHE_CONTROL, caching),
    ];
    (fields, file.bytes).into_response()
}

async fn send_plotly(headers: &HeaderMap) -> Response {
    let Ok(script) = tokio::task::spawn_blocking(|| &*PLOTLY).await else {
        return Problem::not_found("the script cannot be had").into_response();
    };
    let caching = HeaderValue::from_static("public, max-age=86400");
    if is_known(headers, &script.etag) {
        let fields = [(header::ETAG, script.etag.clone()), (header::CACHE_CONTROL, caching)];
        return (StatusCode::NOT_MODIFIED, fields).into_response();
    }
    let fields = [
        (header::CONTENT_TYPE, HeaderValue::from_static(content_type(PLOTLY_NAME))),
        (header::ETAG, script.etag.clone()),
        (header::CACHE_CONTROL, caching),
        (header::VARY, HeaderValue::from_static("accept-encoding")),
    ];
    let takes_gzip = headers
        .get(header::ACCEPT_ENCODING)
        .and_then(|value| value.to_str().ok())
        .is_some_and(|value| value.split(',').any(|coding| coding.trim().split(';').next() == Some("gzip")));
    if takes_gzip {
        (fields, [(header::CONTENT_ENCODING, "gzip")], script.gzip.as_slice()).into_response()
    } else {
        match tokio::task::spawn_blocking(|| PLOTLY.decompressed()).await {
            Ok(bytes) => (fields, bytes).into_response(),
            Err(_) => Problem::not_found("the script cannot be had").into_response(),
        }
    }
}

fn is_known(headers: &HeaderMap, etag: &HeaderValue) -> bool {
    let (Some(known), Ok(etag)) = (headers.get(header::IF_NONE_MATCH), etag.to_str()) else {
        return false;
    };
    let known = known.to_str().unwrap_or_default();
    known.split(',').any(|one| one.trim().trim_start_matches("W/") == etag)
}

fn etag_of(bytes: &[u8]) -> HeaderValue {
    let digest = Sha256::digest(bytes);
    let text: String = digest.iter().take(12).map(|byte| format!("{byte:02x}")).collect();
    HeaderValue::from_str(&format!("\"{text}\"")).unwrap_or_else(|_| HeaderValue::from_static("\"0\""))
}

fn content_type(name: &str) -> &'static str {
    match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("svg") => "image/svg+xml",
        Some("png") => "image/png",
        Some("json") => "application/json",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_compressed_comes_out_again() {
        assert_eq!(Compressed::new(b"function f() {}").decompressed(), b"function f() {}");
    }

    #[test]
    fn a_known_file_is_recognised() {
        let etag = etag_of(b"abc");
        let mut headers = HeaderMap::new();
        assert!(!is_known(&headers, &etag));
        headers.insert(
            header::IF_NONE_MATCH,
            HeaderValue::from_static("\"x\", W/\"ba7816bf8f01cfea414140de\""),
        );
        assert!(is_known(&headers, &etag));
    }
}
