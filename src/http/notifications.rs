//! `/v1/notifications`: status of the alarm notifications per recipient.

use axum::Json;
use axum::extract::State;
use serde::Serialize;

use super::app::App;
use super::metrics::text::MetricsText;
use super::problem::Problem;
use crate::service::Service;
use crate::store::RecipientStatus;

/// Recipients of alarm notifications.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct RecipientList {
    /// One entry per recipient.
    items: Vec<RecipientStatus>,
}

/// List recipients of alarm notifications
///
/// The webhooks and e-mails of the settings file, with the waiting and failed notifications of each.
#[utoipa::path(
    get,
    path = "/v1/notifications",
    tag = "alarms",
    responses((status = 200, body = RecipientList)),
)]
pub(super) async fn list(State(app): State<App>) -> Result<Json<RecipientList>, Problem> {
    Ok(Json(RecipientList { items: app.service.store.notified().await? }))
}

/// The same in Prometheus' text format; nothing without recipients. Every process of a cluster shows the same
/// numbers.
pub(super) async fn metrics(service: &Service, text: &mut MetricsText) -> Result<(), Problem> {
    let all = service.store.notified().await?;
    if all.is_empty() {
        return Ok(());
    }
    let now = service.store.now(service.now()).await?;
    let mut gauge = |name: &str, help: &str, value: &dyn Fn(&RecipientStatus) -> f64| {
        text.head(name, "gauge", help);
        for notified in &all {
            text.line(name, &[("recipient", &notified.recipient)], value(notified));
        }
    };
    gauge("flankwatch_notifications_waiting", "Alarm notifications not sent yet.", &|notified| {
        notified.waiting as f64
    });
    gauge(
        "flankwatch_notifications_oldest_age_seconds",
        "Age of the oldest waiting notification.",
        &|notified| notified.oldest_at.map_or(0.0, |at| now.duration_since(at).as_secs_f64().max(0.0)),
    );
    gauge("flankwatch_notifications_sent", "Alarm notifications sent in the last 30 days.", &|notified| {
        notified.sent as f64
    });
    gauge(
        "flankwatch_notifications_given_up",
        "Alarm notifications that failed for good in the last 30 days.",
        &|notified| notified.given_up as f64,
    );
    Ok(())
}
