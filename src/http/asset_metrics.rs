//! What `GET /metrics/machines` shows of each asset.

use jiff::Timestamp;

use super::app::App;
use super::metrics_text::MetricsText;
use super::problem::Problem;
use crate::asset::{AssetId, Segment, SegmentId};
use crate::estimate::{AlarmState, Severity};
use crate::store::{AlarmFilter, StoredAlarm};

/// Alarms that are shown, those that changed last.
const MAX_ALARMS: u32 = 10_000;

/// The state of each alarm.
pub(super) async fn alarms(app: &App, text: &mut MetricsText) -> Result<(), Problem> {
    let now = app.service.now();
    let alarms = app.service.store.alarms(&AlarmFilter::default(), now, MAX_ALARMS).await?;
    let mut alarms: Vec<_> = alarms.into_iter().map(|stored| (stored.quantity.to_string(), stored)).collect();
    alarms.sort_by(|(a, left), (b, right)| {
        (&left.asset_id, &left.channel, a).cmp(&(&right.asset_id, &right.channel, b))
    });
    let mut gauge = |name: &str, help: &str, value: &dyn Fn(&StoredAlarm) -> u8| {
        text.head(name, "gauge", help);
        for (quantity, stored) in &alarms {
            let labels = [
                ("asset", stored.asset_id.as_str()),
                ("channel", &stored.channel),
                ("quantity", quantity.as_str()),
            ];
            text.line(name, &labels, value(stored));
        }
    };
    gauge(
        "flankwatch_alarm_severity",
        "What is raised, shelved or not: 0 nothing, 1 warning, 2 danger.",
        &|stored| match stored.alarm.severity() {
            None => 0,
            Some(Severity::Warning) => 1,
            Some(Severity::Danger) => 2,
        },
    );
    gauge(
        "flankwatch_alarm_unacknowledged",
        "Whether the alarm is to be acknowledged, also where it is over.",
        &|stored| {
            let state = stored.alarm.standing();
            u8::from(matches!(state, AlarmState::Unacknowledged | AlarmState::ReturnedUnacknowledged))
        },
    );
    gauge("flankwatch_alarm_shelved", "Whether the alarm is put aside.", &|stored| {
        u8::from(stored.alarm.state(now) == AlarmState::Shelved)
    });
    Ok(())
}

/// What is shown of a channel's latest record.
struct Latest {
    asset: AssetId,
    channel: String,
    start_time: Timestamp,
    /// Quantiles of the wear depth in µm.
    wear_um: [(&'static str, Option<f64>); 5],
    indicators: Vec<(String, f64)>,
}

impl Latest {
    fn of(segment: Segment, wanted: Option<&[&str]>) -> Self {
        let wear = &segment.wear;
        let is_wanted = |name: &str| wanted.is_none_or(|wanted| wanted.contains(&name));
        Self {
            wear_um: [
                ("0.05", wear.p05_um),
                ("0.25", wear.p25_um),
                ("0.5", wear.median_um),
                ("0.75", wear.p75_um),
                ("0.95", wear.p95_um),
            ],
            asset: segment.asset_id,
            channel: segment.channel,
            start_time: segment.start_time,
            indicators: segment.indicators.values.into_iter().filter(|(name, _)| is_wanted(name)).collect(),
        }
    }

    fn labels<'a>(&'a self, name: &'a str, value: &'a str) -> [(&'a str, &'a str); 3] {
        [("asset", self.asset.as_str()), ("channel", &self.channel), (name, value)]
    }
}

/// Wear, indicators and time of each channel's latest record; `wanted` are the indicators, all where not
/// given.
pub(super) async fn assets(
    app: &App,
    wanted: Option<&[&str]>,
    text: &mut MetricsText,
) -> Result<(), Problem> {
    let store = &app.service.store;
    let mut latest = Vec::new();
    let mut after: Option<String> = None;
    loop {
        let assets = store.assets(after.as_deref(), 500).await?;
        let Some(last) = assets.last() else { break };
        after = Some(last.spec.id.to_string());
        let ids: Vec<&AssetId> = assets.iter().map(|asset| &asset.spec.id).collect();
        let channels = store.channels_of(&ids).await?;
        let segments: Vec<SegmentId> =
            channels.into_iter().filter_map(|channel| channel.last_segment).collect();
        let segments = store.segments_by_id(&segments).await?;
        latest.extend(segments.into_iter().map(|segment| Latest::of(segment, wanted)));
    }
    latest.sort_by(|a, b| (&a.asset, &a.channel).cmp(&(&b.asset, &b.channel)));
    text.head(
        "flankwatch_wear_depth_um",
        "gauge",
        "Quantiles of the wear depth after the latest record, in micrometres.",
    );
    for record in &latest {
        for (quantile, value) in record.wear_um {
            if let Some(value) = value {
                text.line("flankwatch_wear_depth_um", &record.labels("quantile", quantile), value);
            }
        }
    }
    text.head("flankwatch_indicator", "gauge", "Condition indicators of the latest record, in its unit.");
    for record in &latest {
        for (name, value) in &record.indicators {
            text.line("flankwatch_indicator", &record.labels("indicator", name), value);
        }
    }
    text.head(
        "flankwatch_last_record_timestamp_seconds",
        "gauge",
        "Start of the latest record, in seconds since 1970.",
    );
    for record in &latest {
        let seconds = record.start_time.as_nanosecond() as f64 / 1e9;
        let labels = &record.labels("", "")[..2];
        text.line("flankwatch_last_record_timestamp_seconds", labels, seconds);
    }
    Ok(())
}
