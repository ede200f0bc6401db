//! The metrics of each asset in `GET /metrics/machines`.

use super::app::App;
use super::metrics_text::MetricsText;
use super::problem::Problem;
use crate::estimate::{AlarmState, Severity};
use crate::store::{AlarmFilter, StoredAlarm};

/// Maximum number of alarms shown, most recently changed first.
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
        "Raised severity, shelved or not: 0 none, 1 warning, 2 danger.",
        &|stored| match stored.alarm.severity() {
            None => 0,
            Some(Severity::Warning) => 1,
            Some(Severity::Danger) => 2,
        },
    );
    gauge(
        "flankwatch_alarm_unacknowledged",
        "Whether the alarm needs to be acknowledged, even if it has cleared.",
        &|stored| {
            let state = stored.alarm.unshelved_state();
            u8::from(matches!(state, AlarmState::Unacknowledged | AlarmState::ReturnedUnacknowledged))
        },
    );
    gauge("flankwatch_alarm_shelved", "Whether the alarm is shelved.", &|stored| {
        u8::from(stored.alarm.state(now) == AlarmState::Shelved)
    });
    Ok(())
}

/// Quantiles of the wear depth.
const QUANTILES: [&str; 3] = ["0.25", "0.5", "0.75"];

/// Ends of the interval of the wear depth.
const BOUNDS: [&str; 2] = ["low", "high"];

/// Wear, indicators and time of each channel's latest record; `wanted` selects indicators, all by default.
pub(super) async fn assets(
    app: &App,
    wanted: Option<&[&str]>,
    text: &mut MetricsText,
) -> Result<(), Problem> {
    let mut intervals = MetricsText::default();
    let mut indicators = MetricsText::default();
    let mut times = MetricsText::default();
    text.head(
        "flankwatch_wear_depth_um",
        "gauge",
        "Quantiles of the wear depth after the latest record, in micrometres.",
    );
    intervals.head(
        "flankwatch_wear_depth_interval_um",
        "gauge",
        "Ends of the 90 % interval of the wear depth after the latest record, in micrometres.",
    );
    indicators.head(
        "flankwatch_indicator",
        "gauge",
        "Condition indicators of the latest record, in its unit.",
    );
    times.head(
        "flankwatch_last_record_timestamp_seconds",
        "gauge",
        "Start of the latest record, in seconds since 1970.",
    );
    let is_wanted = |name: &str| wanted.is_none_or(|wanted| wanted.contains(&name));
    for record in &app.service.store.latest_records().await? {
        let labels = |name, value| [("asset", &*record.asset), ("channel", &record.channel), (name, value)];
        let [low, p25, median, p75, high] = record.wear_um;
        for (quantile, value) in QUANTILES.iter().zip([p25, median, p75]) {
            if let Some(value) = value {
                text.line("flankwatch_wear_depth_um", &labels("quantile", quantile), value);
            }
        }
        for (bound, value) in BOUNDS.iter().zip([low, high]) {
            if let Some(value) = value {
                intervals.line("flankwatch_wear_depth_interval_um", &labels("bound", bound), value);
            }
        }
        for (name, value) in record.indicators.values.iter().filter(|(name, _)| is_wanted(name)) {
            indicators.line("flankwatch_indicator", &labels("indicator", name), value);
        }
        let seconds = record.start_time.as_nanosecond() as f64 / 1e9;
        times.line("flankwatch_last_record_timestamp_seconds", &labels("", "")[..2], seconds);
    }
    text.append(intervals);
    text.append(indicators);
    text.append(times);
    Ok(())
}
