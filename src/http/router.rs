//! All routes on one page.

use std::sync::Arc;

use axum::Router;
use axum::http::{HeaderName, HeaderValue, Method, StatusCode, Uri, header};
use axum::middleware::{from_fn, from_fn_with_state};
use axum::routing::get;
use tower_http::CompressionLevel;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::set_header::SetResponseHeaderLayer;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::access::{self, issued_tokens, session};
use super::alarms::{self, trials};
use super::app::App;
use super::assets::{self, maintenance};
use super::indicators::{self, baseline_statistics};
use super::libraries::{self, states};
use super::problem::Problem;
use super::request::etag;
use super::segments::{self, exclusions, raw_recordings, record_choice};
use super::server::{drain, head, traffic};
use super::spectra::{angle, cepstra, lines, matching, waterfall, waveforms};
use super::streams::{self, campaigns, levels, live_view};
use super::uploads::{self, csv_preview, recording_preview, tus};
use super::wear::{self, hindsight};
use super::{
    damage, dashboard, events, export, health, metrics, notifications, openapi, pair_presets, preview,
    recomputations, replays, reports,
};

/// Scripts and data come only from this origin; Plotly sets inline styles and saves pictures as blobs.
const CONTENT_SECURITY_POLICY: &str = "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; \
    object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";

/// The operations of the API and their description.
pub(super) fn operations() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(assets::list, assets::create))
        .routes(routes!(assets::show, assets::replace, assets::remove))
        .routes(routes!(maintenance::list, maintenance::add))
        .routes(routes!(maintenance::remove))
        .routes(routes!(segments::list, uploads::upload, segments::remove_range))
        .routes(routes!(record_choice::count))
        .routes(routes!(exclusions::exclude_range))
        .routes(routes!(exclusions::include_range))
        .routes(routes!(indicators::trend))
        .routes(routes!(baseline_statistics::show))
        .routes(routes!(trials::try_rule))
        .routes(routes!(wear::latest))
        .routes(routes!(wear::history))
        .routes(routes!(hindsight::hindsight))
        .routes(routes!(export::export))
        .routes(routes!(waterfall::show))
        .routes(routes!(reports::show))
        .routes(routes!(segments::show, segments::remove))
        .routes(routes!(exclusions::exclude))
        .routes(routes!(exclusions::include))
        .routes(routes!(raw_recordings::download))
        .routes(routes!(waveforms::waveform))
        .routes(routes!(waveforms::spectrum))
        .routes(routes!(waveforms::envelope))
        .routes(routes!(lines::lines))
        .routes(routes!(angle::orders))
        .routes(routes!(angle::turn))
        .routes(routes!(cepstra::cepstrum))
        .routes(routes!(matching::show))
        .routes(routes!(alarms::list))
        .routes(routes!(alarms::show))
        .routes(routes!(alarms::acknowledge))
        .routes(routes!(alarms::shelve))
        .routes(routes!(alarms::unshelve))
        .routes(routes!(alarms::comment))
        .routes(routes!(notifications::list))
        .routes(routes!(tus::create, tus::options))
        .routes(routes!(tus::offset, tus::show, tus::append, tus::cancel))
        .routes(routes!(replays::start, replays::list))
        .routes(routes!(replays::files))
        .routes(routes!(replays::show, replays::stop))
        .routes(routes!(recomputations::list))
        .routes(routes!(libraries::list))
        .routes(routes!(libraries::show))
        .routes(routes!(libraries::state))
        .routes(routes!(states::list))
        .routes(routes!(states::flank))
        .routes(routes!(preview::preview))
        .routes(routes!(csv_preview::csv_preview))
        .routes(routes!(recording_preview::recording_preview))
        .routes(routes!(pair_presets::list))
        .routes(routes!(streams::connect, streams::send, streams::remove))
        .routes(routes!(streams::list))
        .routes(routes!(levels::show))
        .routes(routes!(streams::keep))
        .routes(routes!(campaigns::begin, campaigns::end))
        .routes(routes!(live_view::watch))
        .routes(routes!(events::stream))
        .routes(routes!(session::show, session::begin, session::end))
        .routes(routes!(issued_tokens::list, issued_tokens::create))
        .routes(routes!(issued_tokens::revoke))
        .routes(routes!(health::alive))
        .routes(routes!(health::ready))
        .routes(routes!(metrics::show))
        .routes(routes!(metrics::machines))
}

/// The router of the whole service.
pub(super) fn router(app: App) -> Router {
    let (api, description) = operations().split_for_parts();
    let site = Router::new().route("/", get(dashboard::index)).route("/static/{file}", get(dashboard::file));
    api.merge(site)
        .merge(openapi::routes(description))
        .fallback(no_such_path)
        .method_not_allowed_fallback(no_such_method)
        .layer(from_fn_with_state(app.clone(), traffic::run_to_end))
        .layer(from_fn(etag::layer))
        .layer(from_fn_with_state(app.clone(), damage::layer))
        .layer(from_fn_with_state(Arc::clone(&app.access), access::guard))
        .layer(from_fn(tus::layer))
        .layer(from_fn_with_state(app.clone(), head::layer))
        .layer(from_fn_with_state(app.clone(), traffic::time_out))
        .layer(CatchPanicLayer::custom(traffic::panicked))
        // The default level takes two to five times as long, for responses 7 to 9 % smaller
        .layer(CompressionLayer::new().gzip(true).quality(CompressionLevel::Fastest))
        .layer(set(header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY))
        .layer(set(header::X_CONTENT_TYPE_OPTIONS, "nosniff"))
        .layer(set(header::REFERRER_POLICY, "no-referrer"))
        .layer(set(header::X_FRAME_OPTIONS, "DENY"))
        .layer(set(HeaderName::from_static("cross-origin-resource-policy"), "same-origin"))
        .layer(set(HeaderName::from_static("cross-origin-opener-policy"), "same-origin"))
        .layer(set(HeaderName::from_static("permissions-policy"), "camera=(), microphone=(), geolocation=()"))
        .layer(from_fn_with_state(app.clone(), traffic::measure))
        .layer(from_fn(traffic::trace))
        .layer(from_fn(drain::layer))
        .with_state(app)
}

fn set(name: HeaderName, value: &'static str) -> SetResponseHeaderLayer<HeaderValue> {
    SetResponseHeaderLayer::overriding(name, HeaderValue::from_static(value))
}

async fn no_such_path(uri: Uri) -> Problem {
    Problem::not_found(format!("path {:?} not found", uri.path()))
}

async fn no_such_method(method: Method, uri: Uri) -> Problem {
    Problem::new(
        StatusCode::METHOD_NOT_ALLOWED,
        format!("{} does not support {method}; the allow header lists the supported methods", uri.path()),
    )
}
