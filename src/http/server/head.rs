//! Checks the head of a request before anything else is done.

use axum::extract::{Request, State};
use axum::http::{StatusCode, Version, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::http::app::App;
use crate::http::problem::Problem;

/// Accepts requests whose head is within the limit and that name exactly one host.
pub(crate) async fn layer(State(app): State<App>, request: Request, next: Next) -> Response {
    match check(&request, app.limits.header_bytes) {
        Ok(()) => next.run(request).await,
        Err(problem) => problem.into_response(),
    }
}

fn check(request: &Request, max_bytes: usize) -> Result<(), Problem> {
    // The connection refuses heads beyond its buffer, which may exceed the limit by one read.
    let bytes = head_bytes(request);
    if bytes > max_bytes {
        let detail = format!("the head of the request has {bytes} bytes, expected at most {max_bytes}");
        return Err(Problem::new(StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE, detail));
    }
    // RFC 9112, 3.2: if a proxy used another one of two hosts than this service, they would check different
    // names.
    let hosts = request.headers().get_all(header::HOST).iter().count();
    let may_be_missing = request.version() < Version::HTTP_11;
    if hosts > 1 || (hosts == 0 && !may_be_missing) {
        let detail = format!("the request has {hosts} host fields, expected exactly one");
        return Err(Problem::new(StatusCode::BAD_REQUEST, detail));
    }
    Ok(())
}

/// Number of bytes of a request's line and fields.
fn head_bytes(request: &Request) -> usize {
    let path = request.uri().path_and_query().map_or(1, |path| path.as_str().len());
    let line = request.method().as_str().len() + path + "  HTTP/1.1\r\n".len();
    let fields = request.headers().iter();
    let fields = fields.map(|(name, value)| name.as_str().len() + value.len() + ": \r\n".len());
    line + fields.sum::<usize>() + "\r\n".len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::body::Body;

    fn status(version: Version, fields: &[(&str, &str)]) -> Option<StatusCode> {
        let mut request = axum::http::Request::builder().version(version).uri("/v1/assets");
        for (name, value) in fields {
            request = request.header(*name, *value);
        }
        let problem = check(&request.body(Body::empty()).unwrap(), 1000).err()?;
        Some(problem.into_response().status())
    }

    #[test]
    fn a_request_names_exactly_one_host() {
        let (own, other) = (("host", "localhost"), ("host", "evil.example"));
        assert_eq!(status(Version::HTTP_11, &[own]), None);
        assert_eq!(status(Version::HTTP_10, &[]), None);
        for (version, fields) in [
            (Version::HTTP_11, &[][..]),
            (Version::HTTP_11, &[own, other][..]),
            (Version::HTTP_11, &[own, own][..]),
            (Version::HTTP_10, &[own, other][..]),
        ] {
            assert_eq!(status(version, fields), Some(StatusCode::BAD_REQUEST), "{fields:?}");
        }
    }

    #[test]
    fn the_head_length_is_limited() {
        // `GET /v1/assets HTTP/1.1`, the host, and the bytes of `x: ` and line ends
        let rest = 1000 - 25 - 17 - 5 - 2;
        let fields =
            |length: usize| status(Version::HTTP_11, &[("host", "localhost"), ("x", &"a".repeat(length))]);
        assert_eq!(fields(rest), None);
        assert_eq!(fields(rest + 1), Some(StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE));
    }
}
