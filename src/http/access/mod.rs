//! Access control: tokens, their scopes and rate limits, and protection against requests from other web
//! pages.

pub(super) mod client;
pub(super) mod issued_tokens;
mod rate;
pub(super) mod session;
pub(super) mod token;
pub(super) mod token_error;
pub(super) mod tokens;

use std::net::IpAddr;
use std::num::NonZeroU32;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use axum::extract::{Request, State};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::problem::Problem;
use crate::asset::json_name;
use crate::store::Scope;
use rate::RateLimiter;
use session::Caller;
use token::find;
use token_error::TokenError;
use tokens::Tokens;

/// Whether requests need a token.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum AuthPolicy {
    /// Every request needs one, even if no tokens exist.
    Required,
    /// Requests need one once tokens exist. Without tokens, only requests addressed to this machine, by its
    /// own names or by these, are accepted.
    WhenConfigured {
        /// Further host names.
        host_names: Vec<String>,
    },
    /// No request needs one, even if tokens exist.
    Disabled,
}

/// The guard in front of every operation.
pub(super) struct Access {
    tokens: Tokens,
    policy: AuthPolicy,
    /// Revoking every token does not reopen the service.
    had_tokens: AtomicBool,
    rate: RateLimiter,
}

impl Access {
    pub(super) fn new(tokens: Tokens, policy: AuthPolicy, requests_per_s: NonZeroU32) -> Self {
        Self {
            tokens,
            had_tokens: AtomicBool::new(false),
            policy,
            rate: RateLimiter::per_second(requests_per_s),
        }
    }

    /// Returns the tokens if they can be managed over HTTP.
    pub(super) fn managed_tokens(&self) -> Result<&Tokens, Problem> {
        if self.policy == AuthPolicy::Disabled {
            // Otherwise anyone who reaches the service could create a token and keep access later.
            let detail = "the service runs with --insecure-no-tokens: only `flankwatch token` can create and revoke tokens";
            return Err(Problem::new(StatusCode::FORBIDDEN, detail));
        }
        Ok(&self.tokens)
    }

    async fn check(
        &self,
        method: &Method,
        uri: &Uri,
        headers: &HeaderMap,
    ) -> Result<Option<Caller>, Problem> {
        let is_safe = is_safe(method, headers);
        refuse_other_pages(is_safe && *method != Method::OPTIONS, uri, headers)?;
        let path = uri.path();
        if self.policy == AuthPolicy::Disabled || is_public(path) {
            return Ok(None);
        }
        let tokens = self.tokens.list().await.map_err(|error| unreadable(&error))?;
        if tokens.is_some() {
            self.had_tokens.store(true, Ordering::Relaxed);
        } else if let AuthPolicy::WhenConfigured { host_names } = &self.policy
            && !self.had_tokens.load(Ordering::Relaxed)
        {
            return refuse_other_hosts(uri, headers, host_names).map(|()| None);
        }
        let shown = bearer(headers);
        let in_cookie = session::token_in_cookie(headers);
        if shown.is_none() && in_cookie.is_some() && !is_safe {
            session::refuse_unless_own_page(headers)?;
        }
        let presented = shown.or(in_cookie);
        let tokens = tokens.unwrap_or_default();
        let found = presented.and_then(|presented| Some((find(&tokens, presented)?, presented)));
        let (token, presented) = found.ok_or_else(|| {
            let detail = match presented {
                None => "a token is required: authorization: Bearer <token>, created with `flankwatch token create`",
                Some(_) => "the token is unknown or was revoked",
            };
            Problem::new(StatusCode::UNAUTHORIZED, detail)
        })?;
        let needed = needed(method, is_safe, path);
        if token.scope < needed {
            let detail = format!(
                "the token {} has scope {}, expected {}",
                token.id,
                json_name(&token.scope),
                json_name(&needed)
            );
            return Err(Problem::new(StatusCode::FORBIDDEN, detail));
        }
        self.rate.check(&token.id, Instant::now()).map_err(|wait| {
            let seconds = u32::try_from(wait.as_secs()).unwrap_or(u32::MAX).saturating_add(1);
            Problem::new(
                StatusCode::TOO_MANY_REQUESTS,
                format!("too many requests with the token {}", token.id),
            )
            .retry_after(seconds)
        })?;
        Ok(Some(Caller { token: token.clone(), presented: presented.to_owned() }))
    }
}

/// The problem for tokens that cannot be read or stored.
pub(super) fn unreadable(error: &TokenError) -> Problem {
    tracing::error!(%error, "failed to read or store tokens");
    if error.is_unavailable() {
        return Problem::busy("failed to read tokens: the database is unavailable", 5);
    }
    Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "failed to read or store tokens; see the log")
}

