//! `/v1/libraries`.

pub(super) mod states;

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use serde::Serialize;

use super::app::App;
use super::problem::Problem;
use super::request::query::{self, NamePath, Page, PageParameters, Parameters};
use crate::gear::{ContactRule, PairSpec};
use crate::library::{FORMAT_VERSION, Library, Manifest};
use crate::service::ServiceError;
use crate::signal::{Features, Indicators};

/// No identifier of a library is longer; a file's name may have 255 bytes.
const MAX_ID_BYTES: usize = 128;

/// List libraries of simulated wear states
#[utoipa::path(
    get,
    path = "/v1/libraries",
    tag = "libraries",
    params(PageParameters),
    responses((status = 200, body = Page<LibraryRow>)),
)]
pub(super) async fn list(
    State(app): State<App>,
    Parameters(params): Parameters<PageParameters>,
) -> Result<Json<Page<LibraryRow>>, Problem> {
    let limit = query::limit(params.limit)?;
    let cache = app.service.simulations.cache();
    let mut all = blocking(move || cache.list()).await?;
    all.sort_by(|a, b| a.id.cmp(&b.id));
    let shown: Vec<LibraryRow> = all
        .iter()
        .filter(|manifest| params.cursor.as_ref().is_none_or(|cursor| manifest.id > *cursor))
        .take(limit as usize + 1)
        .map(LibraryRow::from)
        .collect();
    Ok(Json(Page::new(shown, limit, |row| row.id.clone())))
}

/// A library in a list.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = LibraryRow)]
pub(super) struct LibraryRow {
    /// Hash of all its inputs.
    id: String,
    /// Display name of the gear pair.
    pair_name: String,
    /// Number of wear states.
    states: usize,
    /// Maximum wear depth in µm.
    max_wear_um: f64,
    /// Contact rule: which pairs of teeth carry the load.
    contact: ContactRule,
    /// Version of the gear model.
    model_version: String,
    /// Version of the library file format.
    format_version: u32,
    /// Identifier of the feature preprocessing.
    preprocessing: String,
    /// Sampling rate of the simulated response in hertz.
    sample_rate_hz: f64,
    /// Length of the simulated response in seconds.
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

/// A library with its gear pair.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = Library)]
pub(super) struct LibraryView {
    #[serde(flatten)]
    row: LibraryRow,
    /// The gear pair.
    pair: PairSpec,
}

/// Get a library with its gear pair
#[utoipa::path(
    get,
    path = "/v1/libraries/{library}",
    tag = "libraries",
    responses((status = 200, body = LibraryView)),
)]
pub(super) async fn show(
    State(app): State<App>,
    NamePath(id): NamePath,
) -> Result<Json<LibraryView>, Problem> {
    let library = find(&app, &id).await?;
    Ok(Json(LibraryView { row: LibraryRow::from(library.manifest()), pair: library.pair().clone() }))
}

/// One wear state of a library.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = LibraryState)]
pub(super) struct StateView {
    /// The library.
    library_id: String,
    /// State number, from 0.
    index: usize,
    /// Greatest wear depth in µm.
    wear_um: f64,
    /// Turns of the driving gear to reach this wear, for Archard wear.
    #[serde(skip_serializing_if = "Option::is_none")]
    driving_turns: Option<f64>,
    #[serde(flatten)]
    indicators: Indicators,
    /// Features of the simulated response.
    features: Features,
    /// Angle of the driving gear over one mesh period in rad.
    phi1_rad: Vec<f64>,
    /// Mesh stiffness at each angle in N/m.
    stiffness_n_per_m: Vec<f64>,
    /// Unloaded static transmission error at each angle in rad.
    uste_rad: Vec<f64>,
    /// Number of tooth pairs in contact at each angle.
    pairs_in_contact: Vec<u32>,
}

/// Get a wear state of a library
#[utoipa::path(
    get,
    path = "/v1/libraries/{library}/states/{state}",
    tag = "libraries",
    responses((status = 200, body = StateView)),
)]
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
        driving_turns: state.driving_turns,
        indicators: state.indicators.clone(),
        features: state.features.clone(),
        phi1_rad: cycle.phi1_rad,
        stiffness_n_per_m: cycle.stiffness_n_per_m,
        uste_rad: cycle.uste_rad,
        pairs_in_contact: cycle.pairs_in_contact,
    }))
}

pub(super) async fn find(app: &App, id: &str) -> Result<Arc<Library>, Problem> {
    let unknown = || Problem::not_found(format!("library {id:?} not found"));
    // The id becomes a file name
    if id.len() > MAX_ID_BYTES
        || !id.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_')
    {
        return Err(unknown());
    }
    let (cache, name) = (app.service.simulations.cache(), id.to_string());
    blocking(move || cache.get(&name)).await?.ok_or_else(unknown)
}

async fn blocking<T: Send + 'static>(
    read: impl FnOnce() -> Result<T, crate::library::LibraryError> + Send + 'static,
) -> Result<T, Problem> {
    let read = tokio::task::spawn_blocking(read).await;
    let read = read.map_err(|_| ServiceError::WorkerLost("read a library"))?;
    read.map_err(|error| Problem::new(axum::http::StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))
}
