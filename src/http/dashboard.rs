//! The dashboard's files, built into the program.

use std::sync::LazyLock;

use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use axum::response::{IntoResponse, Response};

use super::plotly::{PLOTLY_JS_GZIP, plotly_js};
use super::problem::Problem;
use super::request::etag::{self, is_known, not_modified};

/// A static file.
struct StaticFile {
    name: &'static str,
    bytes: &'static [u8],
}

/// All files of `dashboard/`; `index.html` is the page at `/`, the others are under `/static/`.
const FILES: &[StaticFile] = include!(concat!(env!("OUT_DIR"), "/dashboard_files.rs"));

const PLOTLY_NAME: &str = "plotly.js";

static PLOTLY_ETAG: LazyLock<HeaderValue> = LazyLock::new(|| etag::of_bytes(&[PLOTLY_JS_GZIP]));

pub(super) async fn index(headers: HeaderMap) -> Response {
    match FILES.iter().find(|file| file.name == "index.html") {
        Some(file) => send(&headers, file),
        None => Problem::not_found("this build has no dashboard").into_response(),
    }
}

pub(super) async fn file(path: Result<Path<String>, PathRejection>, headers: HeaderMap) -> Response {
    let Ok(Path(name)) = path else {
        return Problem::not_found("file not found").into_response();
    };
    if name == PLOTLY_NAME {
        return send_plotly(&headers).await;
    }
    match FILES.iter().find(|file| file.name == name && name != "index.html") {
        Some(file) => send(&headers, file),
        None => Problem::not_found(format!("file {name:?} not found")).into_response(),
    }
}

fn send(headers: &HeaderMap, file: &'static StaticFile) -> Response {
    // Revalidated each time: a new version of the program may change a file under the same name.
    match fields(headers, file.name, etag::of_bytes(&[file.bytes]), "no-cache") {
        Ok(fields) => (fields, file.bytes).into_response(),
        Err(not_modified) => *not_modified,
    }
}

async fn send_plotly(headers: &HeaderMap) -> Response {
    let fields = match fields(headers, PLOTLY_NAME, PLOTLY_ETAG.clone(), "public, max-age=86400") {
        Ok(fields) => fields,
        Err(not_modified) => return *not_modified,
    };
    let vary = [(header::VARY, "accept-encoding")];
    let takes_gzip = headers
        .get(header::ACCEPT_ENCODING)
        .and_then(|value| value.to_str().ok())
        .is_some_and(|value| value.split(',').any(|coding| coding.trim().split(';').next() == Some("gzip")));
    if takes_gzip {
        return (fields, vary, [(header::CONTENT_ENCODING, "gzip")], PLOTLY_JS_GZIP).into_response();
    }
    match tokio::task::spawn_blocking(plotly_js).await {
        Ok(script) => (fields, vary, script).into_response(),
        Err(_) => Problem::not_found("the script is unavailable").into_response(),
    }
}

/// Returns the header fields of a file, or the response for a client that has it.
fn fields(
    headers: &HeaderMap,
    name: &str,
    etag: HeaderValue,
    caching: &'static str,
) -> Result<[(HeaderName, HeaderValue); 3], Box<Response>> {
    let caching = (header::CACHE_CONTROL, HeaderValue::from_static(caching));
    if is_known(headers, &etag) {
        return Err(Box::new(([caching], not_modified(etag)).into_response()));
    }
    let content_type = HeaderValue::from_static(content_type(name));
    Ok([(header::CONTENT_TYPE, content_type), (header::ETAG, etag), caching])
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