/// Interval at which the token of a long connection is checked.
const WATCH_INTERVAL: Duration = Duration::from_secs(2);

/// Watches the token that opened a connection, which ends when the token is revoked.
pub(super) struct TokenWatch {
    access: Arc<Access>,
    caller: Option<Caller>,
    checked_at: tokio::time::Instant,
}

impl TokenWatch {
    pub(super) fn new(access: Arc<Access>, caller: Option<Caller>) -> Self {
        Self { access, caller, checked_at: tokio::time::Instant::now() }
    }

    /// Whether the token was revoked; checked only if the last check is not recent, and assumed valid if the
    /// tokens cannot be read.
    pub(super) async fn is_revoked(&mut self) -> bool {
        let Some(caller) = &self.caller else { return false };
        if self.checked_at.elapsed() < WATCH_INTERVAL {
            return false;
        }
        self.checked_at = tokio::time::Instant::now();
        let tokens = self.access.tokens.list().await;
        tokens.is_ok_and(|tokens| tokens.is_none_or(|tokens| find(&tokens, &caller.presented).is_none()))
    }

    /// Waits until the next check is due; forever without a token.
    pub(super) async fn due(&self) {
        match self.caller {
            Some(_) => tokio::time::sleep_until(self.checked_at + WATCH_INTERVAL).await,
            None => std::future::pending().await,
        }
    }
}

/// The token in the `authorization` header.
fn bearer(headers: &HeaderMap) -> Option<&str> {
    let (scheme, token) = headers.get(header::AUTHORIZATION)?.to_str().ok()?.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

/// Whether a request changes nothing. A WebSocket request counts as a change, because it sends data.
fn is_safe(method: &Method, headers: &HeaderMap) -> bool {
    let upgrade = headers.get(header::UPGRADE);
    let is_upgrade = upgrade.is_some_and(|upgrade| upgrade.as_bytes().eq_ignore_ascii_case(b"websocket"));
    matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS) && !is_upgrade
}

/// Whether a path is public: the pages, which contain no data, and the health checks.
fn is_public(path: &str) -> bool {
    let pages = ["/", "/docs", "/openapi.json", "/healthz", "/readyz"];
    pages.contains(&path) || path.starts_with("/static/") || path.starts_with("/docs/")
}

fn needed(method: &Method, is_safe: bool, path: &str) -> Scope {
    let parts: Vec<&str> = path.trim_matches('/').split('/').collect();
    match parts[..] {
        ["v1", "tokens", ..] => Scope::Admin,
        _ if is_safe => Scope::Read,
        ["v1", "session" | "preview" | "csv-preview" | "recording-preview"] => Scope::Read,
        ["v1", "assets", _, "alarms", "try"] => Scope::Read,
        ["v1", "assets"] | ["v1", "assets", _] => Scope::Admin,
        ["v1", "assets", _, "segments" | "stream"] | ["v1", "segments", _] if *method == Method::DELETE => {
            Scope::Admin
        }
        _ => Scope::Write,
    }
}

/// The host that a request is addressed to, with its port.
fn host_of<'a>(uri: &'a Uri, headers: &'a HeaderMap) -> Option<&'a str> {
    let named = headers.get(header::HOST).and_then(|host| host.to_str().ok());
    named.or_else(|| uri.authority().map(Authority::as_str))
}

/// DNS rebinding: for a browser, a page of another host name that resolves to this machine has the same
/// origin as this service. Its requests carry that host name.
fn refuse_other_hosts(uri: &Uri, headers: &HeaderMap, host_names: &[String]) -> Result<(), Problem> {
    let Some(host) = host_of(uri, headers) else {
        return Ok(());
    };
    let name = host.parse().map(|host: Authority| host.host().trim_end_matches('.').to_ascii_lowercase());
    let is_own = name.is_ok_and(|name| {
        let is_address = name.trim_matches(['[', ']']).parse::<IpAddr>().is_ok();
        is_address
            || name == "localhost"
            || name.ends_with(".localhost")
            || host_names.iter().any(|own| own.eq_ignore_ascii_case(&name))
    });
    if is_own {
        return Ok(());
    }
    let detail = format!(
        "the request is for the host {host:?}, expected localhost, an address, or a name given with --host-name"
    );
    Err(Problem::new(StatusCode::FORBIDDEN, detail))
}

/// Browsers name the page that sends a request in `origin`: only pages of this service may change something.
fn refuse_other_pages(only_reads: bool, uri: &Uri, headers: &HeaderMap) -> Result<(), Problem> {
    if only_reads {
        return Ok(());
    }
    let Some(origin) = headers.get(header::ORIGIN) else {
        return Ok(());
    };
    let host = host_of(uri, headers);
    let from = origin.to_str().ok().and_then(|origin| origin.split_once("://")).map(|(_, host)| host);
    if from.is_some() && from == host {
        return Ok(());
    }
    let detail = format!("the request comes from a page of {origin:?}, expected a page of this service");
    Err(Problem::new(StatusCode::FORBIDDEN, detail))
}

