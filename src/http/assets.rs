//! `/v1/assets`.

use std::collections::BTreeMap;
use std::time::Instant;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::Serialize;
use serde_json::Value;

use super::app::App;
use super::body;
use super::category::{AlarmCounts, Category};
use super::etag;
use super::problem::{Details, Problem};
use super::query::{self, AssetInPath, Page, PageParameters, Parameters};
use crate::asset::{AssetId, AssetSpec, VelocityZones, WearLimits};
use crate::estimate::{AlarmQuantity, AlarmRule, ChannelContribution, WearEstimate};
use crate::service::{JointWear, SimulationProgress, SimulationStage};
use crate::signal::BearingOrders;
use crate::store::{Asset, ChannelSummary, StoredAlarm};

/// An asset as it is shown.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = Asset)]
pub(super) struct AssetView {
    #[serde(flatten)]
    spec: AssetSpec,
    /// When it was made.
    created_at: Timestamp,
    /// When its description last changed.
    updated_at: Timestamp,
    /// Its records and its latest wear.
    summary: Summary,
}

/// What a list of assets shows of each.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = AssetSummary)]
struct Summary {
    /// Number of records.
    segments: u64,
    /// The channels that have records, the one seen first first.
    channels: Vec<String>,
    /// Start of the earliest record.
    first_start_time: Option<Timestamp>,
    /// Start of the latest record.
    last_start_time: Option<Timestamp>,
    /// The library that records are compared with; none without a gear pair.
    library_id: Option<String>,
    /// `none`, `building`, `ready` or `failed`.
    library_state: &'static str,
    /// Why the library, or the pairs around it, could not be simulated. It is tried again when the
    /// description changes.
    #[serde(skip_serializing_if = "Option::is_none")]
    library_error: Option<String>,
    /// How far the simulation of the library, or of the pairs around it, is; not given where nothing is
    /// simulated.
    #[serde(skip_serializing_if = "Option::is_none")]
    simulation: Option<SimulationView>,
    /// The asset's one answer, from the latest records that are not excluded: of the channel that the
    /// description names, else of all channels together.
    wear: Option<WearEstimate>,
    /// The channel that says most in it.
    wear_channel: Option<String>,
    /// What each channel adds to it; left out where one speaks alone.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    wear_channels: Vec<ChannelContribution>,
    /// What it needs, after NAMUR NE 107: what its alarms say, else its latest wear and the state of its
    /// library.
    category: Category,
    /// Its alarms in numbers.
    alarms: AlarmCounts,
    /// The alarm rules in force: those of its description, or those that follow from its limits.
    alarm_rules: Vec<AlarmRule>,
    /// Fault frequencies of its bearings by their names, over the rotational frequency of the shaft whose speed
    /// is meant.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    bearing_orders: BTreeMap<String, BearingOrders>,
    /// The limits between the zones A to D of `velocity_rms` in mm/s, where it has zones.
    #[serde(skip_serializing_if = "Option::is_none")]
    velocity_limits_mm_per_s: Option<[f64; 3]>,
    /// Medians of its wear depth in µm at no more than 40 moments, evenly from its first record to its last.
    recent_wear_um: Vec<f64>,
}

/// How far a simulation is.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = SimulationProgress)]
struct SimulationView {
    /// What is simulated.
    stage: SimulationStage,
    /// The part of it that is done, 0 to 1.
    fraction: f64,
    /// How long it still takes in s at its speed so far; none before that is known.
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

/// Assets
///
/// Every asset with a summary: records, latest wear, state of its library.
#[utoipa::path(
    get,
    path = "/v1/assets",
    tag = "assets",
    params(PageParameters),
    responses((status = 200, body = Page<AssetView>)),
)]
pub(super) async fn list(
    State(app): State<App>,
    Parameters(asked): Parameters<PageParameters>,
) -> Result<Json<Page<AssetView>>, Problem> {
    let limit = query::limit(asked.limit)?;
    let assets = app.service.store.assets(asked.cursor.as_deref(), limit + 1).await?;
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
    responses((status = 201, body = AssetView, headers(("location" = String, description = "Its address"))), (status = 409, body = Details, content_type = "application/problem+json", description = "There is one of that id")),
)]
pub(super) async fn create(
    State(app): State<App>,
    headers: HeaderMap,
    body: Body,
) -> Result<impl IntoResponse, Problem> {
    let spec = description(&app, &headers, body, &[]).await?;
    let asset = app.service.assets.create(&spec).await?;
    let location = format!("/v1/assets/{}", spec.id);
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], tagged(&app, asset, None).await?))
}

/// One asset
///
/// Its entity tag serves a change that is conditional on the description (`If-Match`), also after further
/// records have come.
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}",
    tag = "assets",
    params(("asset" = AssetId, Path, description = "The asset")),
    responses((status = 200, body = AssetView)),
)]
pub(super) async fn show(
    State(app): State<App>,
    AssetInPath(id): AssetInPath,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let asset = app.service.store.asset(&id).await?;
    tagged(&app, asset, Some(&headers)).await
}

