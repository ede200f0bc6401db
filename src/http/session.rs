//! Sessions of browsers: the token in a cookie that no script reads. Links and downloads then carry it like
//! every other request.

use axum::http::header::{self, InvalidHeaderValue};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::Serialize;

use super::problem::Problem;
use super::token::{Scope, Token};

const COOKIE: &str = "flankwatch_session";

/// Never sent with what another site's page asks for, and not to be read by scripts. Without an age it ends
/// with the browser.
const ATTRIBUTES: &str = "Path=/; HttpOnly; SameSite=Strict";

/// Who makes a request, where tokens are asked for.
#[derive(Clone)]
pub(super) struct Caller {
    pub(super) token: Token,
    /// The token as it was shown, with its secret.
    pub(super) presented: String,
}

/// The token of a session's cookie.
pub(super) fn token_in_cookie(headers: &HeaderMap) -> Option<&str> {
    let cookies = headers.get_all(header::COOKIE).iter().filter_map(|value| value.to_str().ok());
    let mut pairs = cookies.flat_map(|value| value.split(';')).filter_map(|pair| pair.trim().split_once('='));
    pairs.find(|(name, _)| *name == COOKIE).map(|(_, value)| value)
}

/// A browser sends the cookie by itself, so what changes something has to come from a page of this service.
/// Browsers say it in `sec-fetch-site`, or, where the page came without TLS, in `origin`, which is the
/// service's own where a request has come so far.
pub(super) fn refuse_unless_own_page(headers: &HeaderMap) -> Result<(), Problem> {
    let is_own = match headers.get("sec-fetch-site") {
        Some(site) => site == "same-origin",
        None => headers.contains_key(header::ORIGIN),
    };
    if is_own {
        return Ok(());
    }
    let detail = "with a session's cookie only a page of this service changes something; programs show their token in the authorization header";
    Err(Problem::new(StatusCode::FORBIDDEN, detail))
}

/// What a session may do.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct SessionView {
    /// The token that was shown; none where nobody is asked for one.
    token: Option<SessionToken>,
}

/// A token without its secret.
#[derive(Debug, Serialize, utoipa::ToSchema)]
struct SessionToken {
    /// Its identifier.
    id: String,
    /// What it is for.
    name: String,
    /// How far it reaches.
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

/// Whose session it is
#[utoipa::path(get, path = "/v1/session", tag = "service", responses((status = 200, body = SessionView)))]
pub(super) async fn show(caller: Option<Extension<Caller>>) -> Json<SessionView> {
    Json(SessionView::of(caller.as_deref()))
}

/// Begins a session of a browser
///
/// The token of the `authorization` header is kept in a cookie until the browser is closed. It reaches as far
/// there as everywhere, and opens nothing any more once it is revoked.
#[utoipa::path(post, path = "/v1/session", tag = "service", responses((status = 200, body = SessionView)))]
pub(super) async fn begin(
    caller: Option<Extension<Caller>>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let view = SessionView::of(caller.as_deref());
    let Some(Extension(caller)) = caller else {
        return Ok(Json(view).into_response());
    };
    // As the browser sees the service, also behind a proxy that ends TLS.
    let is_secure =
        headers.get(header::ORIGIN).is_some_and(|origin| origin.as_bytes().starts_with(b"https://"));
    let cookie = cookie(&caller.presented, is_secure, "")
        .map_err(|_| Problem::query("authorization", "a token", "printable characters"))?;
    Ok(([(header::SET_COOKIE, cookie)], Json(view)).into_response())
}

/// Ends a session of a browser
#[utoipa::path(delete, path = "/v1/session", tag = "service", responses((status = 204, description = "The browser forgets the token")))]
pub(super) async fn end() -> Response {
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
    fn only_a_page_of_the_service_changes_something_with_a_cookie() {
        let is_refused = |fields: &[_]| refuse_unless_own_page(&headers(fields)).is_err();
        assert!(!is_refused(&[("sec-fetch-site", "same-origin")]));
        assert!(!is_refused(&[("origin", "http://wear.example")]));
        assert!(is_refused(&[]));
        for site in ["same-site", "cross-site", "none"] {
            assert!(is_refused(&[("sec-fetch-site", site), ("origin", "http://wear.example")]), "{site}");
        }
    }

    #[test]
    fn a_cookie_is_for_no_script_and_no_other_site() {
        let text = |secure| cookie("fwt_1_2", secure, "").unwrap().to_str().unwrap().to_owned();
        assert_eq!(text(false), "flankwatch_session=fwt_1_2; Path=/; HttpOnly; SameSite=Strict");
        assert!(text(true).ends_with("; Secure"));
    }
}
