//! `/v1/notifications`: how those who are notified of alarms are reached.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::Serialize;

use super::app::App;
use super::metrics_text::MetricsText;
use super::problem::Problem;
use crate::service::Service;
use crate::store::Notified;

/// How the notifications of a recipient stand.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct RecipientView {
    /// The recipient's name in the settings.
    name: String,
    /// Notifications that are not sent yet.
    waiting: u64,
    /// When the oldest of them was noted; none where nothing waits.
    oldest_at: Option<Timestamp>,
    /// Those sent in the last 30 days.
    sent: u64,
    /// When the last of them was sent.
    last_sent_at: Option<Timestamp>,
    /// Those given up in the last 30 days.
    given_up: u64,
    /// Why the latest of those that wait or are given up failed; none where none has failed.
    error: Option<String>,
}

/// Those who are notified of alarms.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct RecipientList {
    /// One for each.
    items: Vec<RecipientView>,
}

impl From<Notified> for RecipientView {
    fn from(notified: Notified) -> Self {
        let Notified { recipient, waiting, oldest_at, sent, last_sent_at, given_up, error } = notified;
        Self { name: recipient, waiting, oldest_at, sent, last_sent_at, given_up, error }
    }
}

/// List those who are notified of alarms
///
/// The webhooks and e-mails of the settings file, with what waits for each and what was given up.
#[utoipa::path(
    get,
    path = "/v1/notifications",
    tag = "alarms",
    responses((status = 200, body = RecipientList)),
)]
pub(super) async fn list(State(app): State<App>) -> Result<Json<RecipientList>, Problem> {
    let notified = app.service.store.notified().await?;
    Ok(Json(RecipientList { items: notified.into_iter().map(RecipientView::from).collect() }))
}

/// The same in Prometheus' text format; nothing where nobody is notified. Every process of a cluster shows
/// the same numbers.
pub(super) async fn metrics(service: &Service, text: &mut MetricsText) -> Result<(), Problem> {
    let all = service.store.notified().await?;
    if all.is_empty() {
        return Ok(());
    }
    let now = service.store.now(service.now()).await?;
    let mut gauge = |name: &str, help: &str, value: &dyn Fn(&Notified) -> f64| {
        text.head(name, "gauge", help);
        for notified in &all {
            text.line(name, &[("recipient", &notified.recipient)], value(notified));
        }
    };
    gauge(
        "flankwatch_notifications_waiting",
        "Notifications of alarms that are not sent yet.",
        &|notified| notified.waiting as f64,
    );
    gauge(
        "flankwatch_notifications_oldest_age_seconds",
        "How long the oldest of these notifications has been waiting.",
        &|notified| notified.oldest_at.map_or(0.0, |at| now.duration_since(at).as_secs_f64().max(0.0)),
    );
    gauge(
        "flankwatch_notifications_sent",
        "Notifications of alarms that were sent in the last 30 days.",
        &|notified| notified.sent as f64,
    );
    gauge(
        "flankwatch_notifications_given_up",
        "Notifications of alarms that could not be sent and were given up in the last 30 days.",
        &|notified| notified.given_up as f64,
    );
    Ok(())
}
