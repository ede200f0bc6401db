//! `/v1/assets/{asset}/alarms/try`: the alarms that a rule would have raised on existing records.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::asset::AssetError;
use crate::estimate::{AlarmPanel, AlarmQuantity, AlarmRule, MaintenanceEvent, Severity};
use crate::http::app::App;
use crate::http::assets;
use crate::http::problem::Problem;
use crate::http::request::body::JsonBody;
use crate::http::request::query::AssetPath;
use crate::service::Service;
use crate::store::{ChannelSummary, RecordResults};

/// Records read and evaluated at a time.
const RECORDS_PER_BATCH: u32 = 2000;

/// Maximum number of listed changes; further ones are only counted.
const MAX_CHANGES: usize = 1000;

/// A rule to try.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct TrialRequest {
    /// The rule.
    rule: AlarmRule,
    /// The channel; by default the one that represents the asset.
    #[serde(default)]
    channel: Option<String>,
}

/// What a rule would have raised.
#[derive(Debug, Default, Serialize, utoipa::ToSchema)]
pub(crate) struct AlarmTrial {
    /// The channel; none if the asset has no records.
    channel: Option<String>,
    /// Number of records evaluated.
    records: u64,
    /// Number of these that have a value of the watched quantity.
    readings: u64,
    /// Number of warnings that would have been raised.
    warnings: u64,
    /// Number of danger alarms that would have been raised, including those raised from warning.
    dangers: u64,
    /// Severity after the latest record; none if nothing is raised.
    severity: Option<Severity>,
    /// Number of changes of the alarm.
    changes_count: u64,
    /// The first 1000 changes.
    changes: Vec<TrialChange>,
}

/// A change that a rule would have made.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct TrialChange {
    /// The time of the record or maintenance event.
    time: Timestamp,
    /// Severity after it; none if nothing is raised.
    severity: Option<Severity>,
    /// The reading in the unit of the watched quantity; none if maintenance caused the change.
    value: Option<f64>,
}

/// Try an alarm rule on the history
///
/// Nothing is stored. The rule is evaluated over the records of a channel and the maintenance events between
/// them, as for real alarms, but without operator actions.
#[utoipa::path(
    post,
    path = "/v1/assets/{asset}/alarms/try",
    tag = "alarms",
    request_body(content = TrialRequest),
    responses((status = 200, body = AlarmTrial)),
)]
pub(crate) async fn try_rule(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    JsonBody(TrialRequest { rule, channel }): JsonBody<TrialRequest>,
) -> Result<Json<AlarmTrial>, Problem> {
    let of_one_channel = match rule.quantity {
        AlarmQuantity::StaleS => {
            Err("a quantity of records: time without a record depends on the clock and cannot be tried")
        }
        AlarmQuantity::JointNovelty => Err("a quantity of one channel: joint quantities cannot be tried"),
        _ => Ok(()),
    };
    of_one_channel.map_err(|expected| Problem::content("rule.quantity", &rule.quantity, expected))?;
    let (asset, channel) = assets::asset_and_channel(&app, &asset, channel.as_deref()).await?;
    asset.spec.check_rule(&rule).map_err(|error| match error {
        AssetError::Field { field, value, expected } => {
            Problem::content(&field.replacen("alarms", "rule", 1), value, &expected)
        }
        error => error.into(),
    })?;
    let Some(channel) = channel else {
        return Ok(Json(AlarmTrial::default()));
    };
    let events = app.service.store.maintenance(&asset.spec.id).await?;
    Ok(Json(fold(&app.service, &channel, rule, events).await?))
}

/// The state of a trial between two batches of records.
struct Fold {
    rules: [AlarmRule; 1],
    panel: AlarmPanel,
    events: Arc<[MaintenanceEvent]>,
    /// Number of events consumed.
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
        let results = service.store.record_results(channel, after.as_ref(), RECORDS_PER_BATCH).await?;
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
        // An event precedes a record of the same time.
        while let Some(event) = self.events.get(self.taken).filter(|event| event.time <= time) {
            self.taken += 1;
            for (_, change) in self.panel.maintenance(&self.rules, event) {
                self.trial.add_change(change.time, change.severity, None, None);
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
            self.trial.add_change(time, change.severity, before, change.value);
        }
    }
}

impl AlarmTrial {
    fn add_change(
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
