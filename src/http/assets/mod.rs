//! `/v1/assets`.

mod category;
pub(super) mod maintenance;

use std::collections::BTreeMap;
use std::time::Instant;

use axum::Extension;
use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::Serialize;
use serde_json::Value;

use super::access::issued_tokens::by;
use super::access::session::Caller;
use super::app::App;
use super::problem::Problem;
use super::request::body;
use super::request::etag;
use super::request::query::{self, AssetPath, Page, PageParameters, Parameters};
use crate::asset::{AssetId, AssetSpec, VelocityZones, WearLimits};
use crate::estimate::{AlarmQuantity, AlarmRule, ChannelContribution, WearEstimate};
use crate::service::{JointWear, Readiness, SimulationProgress, SimulationStage};
use crate::signal::BearingOrders;
use crate::store::{Asset, ChannelSummary, StoredAlarm};
use category::{AlarmCounts, Category};

/// An asset as returned by the API.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = Asset)]
pub(super) struct AssetView {
    #[serde(flatten)]
    spec: AssetSpec,
    /// Creation time.
    created_at: Timestamp,
    /// Time of the last change of the description.
    updated_at: Timestamp,
    /// Records and latest wear.
    summary: Summary,
}

/// An asset's summary in lists.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = AssetSummary)]
struct Summary {
    /// Number of records.
    segments: u64,
    /// Channels with records, in the order in which they were first seen.
    channels: Vec<String>,
    /// Start of the earliest record.
    first_start_time: Option<Timestamp>,
    /// Start of the latest record.
    last_start_time: Option<Timestamp>,
    /// The library that records are compared with; none without a gear pair.
    library_id: Option<String>,
    /// `none`, `building`, `ready` or `failed`.
    library_state: &'static str,
    /// Why the simulation of the library, or of its pair variations, failed. It is retried when the
    /// description changes.
    #[serde(skip_serializing_if = "Option::is_none")]
    library_error: Option<String>,
    /// Expected time in s from the start of the simulation until the first estimates, without waiting for
    /// other simulations; missing unless the library is `building`.
    #[serde(skip_serializing_if = "Option::is_none")]
    library_estimated_s: Option<f64>,
    /// Progress of the simulation of the library or its pair variations; missing if none is running.
    #[serde(skip_serializing_if = "Option::is_none")]
    simulation: Option<SimulationView>,
    /// The asset's estimate from the latest records that are not excluded: of the channel named in the
    /// description, otherwise of all channels combined.
    wear: Option<WearEstimate>,
    /// The channel that contributes most to it.
    wear_channel: Option<String>,
    /// Contribution of each channel; missing if a single channel is used.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    wear_channels: Vec<ChannelContribution>,
    /// Status after NAMUR NE 107: from its alarms, otherwise from its latest wear and its library's state.
    category: Category,
    /// Numbers of alarms.
    alarms: AlarmCounts,
    /// The alarm rules in force: from the description, or derived from its limits.
    alarm_rules: Vec<AlarmRule>,
    /// Fault frequencies of its bearings by name, relative to the rotational frequency of the monitored
    /// shaft.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    bearing_orders: BTreeMap<String, BearingOrders>,
    /// The limits between the zones A to D of `velocity_rms` in mm/s, if the asset has zones.
    #[serde(skip_serializing_if = "Option::is_none")]
    velocity_limits_mm_per_s: Option<[f64; 3]>,
    /// Median wear depth in µm at up to 40 times, evenly spaced from the first to the last record.
    recent_wear_um: Vec<f64>,
}

/// Progress of a simulation.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = SimulationProgress)]
struct SimulationView {
    /// The simulated item.
    stage: SimulationStage,
    /// Fraction done, 0 to 1.
    fraction: f64,
    /// Estimated remaining time in s; none until it is known.
    remaining_s: Option<f64>,
}

impl From<SimulationProgress> for SimulationView {
    fn from(progress: SimulationProgress) -> Self {
        Self {
            stage: progress.stage,
            fraction: progress.fraction(),
            remaining_s: progress.remaining_s(Instant::now()),
        }
    }
}

/// List assets
///
/// All assets with a summary: records, latest wear, state of the library.
#[utoipa::path(
    get,
    path = "/v1/assets",
    tag = "assets",
    params(PageParameters),
    responses((status = 200, body = Page<AssetView>)),
)]
pub(super) async fn list(
    State(app): State<App>,
    Parameters(params): Parameters<PageParameters>,
) -> Result<Json<Page<AssetView>>, Problem> {
    let limit = query::limit(params.limit)?;
    let assets = app.service.store.assets(params.cursor.as_deref(), limit + 1).await?;
    let (assets, next_cursor) =
        Page::new(assets, limit, |asset: &Asset| asset.spec.id.to_string()).into_parts();
    let ids: Vec<&AssetId> = assets.iter().map(|asset| &asset.spec.id).collect();
    let alarms = app.service.store.open_alarms(&ids).await?;
    let mut views = Vec::with_capacity(assets.len());
    for asset in assets {
        views.push(view_with(&app, asset, &alarms).await?);
    }
    Ok(Json(Page::from_parts(views, next_cursor)))
}

