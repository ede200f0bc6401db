//! `/v1/alarms`: what was raised, and what people do about it.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::app::App;
use super::body;
use super::problem::{Details, Problem};
use super::query::{self, NameInPath, Page, Parameters};
use crate::asset::AssetId;
use crate::estimate::{AlarmAction, AlarmChange, AlarmQuantity, AlarmRule, AlarmState, Severity};
use crate::service::OperatorAction;
use crate::store::{AlarmFilter, StoredAlarm, StoredAlarmChange};

/// Entries of a history that are shown.
const MAX_ENTRIES: u32 = 1000;

/// Longest comment in bytes.
const MAX_COMMENT: usize = 2000;

/// An alarm as it stands.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = Alarm)]
pub(super) struct AlarmView {
    /// Identifier.
    id: String,
    /// The asset.
    asset_id: AssetId,
    /// The channel.
    channel: String,
    /// What it watches.
    quantity: AlarmQuantity,
    /// When it is raised and cleared; none where the asset has no such rule any more.
    rule: Option<AlarmRule>,
    /// Where it stands.
    state: AlarmState,
    /// What is raised, shelved or not; none where nothing is.
    severity: Option<Severity>,
    /// Until when it is put aside; none where it is not.
    shelved_until: Option<Timestamp>,
    /// Since when something is raised, by the records' times.
    raised_at: Option<Timestamp>,
    /// When it last changed.
    changed_at: Timestamp,
    /// The reading of the latest change that a record made, in the unit of the quantity.
    value: Option<f64>,
}

impl AlarmView {
    /// As it stands at a time.
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

/// An entry of an alarm's history.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = AlarmEntry)]
struct EntryView {
    #[serde(flatten)]
    change: AlarmChange,
    /// Since when the records do not say so any more: some came late, or the history was computed again.
    #[serde(skip_serializing_if = "Option::is_none")]
    withdrawn_at: Option<Timestamp>,
}

/// An alarm with what happened to it.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = AlarmWithHistory)]
pub(super) struct WholeAlarm {
    #[serde(flatten)]
    alarm: AlarmView,
    /// What happened, the earliest first; the latest 1000 entries.
    history: Vec<EntryView>,
    /// How many entries there are.
    history_count: u64,
}

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct ListParameters {
    /// Only those of this asset.
    #[param(value_type = Option<String>)]
    asset: Option<AssetId>,
    /// Only those of this channel.
    channel: Option<String>,
    /// Only those in one of these states, with commas between them.
    #[param(example = "unacknowledged,returned_unacknowledged")]
    state: Option<String>,
    /// Only those that are raised so: `warning` or `danger`.
    severity: Option<String>,
    /// Entries of the page: 1 to 1000, 100 where not given.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the page before.
    cursor: Option<String>,
}

/// Alarms
///
/// All that have ever been raised, the one that changed last first.
#[utoipa::path(
    get,
    path = "/v1/alarms",
    tag = "alarms",
    params(ListParameters),
    responses(
        (status = 200, body = Page<AlarmView>),
        (status = 404, body = Details, content_type = "application/problem+json", description = "There is no such asset"),
    ),
)]
pub(super) async fn list(
    State(app): State<App>,
    Parameters(asked): Parameters<ListParameters>,
) -> Result<Json<Page<AlarmView>>, Problem> {
    let limit = query::limit(asked.limit)?;
    let unknown_state = |state: &str| {
        let expected = "normal, unacknowledged, acknowledged, returned_unacknowledged or shelved";
        Problem::query("state", state, expected)
    };
    let states = asked.state.as_deref().unwrap_or_default().split(',').map(str::trim);
    let states = states.filter(|state| !state.is_empty());
    let states = states.map(|state| AlarmState::from_name(state).ok_or_else(|| unknown_state(state)));
    let unknown_severity = |severity: &str| Problem::query("severity", severity, "warning or danger");
    let severity = asked.severity.as_deref();
    let filter = AlarmFilter {
        states: states.collect::<Result<_, _>>()?,
        severity: severity
            .map(|severity| Severity::from_name(severity).ok_or_else(|| unknown_severity(severity)))
            .transpose()?,
        after: query::place_cursor(asked.cursor.as_deref())?,
        asset: asked.asset,
        channel: asked.channel,
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

/// One alarm with its history
#[utoipa::path(
    get,
    path = "/v1/alarms/{alarm}",
    tag = "alarms",
    params(("alarm" = String, Path, description = "The alarm")),
    responses((status = 200, body = WholeAlarm)),
)]
pub(super) async fn show(
    State(app): State<App>,
    NameInPath(id): NameInPath,
) -> Result<Json<WholeAlarm>, Problem> {
    let alarm = app.service.store.alarm(&id).await?;
    let alarm = alarm.ok_or_else(|| Problem::not_found(format!("there is no alarm {id:?}")))?;
    whole(&app, alarm).await
}

/// Who acknowledges an alarm or takes it up again.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SignedRemark {
    /// Who does it: 1 to 200 bytes.
    #[schema(example = "Ada")]
    by: String,
    /// What they say: at most 2000 bytes.
    #[serde(default)]
    #[schema(example = "seen, oil sample taken")]
    comment: String,
}

