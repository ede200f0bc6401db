//! The dashboard's files, built into the program.

use std::sync::LazyLock;

use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::plotly::{PLOTLY_JS_GZIP, plotly_js};
use super::problem::Problem;
use super::request::etag::{self, is_known};

/// A static file.
struct StaticFile {
    name: &'static str,
    bytes: &'static [u8],
}

macro_rules! files {
    ($($name:literal),* $(,)?) => {
        &[$(StaticFile { name: $name, bytes: include_bytes!(concat!("dashboard/", $name)) }),*]
    };
}

/// All files of `dashboard/`; `index.html` is the page at `/`, the others are under `/static/`.
const FILES: &[StaticFile] = files![
    "agreement.js",
    "alarm-bulk.js",
    "alarm-count.js",
    "alarm-detail.js",
    "alarm-levels.js",
    "alarm-notifications.js",
    "alarm-rule-panel.js",
    "alarm-units.js",
    "alarm-words.js",
    "alarms.css",
    "alarms.js",
    "amplitude-scale.js",
    "api.js",
    "app.css",
    "app.js",
    "asset-frame.js",
    "asset-header.js",
    "asset.css",
    "asset.js",
    "baseline-lines.js",
    "bearing-geometry.js",
    "bearing-panel.js",
    "bench-list.js",
    "bench-plots.js",
    "bench-records.js",
    "bench-tools.js",
    "bench.css",
    "bench.js",
    "cepstrum-plot.js",
    "comparison.js",
    "csv.js",
    "cursor-lines.js",
    "cursor-picture.js",
    "cursor.js",
    "dom.js",
    "drop.js",
    "early-pointer.js",
    "events-card.js",
    "events.js",
    "feature-plot.js",
    "file-start.js",
    "fine-history.js",
    "fine-lines.js",
    "first-steps.js",
    "flank-drawing.js",
    "fleet-groups.js",
    "fleet-low.css",
    "fleet-row.js",
    "fleet-window.js",
    "fleet.css",
    "fleet.js",
    "forecast.js",
    "format.js",
    "gauge.js",
    "gear-choice.js",
    "gear-drawing.js",
    "hindsight.js",
    "icon.svg",
    "import-batch.js",
    "import-channels.js",
    "import-desk.js",
    "import-file.js",
    "import-preview.js",
    "import-progress.js",
    "import-sending.js",
    "import-spacing.js",
    "import-values.js",
    "import.css",
    "import.js",
    "index.html",
    "inspection-fields.js",
    "inspection.js",
    "keyed-rows.js",
    "known-units.js",
    "layers.js",
    "level-change.js",
    "level-plot.js",
    "libraries.js",
    "library.js",
    "life-events.js",
    "line-table.js",
    "listening.js",
    "live.js",
    "login.js",
    "maintenance-dialog.js",
    "match-words.js",
    "match.js",
    "mcap-summary.js",
    "mesh-plots.js",
    "novelty-plot.js",
    "operating-bins.js",
    "peak-list.js",
    "person.js",
    "picture.js",
    "plot-card.js",
    "plot-subjects.js",
    "plots.js",
    "posterior-plot.js",
    "preview-drawing.js",
    "preview-page.js",
    "preview-panel.js",
    "preview-plots.js",
    "preview-request.js",
    "preview-teeth.js",
    "preview.css",
    "record-angle.js",
    "record-facts.js",
    "record-panes.js",
    "record-statuses.js",
    "record-table.css",
    "record-view.js",
    "record.css",
    "records-actions.js",
    "records-dialog.js",
    "records-row.js",
    "records.css",
    "records.js",
    "replay-panel.js",
    "route.js",
    "server-events.js",
    "setting-rows.js",
    "settings-fields.js",
    "settings-lists.js",
    "settings-removal.js",
    "settings.js",
    "setup-derived.js",
    "setup-draft.js",
    "setup-fields.js",
    "setup-geometry.js",
    "setup-inputs.js",
    "setup-json.js",
    "setup-lists.js",
    "setup-measures.js",
    "setup-pair.js",
    "setup-rare-fields.js",
    "setup-refusals.js",
    "setup.css",
    "setup.js",
    "sketch.js",
    "spectrum-aids.js",
    "spectrum-plot.js",
    "spectrum-quantity.js",
    "spectrum-tools.js",
    "state.js",
    "sticky-range.js",
    "still-axes.js",
    "still-curves.js",
    "still-plot.js",
    "still-text.js",
    "stream-feed.js",
    "stream-page.js",
    "stream-plots.js",
    "stream.css",
    "symbols.js",
    "theme.js",
    "time-zone.js",
    "tokens.css",
    "tokens.js",
    "trend-plot.js",
    "trends-card.js",
    "turn-plot.js",
    "velocity-zones.js",
    "views.css",
    "waterfall-cursor.js",
    "waterfall-plot.js",
    "waterfall.js",
    "wav-head.js",
    "waveform-plot.js",
    "wear-card.js",
    "wear-plot.js",
];

