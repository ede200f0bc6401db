//! Alarms on the novelty of all channels together. The history of one channel does not know the others, so
//! it is looked for as records come.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use super::alarms::{Alarms, OperatorAction};
use super::error::ServiceError;
use super::joint_wear::JointWear;
use crate::asset::AssetId;
use crate::estimate::{AlarmAction, AlarmQuantity, MaintenanceKind};
use crate::store::{DescriptionsMark, StoredAlarm};

/// How often it is looked for.
const INTERVAL: Duration = Duration::from_secs(2);

/// What has been looked at.
#[derive(Default)]
struct LookedAt {
    descriptions: Option<DescriptionsMark>,
    /// The revisions of assets' channels.
    revisions: HashMap<AssetId, i64>,
}

impl Alarms {
    /// Raises and ends these alarms in the background, as long as somebody holds the service.
    pub(crate) fn watch_joint_novelty_in_background(self: &Arc<Self>) {
        let alarms = Arc::downgrade(self);
        tokio::spawn(async move {
            let mut looked_at = LookedAt::default();
            loop {
                tokio::time::sleep(INTERVAL).await;
                let Some(alarms) = alarms.upgrade() else { return };
                if alarms.store.is_closed() {
                    return;
                }
                if let Err(error) = alarms.watch_joint_novelty(&mut looked_at).await {
                    tracing::warn!(%error, "failed to look for novelty of all channels together");
                }
            }
        });
    }

    async fn watch_joint_novelty(&self, looked_at: &mut LookedAt) -> Result<(), ServiceError> {
        let mark = self.store.descriptions_mark().await?;
        if looked_at.descriptions != Some(mark) {
            *looked_at = LookedAt { descriptions: Some(mark), ..LookedAt::default() };
        }
        for (asset, revision) in self.store.revisions_of_several_channels().await? {
            if looked_at.revisions.get(&asset) != Some(&revision) {
                self.tell_joint_novelty(&asset).await?;
                looked_at.revisions.insert(asset, revision);
            }
        }
        Ok(())
    }

    /// Brings the alarm of an asset in line with what its channels say together. It is kept with the channel
    /// that was seen first.
    async fn tell_joint_novelty(&self, asset: &AssetId) -> Result<(), ServiceError> {
        let store = &self.store;
        let asset = store.asset(asset).await?;
        let mut rules = asset.spec.alarm_rules().into_iter();
        let Some(rule) = rules.find(|rule| rule.quantity == AlarmQuantity::JointNovelty) else {
            return Ok(());
        };
        let channels = store.channels(&asset.spec.id).await?;
        let speakers = JointWear::speakers(&asset, &channels);
        let [first, _, ..] = speakers[..] else { return Ok(()) };
        // What was read before another gear, sensor or baseline says nothing of now.
        let events = store.maintenance(&asset.spec.id).await?;
        let begun = events.iter().rfind(|event| event.kind != MaintenanceKind::Inspected);
        let count = rule.settings.raise_of.max(rule.settings.clear_of);
        let readings = JointWear::novelty(store, &speakers, begun.map(|event| event.time), count).await?;
        let Some(value) = readings.last().and_then(|reading| reading.value) else {
            return Ok(());
        };
        let untouched = StoredAlarm::untouched(first, &rule, self.clock.now());
        let known = store.alarm(&untouched.id).await?.unwrap_or(untouched);
        let severity = known.alarm.severity_after(&rule, &readings);
        if severity == known.alarm.severity() {
            return Ok(());
        }
        let told = OperatorAction {
            action: AlarmAction::Joint { severity, value },
            by: String::new(),
            comment: String::new(),
        };
        match self.act_on(known, Some(first), told).await {
            // Somebody was faster: another process, or a record.
            Ok(_) | Err(ServiceError::Alarm(_) | ServiceError::AlarmUnknown(_)) => Ok(()),
            Err(error) => Err(error),
        }
    }
}