/// An asset's answer with its entity tag; without the answer where the client that asks has it.
async fn tagged(app: &App, asset: Asset, asked: Option<&HeaderMap>) -> Result<Response, Problem> {
    let view = view(app, asset.clone()).await?;
    let json = serde_json::to_vec(&view)
        .map_err(|error| Problem::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
    let etag = etag::of_asset(&asset, &json)?;
    if asked.is_some_and(|headers| etag::is_known(headers, &etag)) {
        return Ok(etag::not_modified(etag));
    }
    Ok(([(header::CONTENT_TYPE, HeaderValue::from_static("application/json")), (header::ETAG, etag)], json)
        .into_response())
}

/// Replace an asset's description
///
/// Its wear history is estimated anew in the background where it depends on what changed. What `GET` answers
/// can be sent back: the fields beside the description are left out.
#[utoipa::path(
    put,
    path = "/v1/assets/{asset}",
    tag = "assets",
    params(
        ("asset" = AssetId, Path, description = "The asset"),
        ("if-match" = Option<String>, Header, description = "Entity tags one of which its description must have"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags of which its description must have none"),
    ),
    request_body(content((AssetSpec = "application/json"), (String = "application/toml")), description = "The asset's description"),
    responses((status = 200, body = AssetView), (status = 412, body = Details, content_type = "application/problem+json", description = "Its description is another one")),
)]
pub(super) async fn replace(
    State(app): State<App>,
    AssetInPath(id): AssetInPath,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let spec = description(&app, &headers, body, &ANSWERED).await?;
    if spec.id != id {
        return Err(Problem::content("id", &spec.id, &format!("{id}, as in the address")));
    }
    let asset = app.service.assets.update(&spec, &etag::precondition(&headers)).await?;
    tagged(&app, asset, None).await
}

/// Delete an asset
///
/// Its records and estimates go with it, its raw recordings into quarantine. One whose sensor others share
/// cannot go before those.
#[utoipa::path(
    delete,
    path = "/v1/assets/{asset}",
    tag = "assets",
    params(
        ("asset" = AssetId, Path, description = "The asset"),
        ("if-match" = Option<String>, Header, description = "Entity tags one of which its description must have"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags of which its description must have none"),
    ),
    responses((status = 204, description = "Gone"), (status = 412, body = Details, content_type = "application/problem+json", description = "Its description is another one"), (status = 409, body = Details, content_type = "application/problem+json", description = "Others hear through its measuring points")),
)]
pub(super) async fn remove(
    State(app): State<App>,
    AssetInPath(id): AssetInPath,
    headers: HeaderMap,
) -> Result<StatusCode, Problem> {
    app.service.assets.delete(&id, &etag::precondition(&headers)).await?;
    app.service.streams.remove(&id).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// What an answer holds beside the description.
const ANSWERED: [&str; 3] = ["created_at", "updated_at", "summary"];

/// The description in a body; its fields of these names are left out.
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
            // The pair's mesh is worked out, which takes some hundredths of a second.
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

/// `alarms` are those that are open, of this asset and perhaps of others.
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
    let joint = JointWear::of(store, &JointWear::speakers(asset, &channels)).await?;
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
        category: Category::of(alarms, wear.as_ref(), unwatched, library_state),
        alarms,
        alarm_rules,
        segments: channels.iter().map(|channel| channel.segments).sum(),
        first_start_time: channels.iter().filter_map(|channel| channel.first_start_time).min(),
        last_start_time: channels.iter().filter_map(|channel| channel.last_start_time).max(),
        library_id,
        library_state,
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

/// The asset of a request and the channel that it is about: the one asked for, else the one that speaks for
/// the asset.
///
/// None of a channel where the asset has no records; a problem where the channel asked for has none.
pub(super) async fn asset_and_channel(
    app: &App,
    id: &AssetId,
    asked: Option<&str>,
) -> Result<(Asset, Option<ChannelSummary>), Problem> {
    let store = &app.service.store;
    let asset = store.asset(id).await?;
    let channels = store.channels(id).await?;
    let channel = match asked {
        Some(asked) => Some(channel_named(id, &channels, asked)?),
        None => asset.speaking_channel(&channels),
    };
    Ok((asset, channel.cloned()))
}

/// The channel of this name; a problem where it has no records.
pub(super) fn channel_named<'a>(
    id: &AssetId,
    channels: &'a [ChannelSummary],
    name: &str,
) -> Result<&'a ChannelSummary, Problem> {
    let channel = channels.iter().find(|channel| channel.channel == name);
    channel.ok_or_else(|| Problem::not_found(format!("asset {id} has no records of channel {name:?}")))
}