const PLOTLY_NAME: &str = "plotly.js";

static PLOTLY_ETAG: LazyLock<HeaderValue> = LazyLock::new(|| etag::of_bytes(&[PLOTLY_JS_GZIP]));

pub(super) async fn index(headers: HeaderMap) -> Response {
    match FILES.iter().find(|file| file.name == "index.html") {
        Some(file) => send(&headers, file),
        None => Problem::not_found("this build has no dashboard").into_response(),
    }
}

pub(super) async fn file(path: Result<Path<String>, PathRejection>, headers: HeaderMap) -> Response {
    let Ok(Path(name)) = path else {
        return Problem::not_found("file not found").into_response();
    };
    if name == PLOTLY_NAME {
        return send_plotly(&headers).await;
    }
    match FILES.iter().find(|file| file.name == name && name != "index.html") {
        Some(file) => send(&headers, file),
        None => Problem::not_found(format!("file {name:?} not found")).into_response(),
    }
}

fn send(headers: &HeaderMap, file: &'static StaticFile) -> Response {
    let etag = etag::of_bytes(&[file.bytes]);
    // Revalidated each time: a new version of the program may change a file under the same name.
    let caching = HeaderValue::from_static("no-cache");
    if is_known(headers, &etag) {
        return (StatusCode::NOT_MODIFIED, [(header::ETAG, etag), (header::CACHE_CONTROL, caching)])
            .into_response();
    }
    let fields = [
        (header::CONTENT_TYPE, HeaderValue::from_static(content_type(file.name))),
        (header::ETAG, etag),
        (header::CACHE_CONTROL, caching),
    ];
    (fields, file.bytes).into_response()
}

async fn send_plotly(headers: &HeaderMap) -> Response {
    let etag = PLOTLY_ETAG.clone();
    let caching = HeaderValue::from_static("public, max-age=86400");
    if is_known(headers, &etag) {
        return (StatusCode::NOT_MODIFIED, [(header::ETAG, etag), (header::CACHE_CONTROL, caching)])
            .into_response();
    }
    let fields = [
        (header::CONTENT_TYPE, HeaderValue::from_static(content_type(PLOTLY_NAME))),
        (header::ETAG, etag),
        (header::CACHE_CONTROL, caching),
        (header::VARY, HeaderValue::from_static("accept-encoding")),
    ];
    let takes_gzip = headers
        .get(header::ACCEPT_ENCODING)
        .and_then(|value| value.to_str().ok())
        .is_some_and(|value| value.split(',').any(|coding| coding.trim().split(';').next() == Some("gzip")));
    if takes_gzip {
        return (fields, [(header::CONTENT_ENCODING, "gzip")], PLOTLY_JS_GZIP).into_response();
    }
    match tokio::task::spawn_blocking(plotly_js).await {
        Ok(script) => (fields, script).into_response(),
        Err(_) => Problem::not_found("the script is unavailable").into_response(),
    }
}

fn content_type(name: &str) -> &'static str {
    match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("svg") => "image/svg+xml",
        Some("png") => "image/png",
        Some("json") => "application/json",
        _ => "application/octet-stream",
    }
}
