//! `/v1/alarms`: alarms and operator actions on them.

pub(super) mod trials;

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::app::App;
use super::problem::Problem;
use super::request::body::JsonBody;
use super::request::query::{self, NamePath, Page, Parameters};
use crate::asset::{AssetId, from_json_name};
use crate::estimate::{AlarmAction, AlarmQuantity, AlarmRule, AlarmState, Severity};
use crate::service::OperatorAction;
use crate::store::{AlarmFilter, StoredAlarm, StoredAlarmChange};

/// Maximum number of history entries returned.
const MAX_ENTRIES: u32 = 1000;

/// Maximum length of a name in characters.
const MAX_NAME: usize = 200;

/// Maximum length of a comment in characters.
const MAX_COMMENT: usize = 2000;

/// The current state of an alarm.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = Alarm)]
pub(super) struct AlarmView {
    /// Identifier.
    id: String,
    /// The asset.
    asset_id: AssetId,
    /// The channel.
    channel: String,
    /// The watched quantity.
    quantity: AlarmQuantity,
    /// The rule that raises and clears it; none if the asset no longer has this rule.
    rule: Option<AlarmRule>,
    /// The alarm's state.
    state: AlarmState,
    /// The raised severity, even if shelved; none if not raised.
    severity: Option<Severity>,
    /// End of shelving; none if not shelved.
    shelved_until: Option<Timestamp>,
    /// Since when it has been raised, by record time.
    raised_at: Option<Timestamp>,
    /// Time of the last change.
    changed_at: Timestamp,
    /// The reading at the last change caused by a record, in the unit of the quantity.
    value: Option<f64>,
}

impl AlarmView {
    /// The state of an alarm at time `now`.
    pub(super) fn new(stored: StoredAlarm, now: Timestamp) -> Self {
        let alarm = &stored.alarm;
        Self {
            state: alarm.state(now),
            severity: alarm.severity(),
            shelved_until: alarm.shelved_until().filter(|until| now < *until),
            raised_at: alarm.raised_at(),
            value: alarm.value(),
            changed_at: stored.changed_at,
            id: stored.id,
            asset_id: stored.asset_id,
            channel: stored.channel,
            quantity: stored.quantity,
            rule: stored.rule,
        }
    }
}

/// An alarm with its history.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct AlarmWithHistory {
    #[serde(flatten)]
    alarm: AlarmView,
    /// History, oldest first; the latest 1000 entries.
    history: Vec<StoredAlarmChange>,
    /// Total number of entries.
    history_count: u64,
}

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct ListParameters {
    /// Only alarms of this asset.
    #[param(value_type = Option<String>)]
    asset: Option<AssetId>,
    /// Only alarms of this channel.
    channel: Option<String>,
    /// Only alarms in these states, comma-separated.
    #[param(example = "unacknowledged,returned_unacknowledged")]
    state: Option<String>,
    /// Only alarms raised with this severity: `warning` or `danger`.
    severity: Option<String>,
    /// Page size: 1 to 1000, default 100.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
}

/// List alarms
///
/// All alarms ever raised, most recently changed first.
#[utoipa::path(
    get,
    path = "/v1/alarms",
    tag = "alarms",
    params(ListParameters),
    responses(
        (status = 200, body = Page<AlarmView>),
        (status = 404, description = "Asset not found"),
    ),
)]
pub(super) async fn list(
    State(app): State<App>,
    Parameters(params): Parameters<ListParameters>,
) -> Result<Json<Page<AlarmView>>, Problem> {
    let limit = query::limit(params.limit)?;
    let unknown_state = |state: &str| {
        let expected = "normal, unacknowledged, acknowledged, returned_unacknowledged or shelved";
        Problem::query("state", state, expected)
    };
    let states = query::entries(params.state.as_deref());
    let states = states.map(|state| from_json_name(state).map_err(|_| unknown_state(state)));
    let unknown_severity = |severity: &str| Problem::query("severity", severity, "warning or danger");
    let severity = params.severity.as_deref();
    let filter = AlarmFilter {
        states: states.collect::<Result<_, _>>()?,
        severity: severity
            .map(|severity| from_json_name(severity).map_err(|_| unknown_severity(severity)))
            .transpose()?,
        after: query::place_cursor(params.cursor.as_deref())?,
        asset: params.asset,
        channel: params.channel,
    };
    let store = &app.service.store;
    if let Some(asset) = &filter.asset {
        store.asset(asset).await?;
    }
    let now = app.service.now();
    let alarms = store.alarms(&filter, now, limit + 1).await?;
    let page = Page::new(alarms, limit, |alarm: &StoredAlarm| query::cursor_at(alarm.changed_at, &alarm.id));
    Ok(Json(page.map(|alarm| AlarmView::new(alarm, now))))
}

/// Get an alarm with its history
#[utoipa::path(
    get,
    path = "/v1/alarms/{alarm}",
    tag = "alarms",
    responses((status = 200, body = AlarmWithHistory)),
)]
pub(super) async fn show(
    State(app): State<App>,
    NamePath(id): NamePath,
) -> Result<Json<AlarmWithHistory>, Problem> {
    let alarm = app.service.store.alarm(&id).await?;
    let alarm = alarm.ok_or_else(|| Problem::not_found(format!("alarm {id:?} not found")))?;
    whole(&app, alarm).await
}

