//! Parts of a URL: names, pages, numbers of points.

use axum::extract::rejection::{PathRejection, QueryRejection};
use axum::extract::{FromRequestParts, Path, Query};
use axum::http::StatusCode;
use axum::http::request::Parts;
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

/// Query parameters; unknown ones are refused.
pub(crate) struct Parameters<T>(pub(crate) T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for Parameters<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let parsed: Result<Query<T>, QueryRejection> = Query::from_request_parts(parts, state).await;
        parsed.map(|Query(value)| Self(value)).map_err(|rejection| {
            let message = rejection.body_text();
            let cause = message.rsplit(": ").next().unwrap_or_default();
            Problem::new(StatusCode::BAD_REQUEST, message.clone()).naming_field_in(cause)
        })
    }
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
    AssetId::new(name).map_err(|error| Problem::not_found(format!("asset not found: {error}")))
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
