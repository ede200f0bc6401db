//! Alarms on the joint novelty of all channels of an asset. The history of one channel does not contain the
//! others, so these alarms are checked periodically.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use super::alarms::Alarms;
use super::error::ServiceError;
use super::joint_wear::JointWear;
use crate::asset::AssetId;
use crate::estimate::{AlarmAction, AlarmQuantity, MaintenanceKind};
use crate::store::{DescriptionsMark, StoreError, StoredAlarm};

/// Time between two checks.
const INTERVAL: Duration = Duration::from_secs(2);

/// The state at the last check.
#[derive(Default)]
struct CheckedState {
    descriptions: Option<DescriptionsMark>,
    /// The sum of the channel revisions of each asset.
    revisions: HashMap<AssetId, i64>,
}

impl Alarms {
    /// Raises and clears these alarms in the background for as long as the service exists.
    pub(crate) fn watch_joint_novelty_in_background(self: &Arc<Self>) {
        let checked = Arc::new(tokio::sync::Mutex::<CheckedState>::default());
        self.every(INTERVAL, "check the joint novelty of all channels", move |alarms| {
            let checked = Arc::clone(&checked);
            async move { alarms.watch_joint_novelty(&mut *checked.lock().await).await }
        });
    }

    async fn watch_joint_novelty(&self, checked: &mut CheckedState) -> Result<(), ServiceError> {
        let mark = self.store.descriptions_mark().await?;
        if checked.descriptions != Some(mark) {
            *checked = CheckedState { descriptions: Some(mark), ..CheckedState::default() };
        }
        let mut result = Ok(());
        for (asset, revision) in self.store.revisions_with_joint_novelty().await? {
            if checked.revisions.get(&asset) == Some(&revision) {
                continue;
            }
            match self.update_joint_novelty_alarm(&asset).await {
                Ok(()) => drop(checked.revisions.insert(asset, revision)),
                // The others are checked all the same; the next round tries this one again.
                Err(error) => result = result.and(Err(error)),
            }
        }
        result
    }

    /// Updates the alarm of an asset to the joint novelty of its channels. The alarm belongs to the first
    /// channel.
    async fn update_joint_novelty_alarm(&self, asset: &AssetId) -> Result<(), ServiceError> {
        let store = &self.store;
        let asset = match store.asset(asset).await {
            Err(StoreError::AssetUnknown(_)) => return Ok(()),
            asset => asset?,
        };
        let mut rules = asset.spec.alarm_rules().into_iter();
        let Some(rule) = rules.find(|rule| rule.quantity == AlarmQuantity::JointNovelty) else {
            return Ok(());
        };
        let channels = store.channels(&asset.spec.id).await?;
        let channels = JointWear::contributing_channels(&asset, &channels);
        let [first, _, ..] = channels[..] else {
            return self.clear_joint_novelty_alarm(&asset.spec.id).await;
        };
        // Readings from before a change of the gear, sensor or baseline do not count.
        let events = store.maintenance(&asset.spec.id).await?;
        let begun = events.iter().rfind(|event| event.kind != MaintenanceKind::Inspected);
        let count = rule.settings.raise_of.max(rule.settings.clear_of);
        let readings = JointWear::novelty(store, &channels, begun.map(|event| event.time), count).await?;
        let Some(value) = readings.last().and_then(|reading| reading.value) else {
            return Ok(());
        };
        let untouched = StoredAlarm::untouched(first, &rule, self.clock.now());
        let known = store.alarm(&untouched.id).await?.unwrap_or(untouched);
        let severity = known.alarm.severity_after(&rule, &readings);
        if severity == known.alarm.severity() {
            return Ok(());
        }
        self.act_automatically(known, Some(first), AlarmAction::Joint { severity, value }).await
    }

    /// Clears the alarm of an asset that has fewer than two contributing channels left.
    async fn clear_joint_novelty_alarm(&self, asset: &AssetId) -> Result<(), ServiceError> {
        for stored in self.store.open_alarms(&[asset]).await? {
            if stored.quantity == AlarmQuantity::JointNovelty && stored.alarm.severity().is_some() {
                let cleared = AlarmAction::Joint { severity: None, value: 0.0 };
                self.act_automatically(stored, None, cleared).await?;
            }
        }
        Ok(())
    }
}
