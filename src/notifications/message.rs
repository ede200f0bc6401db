//! The text of a notification: webhook body, e-mail subject and e-mail text.

use serde::Serialize;

use crate::asset::json_name;
use crate::estimate::Severity;
use crate::report::{quantity_words, reading_words};
use crate::store::{Notification, NotificationKind};

/// A notification with what its row in the store lacks.
pub(super) struct Message {
    pub(super) notification: Notification,
    /// Display name of the asset; empty where it has none or was removed.
    pub(super) asset_name: String,
    /// Address of the alarm in the dashboard, if the dashboard's address is configured.
    pub(super) url: Option<String>,
}

/// The body of a webhook, in the format of Standard Webhooks.
#[derive(Serialize)]
struct Body<'a> {
    #[serde(rename = "type")]
    kind: String,
    timestamp: jiff::Timestamp,
    data: Data<'a>,
}

#[derive(Serialize)]
struct Data<'a> {
    #[serde(flatten)]
    notification: &'a Notification,
    asset_name: &'a str,
    url: Option<&'a str>,
}

impl Message {
    /// Returns the body of a webhook.
    pub(super) fn json(&self) -> Result<String, serde_json::Error> {
        let notification = &self.notification;
        serde_json::to_string(&Body {
            kind: format!("alarm.{}", json_name(&notification.kind)),
            timestamp: notification.noted_at,
            data: Data { notification, asset_name: &self.asset_name, url: self.url.as_deref() },
        })
    }

    /// Returns the subject of an e-mail.
    pub(super) fn subject(&self) -> String {
        let Notification { kind, severity, severity_before, channel, quantity, .. } = &self.notification;
        let event = match (kind, severity) {
            (NotificationKind::Raised, Some(severity)) => class(*severity).to_owned(),
            (NotificationKind::Worsened, Some(severity)) => format!("{} (worsened)", class(*severity)),
            (NotificationKind::Eased, Some(severity)) => format!("{} (eased)", class(*severity)),
            _ => format!("{} cleared", severity_before.map_or("Alarm", class)),
        };
        let subject = format!("{event}: {}, channel {channel}: {}", self.asset(), quantity_words(quantity));
        // A subject is one line.
        subject.replace(char::is_control, " ")
    }

    /// Returns the text of an e-mail.
    pub(super) fn text(&self) -> String {
        let Notification { kind, severity, severity_before, rule, value, time, .. } = &self.notification;
        let mut lines = vec![
            format!("Asset      {}", self.asset()),
            format!("Channel    {}", self.notification.channel),
            format!("Quantity   {}", quantity_words(&self.notification.quantity)),
            format!("Alarm      {}", json_name(kind)),
            format!("Severity   {}", severity.map_or("none", Severity::name)),
            format!("Previous   {}", severity_before.map_or("none", Severity::name)),
        ];
        if let Some(value) = value {
            lines.push(format!("Value      {}", reading_words(*value)));
        }
        for (name, level) in rule.iter().flat_map(|rule| {
            [
                ("Warning    above", rule.warning),
                ("Danger     above", rule.danger),
                ("Warning    below", rule.warning_below),
                ("Danger     below", rule.danger_below),
            ]
        }) {
            if let Some(level) = level {
                lines.push(format!("{name} {level}"));
            }
        }
        lines.push(format!("Time       {time}"));
        if let Some(url) = &self.url {
            lines.push(format!("\n{url}"));
        }
        lines.push(format!("\nNotification {}", self.notification.id));
        lines.join("\n")
    }

    fn asset(&self) -> String {
        let id = &self.notification.asset_id;
        match self.asset_name.as_str() {
            "" => id.to_string(),
            name => format!("{name} ({id})"),
        }
    }
}

fn class(severity: Severity) -> &'static str {
    match severity {
        Severity::Warning => "Warning",
        Severity::Danger => "Danger",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::AssetId;
    use crate::estimate::{AlarmQuantity, AlarmRule};

    fn message(kind: NotificationKind, severities: [Option<Severity>; 2]) -> Message {
        let rule = AlarmRule { danger: Some(400.0), ..AlarmRule::of(AlarmQuantity::WearUm) };
        let notification = Notification {
            id: "5f".to_owned(),
            number: 3,
            kind,
            noted_at: "2026-01-01T00:01:00Z".parse().unwrap(),
            alarm_id: "a1".to_owned(),
            asset_id: AssetId::new("pump-3").unwrap(),
            channel: "in\nput".to_owned(),
            quantity: AlarmQuantity::WearUm,
            rule: Some(rule),
            severity: severities[1],
            severity_before: severities[0],
            time: "2026-01-01T00:00:00Z".parse().unwrap(),
            value: Some(412.25),
        };
        let url = Some("https://host/#/alarms?show=all&alarm=a1".to_owned());
        Message { notification, asset_name: "Feed pump".to_owned(), url }
    }

    #[test]
    fn a_subject_has_event_asset_channel_and_quantity_in_one_line() {
        let worsened = message(NotificationKind::Worsened, [Some(Severity::Warning), Some(Severity::Danger)]);
        let expected = "Danger (worsened): Feed pump (pump-3), channel in put: Wear depth (µm)";
        assert_eq!(worsened.subject(), expected);
        let cleared = message(NotificationKind::Cleared, [Some(Severity::Danger), None]).subject();
        assert!(cleared.starts_with("Danger cleared: Feed pump"), "{cleared}");
    }

    #[test]
    fn a_text_has_value_limits_and_the_dashboard_url() {
        let text = message(NotificationKind::Raised, [None, Some(Severity::Danger)]).text();
        for words in
            ["Value      412.2", "Danger     above 400", "Previous   none", "alarm=a1", "Notification 5f"]
        {
            assert!(text.contains(words), "{words} in {text}");
        }
        let mut small = message(NotificationKind::Raised, [None, Some(Severity::Danger)]);
        small.notification.value = Some(3e-5);
        assert!(small.text().contains("Value      0.00003000"), "{}", small.text());
    }

    #[test]
    fn a_body_has_the_format_of_standard_webhooks() {
        let body = message(NotificationKind::Raised, [None, Some(Severity::Danger)]).json().unwrap();
        let body: serde_json::Value = serde_json::from_str(&body).unwrap();
        assert_eq!(
            (&body["type"], &body["timestamp"]),
            (&"alarm.raised".into(), &"2026-01-01T00:01:00Z".into())
        );
        let data = &body["data"];
        assert_eq!(
            (&data["id"], &data["number"], &data["severity"]),
            (&"5f".into(), &3.into(), &"danger".into())
        );
        assert_eq!((&data["quantity"], &data["asset_name"]), (&"wear_um".into(), &"Feed pump".into()));
    }
}
