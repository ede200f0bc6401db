//! `ETag` and `If-None-Match`: unchanged responses are not sent again.

use axum::body::{Body, to_bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use sha2::{Digest, Sha256};

use crate::http::problem::Problem;
use crate::service::{Precondition, description_tag};
use crate::store::{Asset, ChannelSummary};

/// The entity tag of these bytes.
pub(crate) fn of_bytes(parts: &[&[u8]]) -> HeaderValue {
    let mut hash = Sha256::new();
    for part in parts {
        hash.update((part.len() as u64).to_le_bytes());
        hash.update(part);
    }
    let text = hex::encode(&hash.finalize()[..12]);
    HeaderValue::from_str(&format!("\"{text}\"")).unwrap_or_else(|_| HeaderValue::from_static("\"0\""))
}

/// The entity tag of a response that depends on a channel's records, its asset's description and the URL.
pub(crate) fn of_channel(
    asset: &Asset,
    channel: Option<&ChannelSummary>,
    uri: &Uri,
    headers: &HeaderMap,
) -> HeaderValue {
    of_channels(asset, channel.as_slice(), uri, headers)
}

/// The entity tag of a response that depends on the records of several channels.
pub(crate) fn of_channels(
    asset: &Asset,
    channels: &[&ChannelSummary],
    uri: &Uri,
    headers: &HeaderMap,
) -> HeaderValue {
    let versions: Vec<u8> = channels
        .iter()
        .map(|channel| channel.version())
        .flat_map(|(channel_no, revision)| [channel_no, revision].into_iter().flat_map(i64::to_le_bytes))
        .collect();
    let updated_at = asset.updated_at.as_nanosecond().to_le_bytes();
    let address = uri.path_and_query().map_or("", |address| address.as_str());
    let accept = headers.get(header::ACCEPT).map_or(&b""[..], HeaderValue::as_bytes);
    let version = env!("CARGO_PKG_VERSION").as_bytes();
    of_bytes(&[version, &versions, &updated_at, address.as_bytes(), accept])
}

/// The entity tag of an asset: that of its description, followed by that of the whole response.
pub(crate) fn of_asset(asset: &Asset, body: &[u8]) -> Result<HeaderValue, Problem> {
    let description = description_tag(asset)?;
    let whole = of_bytes(&[body]);
    let whole = whole.to_str().unwrap_or_default().trim_matches('"');
    let tag = HeaderValue::from_str(&format!("\"{description}-{whole}\""));
    tag.map_err(|error| Problem::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))
}

/// The precondition of a change of an asset. Only descriptions are compared: the rest of the response changes
/// with every record.
pub(crate) fn precondition(headers: &HeaderMap) -> Precondition {
    let tags = |name: HeaderName, ignored: &str| {
        let given = headers.get_all(name).iter().map(|value| String::from_utf8_lossy(value.as_bytes()));
        let lists: Vec<_> = given.collect();
        let tags = lists.iter().flat_map(|list| list.split(',')).map(|tag| description_in(tag, ignored));
        (!lists.is_empty()).then(|| tags.collect())
    };
    // RFC 9110: If-Match compares strongly, so that a weak tag matches nothing
    Precondition { matches: tags(header::IF_MATCH, ""), matches_none: tags(header::IF_NONE_MATCH, "W/") }
}

/// The description's part of an asset's tag, without an ignored prefix.
fn description_in(tag: &str, ignored: &str) -> String {
    let tag = tag.trim();
    let tag = tag.strip_prefix(ignored).unwrap_or(tag).trim_matches('"');
    tag.split_once('-').map_or(tag, |(description, _)| description).to_owned()
}

/// Whether the client already has the version with this tag.
pub(crate) fn is_known(headers: &HeaderMap, etag: &HeaderValue) -> bool {
    let (Some(known), Ok(etag)) = (headers.get(header::IF_NONE_MATCH), etag.to_str()) else {
        return false;
    };
    let known = known.to_str().unwrap_or_default();
    known
        .split(',')
        .any(|one| one.trim() == "*" || one.trim().trim_start_matches("W/") == etag.trim_start_matches("W/"))
}

/// The response for a client that has the current version.
pub(crate) fn not_modified(etag: HeaderValue) -> Response {
    (StatusCode::NOT_MODIFIED, [(header::ETAG, etag)]).into_response()
}

/// Tags JSON responses with the hash of their bytes unless the handler set a tag, and omits bodies that the
/// client has.
pub(crate) async fn layer(request: Request, next: Next) -> Response {
    let is_get = request.method() == Method::GET;
    let if_none_match = request.headers().get(header::IF_NONE_MATCH).cloned();
    let response = next.run(request).await;
    let is_json = response
        .headers()
        .get(header::CONTENT_TYPE)
        .is_some_and(|media_type| media_type.as_bytes().starts_with(b"application/json"));
    if !is_get || response.status() != StatusCode::OK || !is_json {
        return response;
    }
    let (mut parts, body) = response.into_parts();
    let caching = HeaderValue::from_static("no-cache");
    parts.headers.entry(header::CACHE_CONTROL).or_insert(caching);
    if parts.headers.contains_key(header::ETAG) {
        return Response::from_parts(parts, body);
    }
    // Such a response is already completely in memory
    let Ok(bytes) = to_bytes(body, usize::MAX).await else {
        return Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "the response is incomplete").into_response();
    };
    let etag = of_bytes(&[&bytes]);
    let mut headers = HeaderMap::new();
    headers.extend(if_none_match.map(|if_none_match| (header::IF_NONE_MATCH, if_none_match)));
    if is_known(&headers, &etag) {
        return not_modified(etag);
    }
    parts.headers.insert(header::ETAG, etag);
    Response::from_parts(parts, Body::from(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tag_that_is_weak_or_not_ascii_is_still_a_precondition() {
        let mut headers = HeaderMap::new();
        assert!(precondition(&headers).matches.is_none());
        for (given, expected) in [
            (&b"\"ab-cd\", \"ef\""[..], vec!["ab", "ef"]),
            (b"W/\"ab-cd\"", vec!["W/\"ab"]),
            (b"\"\xe9\"", vec!["\u{fffd}"]),
        ] {
            headers.insert(header::IF_MATCH, HeaderValue::from_bytes(given).unwrap());
            assert_eq!(precondition(&headers).matches.unwrap(), expected);
        }
        headers.insert(header::IF_NONE_MATCH, HeaderValue::from_static("W/\"ab-cd\""));
        assert_eq!(precondition(&headers).matches_none.unwrap(), ["ab"]);
    }

    #[test]
    fn a_known_tag_is_recognised_weak_or_in_a_list() {
        let etag = of_bytes(&[b"abc"]);
        let mut headers = HeaderMap::new();
        assert!(!is_known(&headers, &etag));
        for (known, expected) in [
            (format!("\"x\", W/{}", etag.to_str().unwrap()), true),
            ("*".to_string(), true),
            ("\"x\"".to_string(), false),
        ] {
            headers.insert(header::IF_NONE_MATCH, HeaderValue::from_str(&known).unwrap());
            assert_eq!(is_known(&headers, &etag), expected, "{known}");
        }
    }
}
