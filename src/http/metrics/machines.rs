//! The metrics of each asset in `GET /metrics/machines`.

use std::collections::BTreeSet;
use std::sync::Arc;

use super::text::{ChannelLabels, MetricsText};
use crate::estimate::{AlarmState, Severity};
use crate::http::app::App;
use crate::http::indicators;
use crate::http::problem::Problem;
use crate::signal::{IndicatorScope, Indicators};
use crate::store::{AlarmFilter, LatestRecord, Store, StoredAlarm};

/// Maximum number of alarms shown, most recently changed first.
const MAX_ALARMS: u32 = 10_000;

/// Assets read in one query.
const ASSETS_PER_QUERY: u32 = 500;

/// The state of each alarm.
pub(crate) async fn alarms(app: &App, text: &mut MetricsText) -> Result<(), Problem> {
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
pub(crate) async fn assets(
    app: &App,
    wanted: Option<&[&str]>,
    text: &mut MetricsText,
) -> Result<(), Problem> {
    let latest = app.service.store.latest_records().await?;
    check(&app.service.store, wanted.unwrap_or_default(), &latest).await?;
    let records: Vec<(ChannelLabels, &LatestRecord)> =
        latest.iter().map(|record| (ChannelLabels::new(&record.asset, &record.channel), &**record)).collect();
    let depth = "flankwatch_wear_depth_um";
    text.head(depth, "gauge", "Quantiles of the wear depth after the latest record, in micrometres.");
    for (channel, record) in &records {
        let [_, p25, median, p75, _] = record.wear_um;
        for (quantile, value) in QUANTILES.iter().zip([p25, median, p75]) {
            if let Some(value) = value {
                text.channel_line(depth, channel, ("quantile", quantile), value);
            }
        }
    }
    let interval = "flankwatch_wear_depth_interval_um";
    text.head(
        interval,
        "gauge",
        "Ends of the 90 % interval of the wear depth after the latest record, in micrometres.",
    );
    for (channel, record) in &records {
        let [low, _, _, _, high] = record.wear_um;
        for (bound, value) in BOUNDS.iter().zip([low, high]) {
            if let Some(value) = value {
                text.channel_line(interval, channel, ("bound", bound), value);
            }
        }
    }
    let indicator = "flankwatch_indicator";
    text.head(indicator, "gauge", "Condition indicators of the latest record, in its unit.");
    let is_wanted = |name: &str| wanted.is_none_or(|wanted| wanted.contains(&name));
    for (channel, record) in &records {
        for (name, value) in record.indicators.values.iter().filter(|(name, _)| is_wanted(name)) {
            text.channel_line(indicator, channel, ("indicator", name), *value);
        }
    }
    let time = "flankwatch_last_record_timestamp_seconds";
    text.head(time, "gauge", "Start of the latest record, in seconds since 1970.");
    for (_, record) in &records {
        let seconds = record.start_time.as_nanosecond() as f64 / 1e9;
        text.line(time, &[("asset", &record.asset), ("channel", &record.channel)], seconds);
    }
    Ok(())
}

/// Rejects indicators that neither a machine with a mesh has nor any asset, for its bands and bearings. The
/// descriptions are read only if a latest record does not have the indicator.
async fn check(store: &Store, wanted: &[&str], latest: &[Arc<LatestRecord>]) -> Result<(), Problem> {
    let mut known: BTreeSet<String> = Indicators::names(&IndicatorScope::default()).into_iter().collect();
    let is_recorded = |name: &str| latest.iter().any(|record| record.indicators.get(name).is_some());
    if wanted.iter().all(|name| known.contains(*name) || is_recorded(name)) {
        return Ok(());
    }
    let mut after: Option<String> = None;
    loop {
        let assets = store.assets(after.as_deref(), ASSETS_PER_QUERY).await?;
        let Some(last) = assets.last() else { break };
        after = Some(last.spec.id.to_string());
        known.extend(assets.iter().flat_map(|asset| asset.spec.indicator_names()));
    }
    let known: Vec<&str> = known.iter().map(String::as_str).collect();
    indicators::check_known("indicators", wanted.iter().copied(), &known)
}
