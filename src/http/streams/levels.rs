//! Levels of live streams.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::Deserialize;

use super::views::{LevelList, LevelView};
use crate::asset::DEFAULT_STREAM;
use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::request::query::{AssetPath, Parameters};

/// Maximum number of seconds of levels per response.
const MAX_LEVELS: usize = 100_000;

/// The requested levels.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct LevelParameters {
    /// The stream's name, default `main`.
    name: Option<String>,
    /// Start of the time range.
    from: Option<Timestamp>,
    /// End of the time range.
    to: Option<Timestamp>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
}

/// Levels of a live stream
///
/// RMS and peak of each second, including those without records; kept for days to weeks. A page has at most
/// 100 000 seconds.
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/stream/levels",
    tag = "streams",
    params(LevelParameters),
    responses((status = 200, body = LevelList)),
)]
pub(crate) async fn show(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<LevelParameters>,
) -> Result<Json<LevelList>, Problem> {
    let nanoseconds = |time: Option<Timestamp>, otherwise: i64| {
        time.map_or(otherwise, |time| i64::try_from(time.as_nanosecond()).unwrap_or(otherwise))
    };
    let (mut from_ns, to_ns) = (nanoseconds(params.from, i64::MIN), nanoseconds(params.to, i64::MAX));
    if let Some(cursor) = &params.cursor {
        let expected = "the next_cursor of the previous page";
        from_ns = cursor.parse().map_err(|_| Problem::query("cursor", cursor, expected))?;
    }
    let name = params.name.as_deref().unwrap_or(DEFAULT_STREAM);
    let levels = app.service.streams.levels(&asset, name, from_ns, to_ns).await?;
    let next_cursor = levels.get(MAX_LEVELS).map(|row| row.time_ns.to_string());
    let number = |value: f32| value.is_finite().then(|| f64::from(value));
    let items = levels.into_iter().take(MAX_LEVELS).filter_map(|row| {
        Some(LevelView {
            time: Timestamp::from_nanosecond(row.time_ns.into()).ok()?,
            first: row.level.first,
            samples: row.level.frames,
            rms: row.level.channels.iter().map(|channel| number(channel.rms)).collect(),
            peak: row.level.channels.iter().map(|channel| number(channel.peak)).collect(),
        })
    });
    Ok(Json(LevelList { items: items.collect(), next_cursor }))
}
