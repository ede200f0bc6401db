//! Resumable uploads after tus 1.0 (<https://tus.io/protocols/resumable-upload>): core, creation,
//! termination, expiration.
//!
//! This module implements the protocol; storing and processing of uploads is in `resumable`.

use axum::Json;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use base64::Engine;
use base64::engine::general_purpose::STANDARD_NO_PAD;

use super::resumable;
use super::resumable_upload::ResumableUpload;
use crate::asset::AssetId;
use crate::http::access::client::Client;
use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::request::body;
use crate::http::request::query::NamePath;
use crate::service::ServiceError;

const VERSION: &str = "1.0.0";
const OFFSET_TYPE: &str = "application/offset+octet-stream";
const RESUMABLE: HeaderName = HeaderName::from_static("tus-resumable");
const SUPPORTED: HeaderName = HeaderName::from_static("tus-version");
const LENGTH: HeaderName = HeaderName::from_static("upload-length");
const OFFSET: HeaderName = HeaderName::from_static("upload-offset");
const METADATA: HeaderName = HeaderName::from_static("upload-metadata");
const EXPIRES: HeaderName = HeaderName::from_static("upload-expires");

fn number(headers: &HeaderMap, name: &HeaderName) -> Result<u64, Problem> {
    let given = headers.get(name);
    given
        .and_then(|value| value.to_str().ok()?.parse().ok())
        .ok_or_else(|| Problem::query(name.as_str(), text_of(given), "a number of bytes"))
}

/// The value of a header field, or `missing`.
fn text_of(value: Option<&HeaderValue>) -> String {
    value.map_or_else(|| "missing".to_owned(), |value| format!("{value:?}"))
}

fn check_version(headers: &HeaderMap) -> Result<(), Problem> {
    match headers.get(RESUMABLE) {
        Some(version) if version == VERSION => Ok(()),
        version => {
            let detail = format!("tus-resumable is {}, expected {VERSION}", text_of(version));
            Err(Problem::new(StatusCode::PRECONDITION_FAILED, detail))
        }
    }
}

/// The value of a key in `Upload-Metadata`.
fn metadata(headers: &HeaderMap, key: &str) -> Option<String> {
    let text = headers.get(METADATA)?.to_str().ok()?;
    let value = text.split(',').find_map(|pair| {
        let (name, value) = pair.trim().split_once(' ')?;
        (name == key).then_some(value.trim())
    })?;
    String::from_utf8(from_base64(value)?).ok()
}

fn from_base64(text: &str) -> Option<Vec<u8>> {
    STANDARD_NO_PAD.decode(text.trim_end_matches('=')).ok()
}

fn respond(status: StatusCode, upload: &ResumableUpload, more: &[(HeaderName, String)]) -> Response {
    let mut response = status.into_response();
    // Date format of RFC 9110, as the protocol requires
    let expires = upload.expires_at.strftime("%a, %d %b %Y %H:%M:%S GMT").to_string();
    let fields = [(OFFSET, upload.offset.to_string()), (EXPIRES, expires)];
    for (name, value) in fields.iter().chain(more) {
        if let Ok(value) = HeaderValue::from_str(value) {
            response.headers_mut().insert(name, value);
        }
    }
    response
}

/// Start a resumable upload (tus 1.0)
///
/// `Upload-Metadata` contains the `asset` in base64. The recording is MCAP. `OPTIONS` lists the supported tus
/// features.
#[utoipa::path(
    post,
    path = "/v1/uploads",
    tag = "resumable uploads",
    params(
        ("tus-resumable" = String, Header, description = "`1.0.0`"),
        ("upload-length" = u64, Header, description = "Length of the recording in bytes"),
        ("upload-metadata" = String, Header, description = "`asset` and its name in base64"),
    ),
    responses(
        (status = 201, description = "Created", headers(("location" = String, description = "Its address"))),
        (status = 404, description = "Asset not found"),
        (status = 409, description = "The asset uses the sensor of another one"),
        (status = 412, description = "Unsupported tus version"),
        (status = 413, description = "Too long"),
        (status = 507, description = "Insufficient storage"),
    ),
)]
pub(crate) async fn create(
    State(app): State<App>,
    client: Client,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    check_version(&headers)?;
    let length = number(&headers, &LENGTH)?;
    let max_bytes = app.limits.recording_bytes;
    if length > max_bytes {
        return Err(Problem::too_large(max_bytes));
    }
    let name = metadata(&headers, "asset");
    let asset = name.clone().and_then(|name| AssetId::new(name).ok());
    let asset = asset.ok_or_else(|| {
        Problem::query(
            "upload-metadata",
            name.map_or_else(|| "missing".to_owned(), |name| format!("{name:?}")),
            "asset and its name in base64",
        )
    })?;
    let described = app.service.store.asset(&asset).await?;
    if let Some(of) = described.spec.sensor.of {
        return Err(ServiceError::SensorOfOther { asset, of }.into());
    }
    let upload = resumable::begin(&app, &client, asset, length).await?;
    let location = format!("/v1/uploads/{}", upload.id);
    Ok(respond(StatusCode::CREATED, &upload, &[(header::LOCATION, location)]))
}

