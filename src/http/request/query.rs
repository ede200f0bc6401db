//! Parts of a URL: names, pages, numbers of points.

use axum::extract::rejection::{PathRejection, QueryRejection};
use axum::extract::{FromRequestParts, Path, Query};
use axum::http::request::Parts;
use axum::http::{StatusCode, Uri};
use jiff::Timestamp;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::asset::{AssetId, SegmentId};
use crate::http::problem::Problem;
use crate::store::SegmentKey;

/// Default page size of a list.
const DEFAULT_LIMIT: u32 = 100;

/// Maximum page size of a list.
const MAX_LIMIT: u32 = 1000;

/// Maximum number of points of a reduced curve.
const MAX_POINTS: usize = 200_000;

/// What is expected of a time.
pub(super) const TIME: &str = "a time such as 2026-03-01T08:00:00Z";

/// Query parameters; unknown ones are refused.
pub(crate) struct Parameters<T>(pub(crate) T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for Parameters<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let parsed: Result<Query<T>, QueryRejection> = Query::from_request_parts(parts, state).await;
        parsed
            .map(|Query(value)| Self(value))
            .map_err(|rejection| refusal(&rejection.body_text(), &parts.uri))
    }
}

/// The problem of a query with the decoder's message: a parameter's name, a colon and the cause, or only the
/// cause.
fn refusal(message: &str, uri: &Uri) -> Problem {
    let message = message.trim_start_matches("Failed to deserialize query string: ");
    let is_name =
        |text: &str| text.bytes().all(|byte| byte.is_ascii_lowercase() || matches!(byte, b'_' | b'0'..=b'9'));
    let (field, cause) = match message.split_once(": ") {
        Some((field, cause)) if is_name(field) => (Some(field), cause),
        _ => (None, message),
    };
    let given: Vec<(String, String)> =
        Query::try_from_uri(uri).map_or_else(|_| Vec::new(), |Query(given)| given);
    let value = given.into_iter().find(|(name, _)| Some(name.as_str()) == field).map(|(_, value)| value);
    if let (Some(field), Some(value), Some(expected)) = (field, value, expectation(cause)) {
        return Problem::query(field, format!("{value:?}"), &expected);
    }
    let problem =
        Problem::new(StatusCode::BAD_REQUEST, format!("invalid query: {cause}")).naming_field_in(cause);
    match field {
        Some(field) if !problem.names_a_field() => problem.of_field(field.to_owned()),
        _ => problem,
    }
}

/// What a value should have been, from the cause of its refusal; `None` if the cause is about a name.
fn expectation(cause: &str) -> Option<String> {
    let of_type = match cause {
        "invalid digit found in string"
        | "cannot parse integer from empty string"
        | "number too large to fit in target type"
        | "number too small to fit in target type" => "a whole number in range",
        "invalid float literal" | "cannot parse float from empty string" => "a number",
        "provided string was not `true` or `false`" => "true or false",
        _ if cause.contains(" field `") => return None,
        _ => match cause.rsplit_once(", expected ") {
            // Messages about times say what they got too.
            Some((_, expected)) if !expected.contains(" but got ") => {
                return Some(expected.replace('`', "").replace("one of ", ""));
            }
            _ => TIME,
        },
    };
    Some(of_type.to_owned())
}

/// The page of a list, for lists without other parameters.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct PageParameters {
    /// Page size: 1 to 1000, default 100.
    #[param(minimum = 1, maximum = 1000)]
    pub(crate) limit: Option<u32>,
    /// `next_cursor` of the previous page.
    pub(crate) cursor: Option<String>,
}

/// An asset's name in the path.
pub(crate) struct AssetPath(pub(crate) AssetId);

impl<S: Send + Sync> FromRequestParts<S> for AssetPath {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        asset_id(text_in_path(parts, state).await?).map(Self)
    }
}

/// Parses an asset's name in a path: no asset has an invalid one.
pub(crate) fn asset_id(name: String) -> Result<AssetId, Problem> {
    AssetId::new(name.as_str()).map_err(|_| Problem::not_found(format!("asset {name:?} not found")))
}

/// A segment's identifier in the path.
pub(crate) struct SegmentPath(pub(crate) SegmentId);

impl<S: Send + Sync> FromRequestParts<S> for SegmentPath {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        Ok(Self(SegmentId(text_in_path(parts, state).await?)))
    }
}

/// Any other single name in the path.
pub(crate) struct NamePath(pub(crate) String);

impl<S: Send + Sync> FromRequestParts<S> for NamePath {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        Ok(Self(text_in_path(parts, state).await?))
    }
}

async fn text_in_path<S: Send + Sync>(parts: &mut Parts, state: &S) -> Result<String, Problem> {
    let parsed: Result<Path<String>, PathRejection> = Path::from_request_parts(parts, state).await;
    let Path(text) = parsed.map_err(|rejection| Problem::not_found(rejection.body_text()))?;
    Ok(text)
}