/// Create an asset
#[utoipa::path(
    post,
    path = "/v1/assets",
    tag = "assets",
    request_body(content((AssetSpec = "application/json"), (String = "application/toml")), description = "The asset's description"),
    responses(
        (status = 201, body = AssetView, headers(("location" = String, description = "Its address"))),
        (status = 409, description = "An asset with this id exists"),
    ),
)]
pub(super) async fn create(
    State(app): State<App>,
    caller: Option<Extension<Caller>>,
    headers: HeaderMap,
    body: Body,
) -> Result<impl IntoResponse, Problem> {
    let spec = description(&app, &headers, body, &[]).await?;
    let asset = app.service.assets.create(&spec).await?;
    tracing::info!(asset = %spec.id, by = by(caller.as_deref()), "created asset");
    let location = format!("/v1/assets/{}", spec.id);
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], tagged(&app, asset, None).await?))
}

/// Get an asset
///
/// Its entity tag can be used for a conditional change of the description (`If-Match`), even after further
/// records arrived.
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}",
    tag = "assets",
    responses((status = 200, body = AssetView)),
)]
pub(super) async fn show(
    State(app): State<App>,
    AssetPath(id): AssetPath,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let asset = app.service.store.asset(&id).await?;
    tagged(&app, asset, Some(&headers)).await
}

/// An asset's response with its entity tag; without a body if the client has the current version.
async fn tagged(app: &App, asset: Asset, headers: Option<&HeaderMap>) -> Result<Response, Problem> {
    let view = view(app, asset.clone()).await?;
    let json = serde_json::to_vec(&view)
        .map_err(|error| Problem::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
    let etag = etag::of_asset(&asset, &json)?;
    if headers.is_some_and(|headers| etag::is_known(headers, &etag)) {
        return Ok(etag::not_modified(etag));
    }
    Ok(([(header::CONTENT_TYPE, HeaderValue::from_static("application/json")), (header::ETAG, etag)], json)
        .into_response())
}

/// Replace an asset's description
///
/// The wear history is recomputed in the background if the change affects it. The response of `GET` can be
/// sent back: fields outside the description are ignored.
#[utoipa::path(
    put,
    path = "/v1/assets/{asset}",
    tag = "assets",
    params(
        ("if-match" = Option<String>, Header, description = "Required: the description has one of these entity tags"),
        ("if-none-match" = Option<String>, Header, description = "Required: the description has none of these entity tags"),
    ),
    request_body(content((AssetSpec = "application/json"), (String = "application/toml")), description = "The asset's description"),
    responses((status = 200, body = AssetView), (status = 412, description = "The description has changed")),
)]
pub(super) async fn replace(
    State(app): State<App>,
    AssetPath(id): AssetPath,
    caller: Option<Extension<Caller>>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let spec = description(&app, &headers, body, &ANSWERED).await?;
    if spec.id != id {
        return Err(Problem::content("id", &spec.id, &format!("{id}, as in the address")));
    }
    let asset = app.service.assets.update(&spec, &etag::precondition(&headers)).await?;
    tracing::info!(asset = %id, by = by(caller.as_deref()), "replaced the description of asset");
    tagged(&app, asset, None).await
}

/// Delete an asset
///
/// Deletes its records and estimates and moves its raw recordings to quarantine. Assets that share its sensor
/// must be deleted first.
#[utoipa::path(
    delete,
    path = "/v1/assets/{asset}",
    tag = "assets",
    params(
        ("if-match" = Option<String>, Header, description = "Required: the description has one of these entity tags"),
        ("if-none-match" = Option<String>, Header, description = "Required: the description has none of these entity tags"),
    ),
    responses(
        (status = 204, description = "Deleted"),
        (status = 412, description = "The description has changed"),
        (status = 409, description = "Other assets share its sensor"),
    ),
)]
pub(super) async fn remove(
    State(app): State<App>,
    AssetPath(id): AssetPath,
    caller: Option<Extension<Caller>>,
    headers: HeaderMap,
) -> Result<StatusCode, Problem> {
    app.service.assets.delete(&id, &etag::precondition(&headers)).await?;
    tracing::info!(asset = %id, by = by(caller.as_deref()), "deleted asset");
    Ok(StatusCode::NO_CONTENT)
}

/// Fields of a response that are not part of the description.
const ANSWERED: [&str; 3] = ["created_at", "updated_at", "summary"];

