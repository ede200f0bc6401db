//! Alarms on silent channels. A missing record triggers no event, so these alarms are checked periodically.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use super::alarms::Alarms;
use super::error::ServiceError;
use crate::asset::AssetId;
use crate::estimate::{AlarmAction, AlarmQuantity, AlarmRule, Severity};
use crate::store::{DescriptionsMark, Silence, StoredAlarm};

/// Time between two checks.
const INTERVAL: Duration = Duration::from_secs(2);

/// The silence rules, and the mark of the descriptions from which they were read.
#[derive(Default)]
struct Rules {
    read_at: Option<DescriptionsMark>,
    rules: HashMap<AssetId, AlarmRule>,
}

impl Alarms {
    /// Raises and clears silence alarms in the background for as long as the service exists.
    pub(crate) fn watch_silence_in_background(self: &Arc<Self>) {
        let rules = Arc::new(tokio::sync::Mutex::<Rules>::default());
        self.every(INTERVAL, "check for silent channels", move |alarms| {
            let rules = Arc::clone(&rules);
            async move { alarms.watch_silence(&mut *rules.lock().await).await }
        });
    }

    async fn watch_silence(&self, known: &mut Rules) -> Result<(), ServiceError> {
        let mark = self.store.descriptions_mark().await?;
        if known.read_at != Some(mark) {
            let assets = self.store.assets_with_rules_on_silence().await?;
            let rules = assets.into_iter().filter_map(|asset| {
                let rules = asset.spec.alarm_rules();
                let on_silence = rules.into_iter().find(|rule| rule.quantity == AlarmQuantity::StaleS);
                Some((asset.spec.id, on_silence?))
            });
            known.rules = rules.collect();
            known.read_at = Some(mark);
        }
        let assets: Vec<&AssetId> = known.rules.keys().collect();
        let raised: HashMap<String, Option<Severity>> = self
            .store
            .open_alarms(&assets)
            .await?
            .into_iter()
            .map(|stored| (stored.id, stored.alarm.severity()))
            .collect();
        let now = self.clock.now();
        let mut result = Ok(());
        for silence in self.store.silences(&assets).await? {
            let Some(rule) = known.rules.get(&silence.channel.asset_id) else {
                continue;
            };
            let silent_s = now.duration_since(silence.since).as_secs_f64().max(0.0);
            let severity = rule.severity_of_silence(silent_s);
            let untouched = StoredAlarm::untouched(&silence.channel, rule, now);
            if raised.get(&untouched.id).copied().flatten() != severity {
                // The others are checked also after an error; the next round tries this one again.
                let updated = self.update_silence_alarm(untouched, &silence, severity, silent_s).await;
                result = result.and(updated);
            }
        }
        result
    }

    /// Updates an alarm to the time for which its channel has been silent.
    async fn update_silence_alarm(
        &self,
        known: StoredAlarm,
        silence: &Silence,
        severity: Option<Severity>,
        silent_s: f64,
    ) -> Result<(), ServiceError> {
        let action = AlarmAction::Stale { severity, silent_s: silent_s as u64 };
        self.act_automatically(known, Some(&silence.channel), action).await
    }
}