/// Who acknowledges, unshelves or comments on an alarm.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct AlarmActionRequest {
    /// Name of the person: 1 to 200 characters.
    #[schema(example = "Ada")]
    by: String,
    /// Comment: at most 2000 characters.
    #[serde(default)]
    #[schema(example = "seen, oil sample taken")]
    comment: String,
}

/// Who shelves an alarm, and until when.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ShelveRequest {
    /// Name of the person: 1 to 200 characters.
    #[schema(example = "Ada")]
    by: String,
    /// End of shelving; must be in the future.
    #[schema(example = "2200-01-01T00:00:00Z")]
    until: Timestamp,
    /// Comment: at most 2000 characters.
    #[serde(default)]
    #[schema(example = "until the stop")]
    comment: String,
}

/// Acknowledge an alarm
///
/// An alarm that gets worse has to be acknowledged again.
#[utoipa::path(
    post,
    path = "/v1/alarms/{alarm}/acknowledge",
    tag = "alarms",
    request_body(content = AlarmActionRequest),
    responses(
        (status = 200, body = AlarmWithHistory),
        (status = 409, description = "Nothing to acknowledge"),
    ),
)]
pub(super) async fn acknowledge(
    State(app): State<App>,
    NamePath(id): NamePath,
    JsonBody(AlarmActionRequest { by, comment }): JsonBody<AlarmActionRequest>,
) -> Result<Json<AlarmWithHistory>, Problem> {
    act(&app, &id, AlarmAction::Acknowledge, by, comment).await
}

/// Shelve an alarm
///
/// The alarm is suppressed until a given time; then its state follows its readings again.
#[utoipa::path(
    post,
    path = "/v1/alarms/{alarm}/shelve",
    tag = "alarms",
    request_body(content = ShelveRequest),
    responses((status = 200, body = AlarmWithHistory)),
)]
pub(super) async fn shelve(
    State(app): State<App>,
    NamePath(id): NamePath,
    JsonBody(ShelveRequest { by, until, comment }): JsonBody<ShelveRequest>,
) -> Result<Json<AlarmWithHistory>, Problem> {
    if until <= app.service.now() {
        return Err(Problem::content("until", until, "a time later than now"));
    }
    act(&app, &id, AlarmAction::Shelve { until }, by, comment).await
}

/// Unshelve an alarm
#[utoipa::path(
    post,
    path = "/v1/alarms/{alarm}/unshelve",
    tag = "alarms",
    request_body(content = AlarmActionRequest),
    responses(
        (status = 200, body = AlarmWithHistory),
        (status = 409, description = "The alarm is not shelved"),
    ),
)]
pub(super) async fn unshelve(
    State(app): State<App>,
    NamePath(id): NamePath,
    JsonBody(AlarmActionRequest { by, comment }): JsonBody<AlarmActionRequest>,
) -> Result<Json<AlarmWithHistory>, Problem> {
    act(&app, &id, AlarmAction::Unshelve, by, comment).await
}

/// Comment on an alarm
#[utoipa::path(
    post,
    path = "/v1/alarms/{alarm}/comment",
    tag = "alarms",
    request_body(content = AlarmActionRequest),
    responses((status = 200, body = AlarmWithHistory)),
)]
pub(super) async fn comment(
    State(app): State<App>,
    NamePath(id): NamePath,
    JsonBody(AlarmActionRequest { by, comment }): JsonBody<AlarmActionRequest>,
) -> Result<Json<AlarmWithHistory>, Problem> {
    if comment.trim().is_empty() {
        return Err(Problem::content("comment", format!("{comment:?}"), "a comment"));
    }
    act(&app, &id, AlarmAction::Comment, by, comment).await
}

async fn act(
    app: &App,
    id: &str,
    action: AlarmAction,
    by: String,
    comment: String,
) -> Result<Json<AlarmWithHistory>, Problem> {
    check_signature(&by, &comment)?;
    let alarm = app.service.alarms.act(id, OperatorAction { action, by, comment }).await?;
    whole(app, alarm).await
}

/// Rejects invalid names and comments.
pub(super) fn check_signature(by: &str, comment: &str) -> Result<(), Problem> {
    check_name("by", by)?;
    let length = comment.chars().count();
    if length > MAX_COMMENT {
        return Err(Problem::content("comment", format!("{length} characters"), "at most 2000 characters"));
    }
    Ok(())
}

/// Rejects an invalid name of a person or a token.
pub(super) fn check_name(field: &str, name: &str) -> Result<(), Problem> {
    if name.trim().is_empty() || name.chars().count() > MAX_NAME || name.chars().any(char::is_control) {
        let expected = "a name of 1 to 200 characters, none of them control characters";
        return Err(Problem::content(field, format!("{name:?}"), expected));
    }
    Ok(())
}

async fn whole(app: &App, alarm: StoredAlarm) -> Result<Json<AlarmWithHistory>, Problem> {
    let (history, history_count) = app.service.store.alarm_history(&alarm.id, MAX_ENTRIES).await?;
    Ok(Json(AlarmWithHistory { alarm: AlarmView::new(alarm, app.service.now()), history, history_count }))
}