/// Supported tus features
#[utoipa::path(options, path = "/v1/uploads", tag = "resumable uploads", responses((status = 204, description = "See the header fields")))]
pub(crate) async fn options(State(app): State<App>) -> Response {
    let fields = [
        (HeaderName::from_static("tus-extension"), "creation,termination,expiration".to_string()),
        (HeaderName::from_static("tus-max-size"), app.limits.recording_bytes.to_string()),
    ];
    (StatusCode::NO_CONTENT, fields).into_response()
}

/// Get the offset of a resumable upload
#[utoipa::path(
    head,
    path = "/v1/uploads/{upload}",
    tag = "resumable uploads",
    responses((status = 200, description = "`upload-offset` is the number of bytes received")),
)]
pub(crate) async fn offset(State(app): State<App>, NamePath(id): NamePath) -> Result<Response, Problem> {
    let upload = resumable::find(&app, &id).await?;
    let more = [(LENGTH, upload.length.to_string()), (header::CACHE_CONTROL, "no-store".to_string())];
    Ok(respond(StatusCode::OK, &upload, &more))
}

/// Get the result of a resumable upload
#[utoipa::path(
    get,
    path = "/v1/uploads/{upload}",
    tag = "resumable uploads",
    responses((status = 200, body = ResumableUpload)),
)]
pub(crate) async fn show(
    State(app): State<App>,
    NamePath(id): NamePath,
) -> Result<Json<ResumableUpload>, Problem> {
    Ok(Json(resumable::find(&app, &id).await?))
}

/// Continue a resumable upload
///
/// Bytes that arrive before the connection is lost are kept; `HEAD` returns their number.
#[utoipa::path(
    patch,
    path = "/v1/uploads/{upload}",
    tag = "resumable uploads",
    params(
        ("tus-resumable" = String, Header, description = "`1.0.0`"),
        ("upload-offset" = u64, Header, description = "Bytes received already"),
    ),
    request_body(content = Vec<u8>, content_type = "application/offset+octet-stream"),
    responses(
        (status = 204, description = "Stored; `upload-offset` is the number of bytes received"),
        (status = 409, description = "Wrong offset, or the upload is complete"),
        (status = 412, description = "Unsupported tus version"),
    ),
)]
pub(crate) async fn append(
    State(app): State<App>,
    NamePath(id): NamePath,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    check_version(&headers)?;
    let media_type = body::media_type(&headers);
    if media_type.as_deref() != Some(OFFSET_TYPE) {
        return Err(body::unsupported(media_type.as_deref(), OFFSET_TYPE));
    }
    let at = number(&headers, &OFFSET)?;
    let upload = resumable::append(&app, &id, at, body).await?;
    Ok(respond(StatusCode::NO_CONTENT, &upload, &[]))
}

/// Cancel a resumable upload
#[utoipa::path(
    delete,
    path = "/v1/uploads/{upload}",
    tag = "resumable uploads",
    responses(
        (status = 204, description = "Deleted"),
        (status = 409, description = "The upload is being written or processed"),
    ),
)]
pub(crate) async fn cancel(State(app): State<App>, NamePath(id): NamePath) -> Result<StatusCode, Problem> {
    resumable::cancel(&app, &id).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Adds the protocol's version to every response of these routes, also to errors.
pub(crate) async fn layer(request: Request, next: Next) -> Response {
    let is_tus = request.uri().path().split('/').nth(2) == Some("uploads");
    let is_options = request.method() == Method::OPTIONS;
    let mut response = next.run(request).await;
    if is_tus {
        let lists_versions = is_options || response.status() == StatusCode::PRECONDITION_FAILED;
        response.headers_mut().insert(RESUMABLE, HeaderValue::from_static(VERSION));
        if lists_versions {
            response.headers_mut().insert(SUPPORTED, HeaderValue::from_static(VERSION));
        }
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_is_read_from_base64() {
        let mut headers = HeaderMap::new();
        headers.insert(METADATA, HeaderValue::from_static("filename cnVuLm1jYXA=,asset cHVtcA=="));
        assert_eq!(metadata(&headers, "asset").as_deref(), Some("pump"));
        assert_eq!(metadata(&headers, "filename").as_deref(), Some("run.mcap"));
        assert!(metadata(&headers, "none").is_none());
        for (text, bytes) in [("", &b""[..]), ("AA==", b"\0"), ("/+8=", b"\xff\xef"), ("QUJD", b"ABC")] {
            assert_eq!(from_base64(text).as_deref(), Some(bytes), "{text}");
        }
        assert!(from_base64("a b").is_none());
    }
}
