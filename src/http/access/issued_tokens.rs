//! `/v1/tokens`: the tokens of the service, created and revoked from the dashboard. A secret is returned
//! once, and neither listed nor logged.

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::session::Caller;
use super::token_error::TokenError;
use super::unreadable;
use crate::asset::json_name;
use crate::http::alarms::check_name;
use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::request::body;
use crate::http::request::query::{self, NamePath, Page, PageParameters, Parameters};
use crate::store::{Scope, Token};

/// Maximum number of tokens: each request searches all of them.
const MAX_TOKENS: usize = 1000;

/// A new token. Must not be logged: it contains the secret.
#[derive(Serialize, utoipa::ToSchema)]
pub(crate) struct NewToken {
    #[serde(flatten)]
    stored: Token,
    /// The token itself; it cannot be retrieved later.
    #[schema(example = "fwt_1f0c77aa_…")]
    token: String,
}

/// A token to create.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct TokenRequest {
    /// Name: 1 to 200 characters, none of them control characters.
    #[schema(example = "press line 3")]
    name: String,
    /// Scope.
    scope: Scope,
}

/// List tokens
///
/// Oldest first, without secrets. Needs the scope `admin`.
#[utoipa::path(
    get,
    path = "/v1/tokens",
    tag = "service",
    params(PageParameters),
    responses((status = 200, body = Page<Token>)),
)]
pub(crate) async fn list(
    State(app): State<App>,
    Parameters(params): Parameters<PageParameters>,
) -> Result<Json<Page<Token>>, Problem> {
    let limit = query::limit(params.limit)?;
    let after = query::place_cursor(params.cursor.as_deref())?;
    let known = app.access.managed_tokens()?.list().await.map_err(|error| unreadable(&error))?;
    let mut tokens = known.map(|tokens| tokens.to_vec()).unwrap_or_default();
    tokens.sort_by(|a, b| sort_key(a).cmp(&sort_key(b)));
    tokens.retain(|token| after.as_ref().is_none_or(|(time, id)| sort_key(token) > (*time, id.as_str())));
    Ok(Json(Page::new(tokens, limit, |token: &Token| query::cursor_at(token.created_at, &token.id))))
}

fn sort_key(token: &Token) -> (Timestamp, &str) {
    (token.created_at, &token.id)
}

/// Create a token
///
/// The secret is only in this response. The first token of a service must have the scope `admin`; from then
/// on every request needs a token. Needs the scope `admin`.
#[utoipa::path(
    post,
    path = "/v1/tokens",
    tag = "service",
    request_body(content = TokenRequest),
    responses(
        (status = 201, body = NewToken),
        (status = 409, description = "The maximum number of tokens exists"),
    ),
)]
pub(crate) async fn create(
    State(app): State<App>,
    caller: Option<Extension<Caller>>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let tokens = app.access.managed_tokens()?;
    let TokenRequest { name, scope } = body::json_body(&app.limits, &headers, body).await?;
    check_name("name", &name)?;
    let known = tokens.list().await.map_err(|error| unreadable(&error))?;
    match &known {
        None if scope != Scope::Admin => {
            let expected = "admin for the first token: afterwards only an admin token can create others";
            return Err(Problem::content("scope", json_name(&scope), expected));
        }
        // The first token was created while this request, which has none, was being processed.
        Some(_) if caller.is_none() => {
            return Err(Problem::new(
                StatusCode::UNAUTHORIZED,
                "a token is required: the first one was just created",
            ));
        }
        Some(known) if known.len() >= MAX_TOKENS => {
            let detail = format!(
                "there are {} tokens, expected fewer than {MAX_TOKENS}: revoke some first",
                known.len()
            );
            return Err(Problem::new(StatusCode::CONFLICT, detail));
        }
        _ => {}
    }
    let issued = tokens.issue(&name, scope, app.service.now()).await;
    let (token, stored) = issued.map_err(|error| unreadable(&error))?;
    tracing::info!(token = stored.id, scope = json_name(&scope), by = by(caller.as_deref()), "created token");
    let response = NewToken { stored, token };
    Ok((StatusCode::CREATED, [(header::CACHE_CONTROL, "no-store")], Json(response)).into_response())
}

/// Revoke a token
///
/// The token and sessions started with it become invalid. The last token with the scope `admin` can only be
/// revoked with `flankwatch token revoke`. Needs the scope `admin`.
#[utoipa::path(
    delete,
    path = "/v1/tokens/{token}",
    tag = "service",
    responses(
        (status = 204, description = "Revoked"),
        (status = 409, description = "It is the last token with the scope admin"),
    ),
)]
pub(crate) async fn revoke(
    State(app): State<App>,
    caller: Option<Extension<Caller>>,
    NamePath(id): NamePath,
) -> Result<StatusCode, Problem> {
    let tokens = app.access.managed_tokens()?;
    let known = tokens.list().await.map_err(|error| unreadable(&error))?;
    let known = known.unwrap_or_default();
    let unknown = || Problem::not_found(format!("token {id:?} not found"));
    let found = known.iter().find(|token| token.id == id).ok_or_else(unknown)?;
    let admins = known.iter().filter(|token| token.scope == Scope::Admin).count();
    if found.scope == Scope::Admin && admins == 1 {
        let detail = format!(
            "the token {id} is the last one with scope admin: create another one first, or use `flankwatch token revoke`"
        );
        return Err(Problem::new(StatusCode::CONFLICT, detail));
    }
    match tokens.revoke(&id, app.service.now()).await {
        Ok(()) => {}
        Err(TokenError::Unknown(_)) => return Err(unknown()),
        Err(error) => return Err(unreadable(&error)),
    }
    tracing::info!(token = id, by = by(caller.as_deref()), "revoked token");
    Ok(StatusCode::NO_CONTENT)
}

/// Who made a request, for the log.
pub(crate) fn by(caller: Option<&Caller>) -> &str {
    caller.map_or("unauthenticated", |caller| &caller.token.id)
}