/// Who puts an alarm aside, and until when.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Shelving {
    /// Who does it: 1 to 200 bytes.
    #[schema(example = "Ada")]
    by: String,
    /// Until when; later than now.
    #[schema(example = "2200-01-01T00:00:00Z")]
    until: Timestamp,
    /// What they say: at most 2000 bytes.
    #[serde(default)]
    #[schema(example = "until the stop")]
    comment: String,
}

/// Acknowledge an alarm
///
/// Somebody knows. An alarm that gets worse has to be acknowledged again.
#[utoipa::path(
    post,
    path = "/v1/alarms/{alarm}/acknowledge",
    tag = "alarms",
    params(("alarm" = String, Path, description = "The alarm")),
    request_body(content = SignedRemark),
    responses(
        (status = 200, body = WholeAlarm),
        (status = 409, body = Details, content_type = "application/problem+json", description = "There is nothing to acknowledge"),
    ),
)]
pub(super) async fn acknowledge(
    State(app): State<App>,
    NameInPath(id): NameInPath,
    headers: HeaderMap,
    body: Body,
) -> Result<Json<WholeAlarm>, Problem> {
    let SignedRemark { by, comment } = body::described(&app.limits, &headers, body).await?;
    act(&app, &id, AlarmAction::Acknowledge, by, comment).await
}

/// Shelve an alarm
///
/// It is put aside until a time, and then stands where its readings say.
#[utoipa::path(
    post,
    path = "/v1/alarms/{alarm}/shelve",
    tag = "alarms",
    params(("alarm" = String, Path, description = "The alarm")),
    request_body(content = Shelving),
    responses((status = 200, body = WholeAlarm)),
)]
pub(super) async fn shelve(
    State(app): State<App>,
    NameInPath(id): NameInPath,
    headers: HeaderMap,
    body: Body,
) -> Result<Json<WholeAlarm>, Problem> {
    let Shelving { by, until, comment } = body::described(&app.limits, &headers, body).await?;
    if until <= app.service.now() {
        return Err(Problem::content("until", until, "a time later than now"));
    }
    act(&app, &id, AlarmAction::Shelve { until }, by, comment).await
}

/// Take a shelved alarm up again
#[utoipa::path(
    post,
    path = "/v1/alarms/{alarm}/unshelve",
    tag = "alarms",
    params(("alarm" = String, Path, description = "The alarm")),
    request_body(content = SignedRemark),
    responses(
        (status = 200, body = WholeAlarm),
        (status = 409, body = Details, content_type = "application/problem+json", description = "It is not shelved"),
    ),
)]
pub(super) async fn unshelve(
    State(app): State<App>,
    NameInPath(id): NameInPath,
    headers: HeaderMap,
    body: Body,
) -> Result<Json<WholeAlarm>, Problem> {
    let SignedRemark { by, comment } = body::described(&app.limits, &headers, body).await?;
    act(&app, &id, AlarmAction::Unshelve, by, comment).await
}

/// Remark on an alarm
#[utoipa::path(
    post,
    path = "/v1/alarms/{alarm}/comment",
    tag = "alarms",
    params(("alarm" = String, Path, description = "The alarm")),
    request_body(content = SignedRemark),
    responses((status = 200, body = WholeAlarm)),
)]
pub(super) async fn comment(
    State(app): State<App>,
    NameInPath(id): NameInPath,
    headers: HeaderMap,
    body: Body,
) -> Result<Json<WholeAlarm>, Problem> {
    let SignedRemark { by, comment } = body::described(&app.limits, &headers, body).await?;
    if comment.trim().is_empty() {
        return Err(Problem::content("comment", format!("{comment:?}"), "something said"));
    }
    act(&app, &id, AlarmAction::Comment, by, comment).await
}

async fn act(
    app: &App,
    id: &str,
    action: AlarmAction,
    by: String,
    comment: String,
) -> Result<Json<WholeAlarm>, Problem> {
    check_signature(&by, &comment)?;
    let alarm = app.service.alarms.act(id, OperatorAction { action, by, comment }).await?;
    whole(app, alarm).await
}

/// Refuses names and comments that are none.
pub(super) fn check_signature(by: &str, comment: &str) -> Result<(), Problem> {
    if by.trim().is_empty() || by.len() > 200 || by.chars().any(char::is_control) {
        return Err(Problem::content(
            "by",
            format!("{by:?}"),
            "a name of 1 to 200 bytes without control characters",
        ));
    }
    if comment.len() > MAX_COMMENT {
        return Err(Problem::content("comment", format!("{} bytes", comment.len()), "at most 2000 bytes"));
    }
    Ok(())
}

async fn whole(app: &App, alarm: StoredAlarm) -> Result<Json<WholeAlarm>, Problem> {
    let (history, history_count) = app.service.store.alarm_history(&alarm.id, MAX_ENTRIES).await?;
    let entry = |StoredAlarmChange { change, withdrawn_at }| EntryView { change, withdrawn_at };
    Ok(Json(WholeAlarm {
        alarm: AlarmView::new(alarm, app.service.now()),
        history: history.into_iter().map(entry).collect(),
        history_count,
    }))
}