/// Forwards a request, or responds with the reason why it is refused.
pub(super) async fn guard(State(access): State<Arc<Access>>, mut request: Request, next: Next) -> Response {
    match access.check(request.method(), request.uri(), request.headers()).await {
        Ok(caller) => {
            if let Some(caller) = caller {
                request.extensions_mut().insert(caller);
            }
            next.run(request).await
        }
        Err(problem) => {
            let mut response = problem.into_response();
            if response.status() == StatusCode::UNAUTHORIZED {
                response.headers_mut().insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
            }
            response
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changing_assets_needs_a_higher_scope_than_sending_records() {
        for (method, path, scope) in [
            (Method::GET, "/v1/assets", Scope::Read),
            (Method::GET, "/metrics", Scope::Read),
            (Method::GET, "/metrics/machines", Scope::Read),
            (Method::POST, "/v1/assets", Scope::Admin),
            (Method::DELETE, "/v1/assets/a", Scope::Admin),
            (Method::DELETE, "/v1/assets/a/", Scope::Admin),
            (Method::POST, "/v1/assets/a/segments", Scope::Write),
            (Method::DELETE, "/v1/assets/a/segments", Scope::Admin),
            (Method::DELETE, "/v1/assets/a/stream", Scope::Admin),
            (Method::DELETE, "/v1/assets/a/stream/campaign", Scope::Write),
            (Method::DELETE, "/v1/segments/b", Scope::Admin),
            (Method::POST, "/v1/replays", Scope::Write),
            (Method::GET, "/v1/tokens", Scope::Admin),
            (Method::POST, "/v1/tokens", Scope::Admin),
            (Method::DELETE, "/v1/tokens/1f0c77aa", Scope::Admin),
            (Method::POST, "/v1/session", Scope::Read),
            (Method::POST, "/v1/preview", Scope::Read),
            (Method::POST, "/v1/csv-preview", Scope::Read),
            (Method::POST, "/v1/recording-preview", Scope::Read),
            (Method::DELETE, "/v1/session", Scope::Read),
        ] {
            let is_safe = is_safe(&method, &HeaderMap::new());
            assert_eq!(needed(&method, is_safe, path), scope, "{method} {path}");
        }
    }

    #[test]
    fn a_foreign_host_name_is_refused() {
        let uri = Uri::from_static("/v1/assets");
        let names = ["Wear.example".to_owned()];
        for (host, is_own) in [
            ("127.0.0.1:8600", true),
            ("[::1]:8600", true),
            ("localhost:8600", true),
            ("LOCALHOST", true),
            ("wear.example", true),
            ("wear.example.:443", true),
            ("evil.example:8600", false),
            ("127.0.0.1.evil.example", false),
            ("localhost.evil.example", false),
            ("", false),
        ] {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, HeaderValue::from_static(host));
            assert_eq!(refuse_other_hosts(&uri, &headers, &names).is_ok(), is_own, "{host:?}");
        }
        assert!(
            refuse_other_hosts(&Uri::from_static("http://evil.example/v1"), &HeaderMap::new(), &names)
                .is_err()
        );
    }

    #[test]
    fn a_websocket_request_needs_the_write_scope() {
        let mut headers = HeaderMap::new();
        assert!(is_safe(&Method::GET, &headers));
        headers.insert(header::UPGRADE, HeaderValue::from_static("websocket"));
        let is_safe = is_safe(&Method::GET, &headers);
        assert_eq!(needed(&Method::GET, is_safe, "/v1/assets/a/stream"), Scope::Write);
    }

    #[test]
    fn requests_from_other_pages_are_refused() {
        let uri = Uri::from_static("/v1/assets");
        let mut headers = HeaderMap::new();
        headers.insert(header::HOST, HeaderValue::from_static("127.0.0.1:8600"));
        assert!(refuse_other_pages(false, &uri, &headers).is_ok());
        headers.insert(header::ORIGIN, HeaderValue::from_static("http://127.0.0.1:8600"));
        assert!(refuse_other_pages(false, &uri, &headers).is_ok());
        for origin in ["http://evil.example", "null", "http://127.0.0.1:8600.evil.example"] {
            headers.insert(header::ORIGIN, HeaderValue::from_static(origin));
            assert!(refuse_other_pages(false, &uri, &headers).is_err(), "{origin}");
            assert!(refuse_other_pages(true, &uri, &headers).is_ok());
        }
    }
}