/// Reads the description in a body; fields with the names in `left_out` are dropped.
async fn description(
    app: &App,
    headers: &HeaderMap,
    body: Body,
    left_out: &[&str],
) -> Result<AssetSpec, Problem> {
    let media_type = body::media_type(headers);
    match media_type.as_deref() {
        Some("application/json") => {
            let bytes = body::read_description(headers, body, &app.limits).await?;
            let mut fields: Value = body::from_json(&bytes)?;
            let had = fields
                .as_object_mut()
                .map_or(0, |fields| left_out.iter().filter(|name| fields.remove(**name).is_some()).count());
            let bytes = if had > 0 { fields.to_string().into_bytes().into() } else { bytes };
            let spec: AssetSpec = body::from_json(&bytes)?;
            // The check computes the pair's mesh, which takes some hundredths of a second.
            let check = move || spec.validate().map(|()| spec);
            Ok(app.service.workers.run("check a description", check).await??)
        }
        Some("application/toml") => {
            let bytes = body::read_description(headers, body, &app.limits).await?;
            let text = std::str::from_utf8(&bytes).map_err(|error| {
                Problem::new(StatusCode::BAD_REQUEST, format!("the body is not UTF-8: {error}"))
            })?;
            let text = text.to_owned();
            let check = move || AssetSpec::from_toml(&text);
            Ok(app.service.workers.run("check a description", check).await??)
        }
        other => Err(body::unsupported(other, "application/json or application/toml")),
    }
}

async fn view(app: &App, asset: Asset) -> Result<AssetView, Problem> {
    let alarms = app.service.store.open_alarms(&[&asset.spec.id]).await?;
    view_with(app, asset, &alarms).await
}

/// `alarms` are open alarms, of this asset and possibly of others.
async fn view_with(app: &App, asset: Asset, alarms: &[StoredAlarm]) -> Result<AssetView, Problem> {
    let mine = alarms.iter().filter(|alarm| alarm.asset_id == asset.spec.id);
    let summary = summary(app, &asset, AlarmCounts::of(mine, app.service.now())).await?;
    Ok(AssetView { spec: asset.spec, created_at: asset.created_at, updated_at: asset.updated_at, summary })
}

async fn summary(app: &App, asset: &Asset, alarms: AlarmCounts) -> Result<Summary, Problem> {
    let store = &app.service.store;
    let channels = store.channels(&asset.spec.id).await?;
    let (library_id, simulation) = app.service.simulations.of(&asset.spec);
    let library_state = simulation.readiness.name();
    let joint = JointWear::load(store, &JointWear::contributing_channels(asset, &channels)).await?;
    let (mut wear, mut wear_channel, mut wear_channels) = (None, None, Vec::new());
    let mut recent_wear_um = Vec::new();
    if let Some(joint) = joint {
        recent_wear_um = store.wear_curve(&joint.leading).await?.to_vec();
        wear = Some(WearEstimate { posterior: None, ..joint.wear });
        wear_channel = Some(joint.leading.channel);
        wear_channels = joint.contributions;
    }
    let alarm_rules = asset.spec.alarm_rules();
    let is_watched = alarm_rules.iter().any(|rule| rule.quantity == AlarmQuantity::WearUm);
    let unwatched = if is_watched { WearLimits::default() } else { asset.spec.limits };
    Ok(Summary {
        category: Category::of(alarms, wear.as_ref(), unwatched, &simulation.readiness),
        alarms,
        alarm_rules,
        segments: channels.iter().map(|channel| channel.segments).sum(),
        first_start_time: channels.iter().filter_map(|channel| channel.first_start_time).min(),
        last_start_time: channels.iter().filter_map(|channel| channel.last_start_time).max(),
        library_id,
        library_state,
        library_estimated_s: match simulation.readiness {
            Readiness::Building => app.service.simulations.estimated_s(&asset.spec),
            _ => None,
        },
        library_error: simulation.error,
        simulation: simulation.progress.map(SimulationView::from),
        wear,
        wear_channel,
        wear_channels,
        bearing_orders: asset
            .spec
            .bearings()
            .into_iter()
            .map(|bearing| (bearing.name.clone(), bearing.reference_orders()))
            .collect(),
        velocity_limits_mm_per_s: asset.spec.velocity_zones.map(VelocityZones::limits_mm_per_s),
        recent_wear_um,
        channels: channels.into_iter().map(|channel| channel.channel).collect(),
    })
}

/// Returns the asset of a request and its channel: the requested one, otherwise the one that represents the
/// asset.
///
/// The channel is `None` if the asset has no records. Fails if the requested channel has no records.
pub(super) async fn asset_and_channel(
    app: &App,
    id: &AssetId,
    requested: Option<&str>,
) -> Result<(Asset, Option<ChannelSummary>), Problem> {
    let store = &app.service.store;
    let asset = store.asset(id).await?;
    let channels = store.channels(id).await?;
    let channel = match requested {
        Some(requested) => Some(channel_named(id, &channels, requested)?),
        None => asset.default_channel(&channels),
    };
    Ok((asset, channel.cloned()))
}

/// Returns the channel of this name, or a problem if it has no records.
pub(super) fn channel_named<'a>(
    id: &AssetId,
    channels: &'a [ChannelSummary],
    name: &str,
) -> Result<&'a ChannelSummary, Problem> {
    let channel = channels.iter().find(|channel| channel.channel == name);
    channel.ok_or_else(|| Problem::not_found(format!("asset {id} has no records of channel {name:?}")))
}
