//! All routes on one page.

use std::sync::Arc;

use axum::Router;
use axum::handler::Handler;
use axum::http::{HeaderValue, Method, StatusCode, Uri, header};
use axum::middleware::{from_fn, from_fn_with_state};
use axum::routing::{get, post};
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::set_header::SetResponseHeaderLayer;

use super::limits::HttpLimits;
use super::metrics::Measurements;
use super::problem::Problem;
use super::{assets, dashboard, health, indicators, libraries, metrics, replays, segments, traffic, waveforms, wear};
use crate::ingest::Ingest;

/// Scripts and data only from here; Plotly sets styles on elements and saves pictures.
const CONTENT_SECURITY_POLICY: &str = "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; \
    object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";

/// What handlers work with.
#[derive(Clone)]
pub(super) struct App {
    pub(super) ingest: Ingest,
    pub(super) limits: Arc<HttpLimits>,
    pub(super) measurements: Arc<Measurements>,
    pub(super) uploads: Arc<std::path::Path>,
}

/// The whole service.
pub(super) fn router(app: App) -> Router {
    let uploads = segments::upload.layer(from_fn_with_state(app.clone(), traffic::measure_upload));
    let api = Router::new()
        .route("/v1/assets", get(assets::list).post(assets::create))
        .route("/v1/assets/{asset}", get(assets::show).put(assets::replace).delete(assets::remove))
        .route("/v1/assets/{asset}/segments", get(segments::list).post(uploads))
        .route("/v1/assets/{asset}/indicators", get(indicators::trend))
        .route("/v1/assets/{asset}/wear", get(wear::latest))
        .route("/v1/assets/{asset}/wear/history", get(wear::history))
        .route("/v1/segments/{segment}", get(segments::show))
        .route("/v1/segments/{segment}/waveform", get(waveforms::waveform))
        .route("/v1/segments/{segment}/spectrum", get(waveforms::spectrum))
        .route("/v1/segments/{segment}/envelope", get(waveforms::envelope))
        .route("/v1/replays", post(replays::start).get(replays::list))
        .route("/v1/replays/{replay}", get(replays::show).delete(replays::stop))
        .route("/v1/libraries", get(libraries::list))
        .route("/v1/libraries/{library}", get(libraries::show))
        .route("/v1/libraries/{library}/states/{state}", get(libraries::state))
        .route("/healthz", get(health::alive))
        .route("/readyz", get(health::ready))
        .route("/metrics", get(metrics::show));
    let site = Router::new()
        .route("/", get(dashboard::index))
        .route("/static/{file}", get(dashboard::file));
    api.merge(site)
        .fallback(no_such_path)
        .method_not_allowed_fallback(no_such_method)
        .layer(from_fn_with_state(app.clone(), traffic::time_out))
        .layer(CatchPanicLayer::custom(traffic::panicked))
        .layer(CompressionLayer::new().gzip(true))
        .layer(set(header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY))
        .layer(set(header::X_CONTENT_TYPE_OPTIONS, "nosniff"))
        .layer(set(header::REFERRER_POLICY, "no-referrer"))
        .layer(from_fn(traffic::trace))
        .with_state(app)
}

fn set(name: axum::http::HeaderName, value: &'static str) -> SetResponseHeaderLayer<HeaderValue> {
    SetResponseHeaderLayer::overriding(name, HeaderValue::from_static(value))
}

async fn no_such_path(uri: Uri) -> Problem {
    Problem::not_found(format!("there is nothing at {}", uri.path()))
}

async fn no_such_method(method: Method, uri: Uri) -> Problem {
    Problem::new(
        StatusCode::METHOD_NOT_ALLOWED,
        format!("{} does not take {method}, the allow header says what it takes", uri.path()),
    )
}