/// One page of a list.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct Page<T> {
    /// The entries.
    items: Vec<T>,
    /// The `cursor` of the next page; none on the last one.
    next_cursor: Option<String>,
}

impl<T> Page<T> {
    /// Makes a page from up to `limit` + 1 items; the extra item only shows that there is a next page.
    pub(crate) fn new(mut items: Vec<T>, limit: u32, cursor: impl Fn(&T) -> String) -> Self {
        let is_last = items.len() <= limit as usize;
        items.truncate(limit as usize);
        let next_cursor = if is_last { None } else { items.last().map(cursor) };
        Self { items, next_cursor }
    }

    /// A page with every item rendered.
    pub(crate) fn map<U>(self, render: impl FnMut(T) -> U) -> Page<U> {
        Page { items: self.items.into_iter().map(render).collect(), next_cursor: self.next_cursor }
    }

    /// The items and the cursor of the next page.
    pub(crate) fn into_parts(self) -> (Vec<T>, Option<String>) {
        (self.items, self.next_cursor)
    }

    pub(crate) fn from_parts(items: Vec<T>, next_cursor: Option<String>) -> Self {
        Self { items, next_cursor }
    }
}

/// The entries of a comma-separated list.
pub(crate) fn entries(list: Option<&str>) -> impl Iterator<Item = &str> {
    list.unwrap_or_default().split(',').map(str::trim).filter(|entry| !entry.is_empty())
}

/// The requested page size.
pub(crate) fn limit(requested: Option<u32>) -> Result<u32, Problem> {
    match requested.unwrap_or(DEFAULT_LIMIT) {
        limit @ 1..=MAX_LIMIT => Ok(limit),
        limit => Err(Problem::query("limit", limit, "a number from 1 to 1000")),
    }
}

/// The requested number of points.
pub(crate) fn max_points(requested: Option<usize>, default: usize) -> Result<usize, Problem> {
    match requested.unwrap_or(default) {
        points @ 10..=MAX_POINTS => Ok(points),
        points => Err(Problem::query("max_points", points, "a number from 10 to 200000")),
    }
}

/// Parses a cursor of a list in order of time: a time and an identifier.
pub(crate) fn place_cursor(cursor: Option<&str>) -> Result<Option<(Timestamp, String)>, Problem> {
    let Some(cursor) = cursor else { return Ok(None) };
    let place = cursor.split_once('.').and_then(|(nanoseconds, id)| {
        let nanoseconds: i64 = nanoseconds.parse().ok()?;
        Some((Timestamp::from_nanosecond(nanoseconds.into()).ok()?, id.to_string()))
    });
    place.map(Some).ok_or_else(|| Problem::query("cursor", cursor, "the next_cursor of the previous page"))
}

/// Parses a cursor of a list of segments.
pub(crate) fn segment_cursor(cursor: Option<&str>) -> Result<Option<SegmentKey>, Problem> {
    let place = place_cursor(cursor)?;
    Ok(place.map(|(start_time, id)| SegmentKey { start_time, id: SegmentId(id) }))
}

/// The cursor of a position in a list of segments.
pub(crate) fn cursor_of(key: &SegmentKey) -> String {
    cursor_at(key.start_time, &key.id.0)
}

/// The cursor of a position in a list in order of time.
pub(crate) fn cursor_at(time: Timestamp, id: &str) -> String {
    format!("{}.{id}", time.as_nanosecond())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields, rename_all = "snake_case")]
    #[expect(dead_code, reason = "only its errors are read")]
    struct Given {
        limit: Option<u32>,
        max_s: Option<f64>,
        waveforms: Option<bool>,
        from: Option<Timestamp>,
    }

    #[tokio::test]
    async fn an_error_names_parameter_value_and_expectation() {
        for (query, expected) in [
            ("limit=-1", r#"limit is "-1", expected a whole number in range"#),
            ("limit=99999999999", r#"limit is "99999999999", expected a whole number in range"#),
            ("max_s=a%20b", r#"max_s is "a b", expected a number"#),
            ("waveforms=yes", r#"waveforms is "yes", expected true or false"#),
            ("from=yesterday", r#"from is "yesterday", expected a time such as 2026-03-01T08:00:00Z"#),
            ("limitt=1", "invalid query: unknown field `limitt`"),
            ("limit=1&limit=2", "invalid query: duplicate field `limit`"),
        ] {
            let request = axum::http::Request::builder().uri(format!("/v1/x?{query}")).body(()).unwrap();
            let (mut parts, ()) = request.into_parts();
            let problem = Parameters::<Given>::from_request_parts(&mut parts, &()).await.err().unwrap();
            assert!(problem.detail().starts_with(expected), "{query}: {}", problem.detail());
            assert!(problem.names_a_field(), "{query}");
        }
    }
}
