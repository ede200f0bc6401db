//! `/v1/libraries`.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use serde::{Deserialize, Serialize};

use super::problem::Problem;
use super::query::{self, NameInPath, Page, Parameters};
use super::router::App;
use crate::gear::{ContactRule, PairSpec};
use crate::ingest::IngestError;
use crate::library::{FORMAT_VERSION, Library, Manifest};
use crate::signal::{Features, Indicators};

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ListParameters {
    limit: Option<u32>,
    cursor: Option<String>,
}

pub(super) async fn list(State(app): State<App>, Parameters(asked): Parameters<ListParameters>) -> Result<Json<Page<LibraryRow>>, Problem> {
    let limit = query::limit(asked.limit)?;
    let shelf = app.ingest.libraries().shelf();
    let mut all = blocking(move || shelf.list()).await?;
    all.sort_by(|a, b| a.id.cmp(&b.id));
    let shown: Vec<LibraryRow> = all
        .iter()
        .filter(|manifest| asked.cursor.as_ref().is_none_or(|cursor| manifest.id > *cursor))
        .take(limit as usize + 1)
        .map(LibraryRow::from)
        .collect();
    Ok(Json(Page::new(shown, limit, |row| row.id.clone())))
}

/// What a library is, in one row.
#[derive(Debug, Serialize)]
pub(super) struct LibraryRow {
    id: String,
    pair_name: String,
    states: usize,
    max_wear_um: f64,
    contact: ContactRule,
    model_version: String,
    format_version: u32,
    preprocessing: String,
    sample_rate_hz: f64,
    seconds: f64,
}

impl From<&Manifest> for LibraryRow {
    fn from(manifest: &Manifest) -> Self {
        Self {
            id: manifest.id.clone(),
            pair_name: manifest.pair.name.clone(),
            states: manifest.grid.states,
            max_wear_um: manifest.grid.max_wear_um,
            contact: manifest.contact(),
            model_version: manifest.model_version.clone(),
            format_version: FORMAT_VERSION,
            preprocessing: manifest.preprocessing.clone(),
            sample_rate_hz: manifest.grid.sample_rate_hz,
            seconds: manifest.grid.seconds,
        }
    }
}

/// A library with the gear pair that it was simulated for.
#[derive(Debug, Serialize)]
pub(super) struct LibraryView {
    #[serde(flatten)]
    row: LibraryRow,
    pair: PairSpec,
}

pub(super) async fn show(State(app): State<App>, NameInPath(id): NameInPath) -> Result<Json<LibraryView>, Problem> {
    let library = find(&app, &id).await?;
    Ok(Json(LibraryView {
        row: LibraryRow::from(library.manifest()),
        pair: library.pair().clone(),
    }))
}

/// One wear state of a library.
#[derive(Debug, Serialize)]
pub(super) struct StateView {
    library_id: String,
    index: usize,
    wear_um: f64,
    #[serde(flatten)]
    indicators: Indicators,
    features: Features,
    phi1_rad: Vec<f64>,
    stiffness_n_per_m: Vec<f64>,
    uste_rad: Vec<f64>,
    pairs_in_contact: Vec<u32>,
}

pub(super) async fn state(
    State(app): State<App>,
    path: Result<Path<(String, String)>, axum::extract::rejection::PathRejection>,
) -> Result<Json<StateView>, Problem> {
    let Path((id, index)) = path.map_err(|rejection| Problem::not_found(rejection.body_text()))?;
    let library = find(&app, &id).await?;
    let state = index.parse::<usize>().ok().and_then(|index| library.states().get(index));
    let state = state.ok_or_else(|| {
        let last = library.states().len().saturating_sub(1);
        Problem::not_found(format!("library {id} has no state {index}, only 0 to {last}"))
    })?;
    let cycle = state.cycle.clone();
    Ok(Json(StateView {
        library_id: library.id().to_string(),
        index: state.index,
        wear_um: state.wear_um,
        indicators: state.indicators.clone(),
        features: state.features.clone(),
        phi1_rad: cycle.phi1_rad,
        stiffness_n_per_m: cycle.stiffness_n_per_m,
        uste_rad: cycle.uste_rad,
        pairs_in_contact: cycle.pairs_in_contact,
    }))
}

async fn find(app: &App, id: &str) -> Result<Arc<Library>, Problem> {
    let unknown = || Problem::not_found(format!("there is no library {id:?}"));
    // It becomes a file's name.
    if !id.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_') {
        return Err(unknown());
    }
    let (shelf, name) = (app.ingest.libraries().shelf(), id.to_string());
    blocking(move || shelf.get(&name)).await?.ok_or_else(unknown)
}

async fn blocking<T: Send + 'static>(
    read: impl FnOnce() -> Result<T, crate::library::LibraryError> + Send + 'static,
) -> Result<T, Problem> {
    let read = tokio::task::spawn_blocking(read).await;
    let read = read.map_err(|_| IngestError::WorkerLost("read a library"))?;
    read.map_err(|error| Problem::new(axum::http::StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))
}
