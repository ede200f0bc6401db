//! `/v1/assets/{asset}/alarms/try`: what a rule would have raised on the records that are there.

use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::app::App;
use super::problem::Problem;
use super::query::AssetInPath;
use super::{assets, body};
use crate::asset::AssetId;
use crate::estimate::{AlarmPanel, AlarmQuantity, AlarmRule, MaintenanceEvent, Severity};
use crate::service::Service;
use crate::signal::Indicators;
use crate::store::{ChannelSummary, RecordResults};

/// Records read and judged at a time.
const AT_ONCE: u32 = 2000;

/// Changes that are listed; further ones are only counted.
const MAX_CHANGES: usize = 1000;

/// A rule to try.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct TrialRequest {
    /// The rule.
    rule: AlarmRule,
    /// The channel; the one that speaks for the asset where not given.
    #[serde(default)]
    channel: Option<String>,
}

/// What a rule would have raised.
#[derive(Debug, Default, Serialize, utoipa::ToSchema)]
pub(super) struct AlarmTrial {
    /// The channel; none where the asset has no records.
    channel: Option<String>,
    /// Records that take part.
    records: u64,
    /// Of these, those with a value of what the rule watches.
    readings: u64,
    /// How often a warning would have been raised.
    warnings: u64,
    /// How often a danger would have been raised, out of nothing or out of a warning.
    dangers: u64,
    /// What would be raised after the latest record; none where nothing.
    severity: Option<Severity>,
    /// How often the alarm would have changed.
    changes_count: u64,
    /// The first 1000 changes.
    changes: Vec<TrialChange>,
}

/// A change that a rule would have made.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct TrialChange {
    /// The time of the record or of the maintenance.
    time: Timestamp,
    /// What is raised after it; none where nothing.
    severity: Option<Severity>,
    /// The reading, in the unit of what is watched; none where maintenance made the change.
    value: Option<f64>,
}

/// Try an alarm rule on the history
///
/// Nothing is stored. The rule is folded over the records of a channel and the maintenance between them as
/// alarms are; what people did to alarms does not count.
#[utoipa::path(
    post,
    path = "/v1/assets/{asset}/alarms/try",
    tag = "alarms",
    params(("asset" = AssetId, Path, description = "The asset")),
    request_body(content = TrialRequest),
    responses((status = 200, body = AlarmTrial)),
)]
pub(super) async fn try_rule(
    State(app): State<App>,
    AssetInPath(asset): AssetInPath,
    headers: HeaderMap,
    body: Body,
) -> Result<Json<AlarmTrial>, Problem> {
    let TrialRequest { rule, channel } = body::described(&app.limits, &headers, body).await?;
    rule.validate().map_err(|error| Problem::content("rule", error, "a rule as in the asset's alarms"))?;
    let of_one_channel = match rule.quantity {
        AlarmQuantity::StaleS => {
            Err("a quantity of records: time without one is told by the clock and cannot be tried")
        }
        AlarmQuantity::JointNovelty => Err("a quantity of one channel: all together cannot be tried"),
        _ => Ok(()),
    };
    of_one_channel.map_err(|expected| Problem::content("rule.quantity", &rule.quantity, expected))?;
    let (asset, channel) = assets::asset_and_channel(&app, &asset, channel.as_deref()).await?;
    let known = asset.spec.indicator_names();
    let is_unknown = |name: &&str| !known.iter().any(|known| known == name);
    if let Some(unknown) = rule.quantity.indicator().filter(is_unknown) {
        let nearest = Indicators::nearest(unknown, known.iter().map(String::as_str)).join(", ");
        let expected = format!("the name of an indicator; the nearest are {nearest}");
        return Err(Problem::content("rule.quantity.indicator", format!("{unknown:?}"), &expected));
    }
    let Some(channel) = channel else {
        return Ok(Json(AlarmTrial::default()));
    };
    let events = app.service.store.maintenance(&asset.spec.id).await?;
    Ok(Json(fold(&app.service, &channel, rule, events).await?))
}

/// Where a trial stands between two pieces of a history.
struct Fold {
    rules: [AlarmRule; 1],
    panel: AlarmPanel,
    events: Arc<[MaintenanceEvent]>,
    /// Events that have been taken.
    taken: usize,
    trial: AlarmTrial,
}

async fn fold(
    service: &Service,
    channel: &ChannelSummary,
    rule: AlarmRule,
    events: Vec<MaintenanceEvent>,
) -> Result<AlarmTrial, Problem> {
    let rules = [rule];
    let mut fold = Fold {
        panel: AlarmPanel::of(&rules),
        rules,
        events: events.into(),
        taken: 0,
        trial: AlarmTrial { channel: Some(channel.channel.clone()), ..AlarmTrial::default() },
    };
    let mut after = None;
    loop {
        let results = service.store.record_results(channel, after.as_ref(), AT_ONCE).await?;
        let Some(last) = results.last() else { break };
        after = Some(last.key.clone());
        let judge = move || {
            results.iter().for_each(|results| fold.take(results));
            fold
        };
        fold = service.workers.run("try an alarm rule", judge).await?;
    }
    fold.trial.severity = fold.panel.alarms().first().and_then(crate::estimate::Alarm::severity);
    Ok(fold.trial)
}

impl Fold {
    fn take(&mut self, results: &RecordResults) {
        let time = results.key.start_time;
        // An event counts before a record of the same time.
        while let Some(event) = self.events.get(self.taken).filter(|event| event.time <= time) {
            self.taken += 1;
            for (_, change) in self.panel.maintenance(&self.rules, event) {
                self.trial.note(change.time, change.severity, None, None);
            }
        }
        if results.excluded {
            return;
        }
        let [own, run] = &results.indicators;
        let before = self.panel.alarms().first().and_then(crate::estimate::Alarm::severity);
        self.trial.records += 1;
        self.trial.readings += u64::from(self.rules[0].quantity.value(&results.wear, [own, run]).is_some());
        for (_, change) in self.panel.reading(&self.rules, time, &results.wear, [own, run]) {
            self.trial.note(time, change.severity, before, change.value);
        }
    }
}

impl AlarmTrial {
    fn note(
        &mut self,
        time: Timestamp,
        severity: Option<Severity>,
        before: Option<Severity>,
        value: Option<f64>,
    ) {
        self.changes_count += 1;
        match severity {
            Some(Severity::Warning) if severity > before => self.warnings += 1,
            Some(Severity::Danger) => self.dangers += 1,
            _ => {}
        }
        if self.changes.len() < MAX_CHANGES {
            self.changes.push(TrialChange { time, severity, value });
        }
    }
}
