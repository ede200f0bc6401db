//! Browser sessions: the token in a cookie that scripts cannot read. Links and downloads then carry it like
//! every other request.

use axum::http::header::{self, InvalidHeaderValue};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::Serialize;

use crate::http::problem::Problem;
use crate::store::{Scope, Token};

const COOKIE: &str = "flankwatch_session";

/// Never sent with requests from another site's pages, and not readable by scripts. Without a lifetime it
/// ends with the browser.
const ATTRIBUTES: &str = "Path=/; HttpOnly; SameSite=Strict";

/// The authenticated caller of a request.
#[derive(Clone)]
pub(crate) struct Caller {
    pub(crate) token: Token,
    /// The presented token, with its secret.
    pub(crate) presented: String,
}

/// The token in the session cookie.
pub(crate) fn token_in_cookie(headers: &HeaderMap) -> Option<&str> {
    let cookies = headers.get_all(header::COOKIE).iter().filter_map(|value| value.to_str().ok());
    let mut pairs = cookies.flat_map(|value| value.split(';')).filter_map(|pair| pair.trim().split_once('='));
    pairs.find(|(name, _)| *name == COOKIE).map(|(_, value)| value)
}

/// Browsers send the cookie automatically, so changes must come from a page of this service. Browsers report
/// that in `sec-fetch-site` or, for pages without TLS, in `origin`, which has already been checked to be the
/// service's own.
pub(crate) fn refuse_unless_own_page(headers: &HeaderMap) -> Result<(), Problem> {
    let is_own = match headers.get("sec-fetch-site") {
        Some(site) => site == "same-origin",
        None => headers.contains_key(header::ORIGIN),
    };
    if is_own {
        return Ok(());
    }
    let detail = "with a session cookie only a page of this service may change something; programs must send their token in the authorization header";
    Err(Problem::new(StatusCode::FORBIDDEN, detail))
}

/// A session's permissions.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct SessionView {
    /// The token of the session; none if no token is required.
    token: Option<SessionToken>,
}

/// A token without its secret.
#[derive(Debug, Serialize, utoipa::ToSchema)]
struct SessionToken {
    /// Its identifier.
    id: String,
    /// Its name.
    name: String,
    /// Its scope.
    #[schema(value_type = String)]
    scope: Scope,
}

impl SessionView {
    fn of(caller: Option<&Caller>) -> Self {
        let token = caller.map(|Caller { token, .. }| SessionToken {
            id: token.id.clone(),
            name: token.name.clone(),
            scope: token.scope,
        });
        Self { token }
    }
}

/// Get the current session
#[utoipa::path(get, path = "/v1/session", tag = "service", responses((status = 200, body = SessionView)))]
pub(crate) async fn show(caller: Option<Extension<Caller>>) -> Json<SessionView> {
    Json(SessionView::of(caller.as_deref()))
}

/// Start a browser session
///
/// The token of the `authorization` header is stored in a cookie until the browser is closed. The session has
/// the token's scope and ends when the token is revoked.
#[utoipa::path(post, path = "/v1/session", tag = "service", responses((status = 200, body = SessionView)))]
pub(crate) async fn begin(
    caller: Option<Extension<Caller>>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let view = SessionView::of(caller.as_deref());
    let Some(Extension(caller)) = caller else {
        return Ok(Json(view).into_response());
    };
    // The scheme as seen by the browser, even behind a proxy that terminates TLS
    let is_secure =
        headers.get(header::ORIGIN).is_some_and(|origin| origin.as_bytes().starts_with(b"https://"));
    let cookie = cookie(&caller.presented, is_secure, "")
        .map_err(|_| Problem::query("authorization", "a token", "printable characters"))?;
    Ok(([(header::SET_COOKIE, cookie)], Json(view)).into_response())
}

/// End a browser session
#[utoipa::path(delete, path = "/v1/session", tag = "service", responses((status = 204, description = "The cookie is deleted")))]
pub(crate) async fn end() -> Response {
    match cookie("", false, "; Max-Age=0") {
        Ok(cookie) => (StatusCode::NO_CONTENT, [(header::SET_COOKIE, cookie)]).into_response(),
        Err(_) => StatusCode::NO_CONTENT.into_response(),
    }
}

fn cookie(value: &str, is_secure: bool, more: &str) -> Result<HeaderValue, InvalidHeaderValue> {
    let secure = if is_secure { "; Secure" } else { "" };
    HeaderValue::try_from(format!("{COOKIE}={value}; {ATTRIBUTES}{secure}{more}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(fields: &[(&'static str, &'static str)]) -> HeaderMap {
        let field = |(name, value): &(&'static str, &'static str)| {
            (name.parse().unwrap(), HeaderValue::from_static(value))
        };
        fields.iter().map(field).collect()
    }

    #[test]
    fn the_session_is_found_among_other_cookies() {
        let found = |value| token_in_cookie(&headers(&[("cookie", value)])).map(str::to_owned);
        assert_eq!(found("a=1; flankwatch_session=fwt_1_2; b=3").as_deref(), Some("fwt_1_2"));
        assert_eq!(found("xflankwatch_session=fwt_1_2; flankwatch_sessions=1"), None);
        assert_eq!(token_in_cookie(&HeaderMap::new()), None);
    }

    #[test]
    fn with_a_cookie_only_own_pages_may_change_something() {
        let is_refused = |fields: &[_]| refuse_unless_own_page(&headers(fields)).is_err();
        assert!(!is_refused(&[("sec-fetch-site", "same-origin")]));
        assert!(!is_refused(&[("origin", "http://wear.example")]));
        assert!(is_refused(&[]));
        for site in ["same-site", "cross-site", "none"] {
            assert!(is_refused(&[("sec-fetch-site", site), ("origin", "http://wear.example")]), "{site}");
        }
    }

    #[test]
    fn the_cookie_is_hidden_from_scripts_and_other_sites() {
        let text = |secure| cookie("fwt_1_2", secure, "").unwrap().to_str().unwrap().to_owned();
        assert_eq!(text(false), "flankwatch_session=fwt_1_2; Path=/; HttpOnly; SameSite=Strict");
        assert!(text(true).ends_with("; Secure"));
    }
}
