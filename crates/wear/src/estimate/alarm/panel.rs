//! All alarms of a measuring channel.

use serde::{Deserialize, Serialize};

use super::{ActionTaken, Alarm, AlarmChange, AlarmQuantity, AlarmReading, AlarmRule};
use crate::estimate::{MaintenanceEvent, WearEstimate};
use flankwatch_signal::Indicators;
use jiff::Timestamp;

/// The alarms of a channel in the order of the rules. A copy through JSON continues with the same results.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AlarmPanel {
    pub(super) alarms: Vec<Alarm>,
}

/// An action on the alarm of a quantity.
#[derive(Debug, Clone, PartialEq)]
pub struct PanelAction {
    /// The quantity that the alarm's rule watches.
    pub quantity: AlarmQuantity,
    /// The action.
    pub taken: ActionTaken,
}

/// A change of one of the alarms: the position of its rule, and the change.
pub type PanelChange = (usize, AlarmChange);

impl AlarmPanel {
    /// Creates the alarms before the first record.
    pub fn of(rules: &[AlarmRule]) -> Self {
        Self { alarms: vec![Alarm::default(); rules.len()] }
    }

    /// Returns the alarms in the order of the rules.
    pub fn alarms(&self) -> &[Alarm] {
        &self.alarms
    }

    /// Adds a record's results; `indicators` are those of the record and those of the run up to it.
    pub fn reading(
        &mut self,
        rules: &[AlarmRule],
        time: Timestamp,
        wear: &WearEstimate,
        indicators: [&Indicators; 2],
    ) -> Vec<PanelChange> {
        let each = self.alarms.iter_mut().zip(rules).enumerate();
        let changes = each.filter_map(|(n, (alarm, rule))| {
            let value = rule.quantity.value(wear, indicators);
            let change = match rule.quantity {
                AlarmQuantity::StaleS => alarm.record_arrived(time),
                _ => alarm.reading(rule, AlarmReading { time, value }),
            };
            Some((n, change?))
        });
        changes.collect()
    }

    /// Applies an action; `None` where no rule watches its quantity any more.
    pub fn act(&mut self, rules: &[AlarmRule], action: &PanelAction) -> Option<PanelChange> {
        let n = rules.iter().position(|rule| rule.quantity == action.quantity)?;
        Some((n, self.alarms.get_mut(n)?.act(&action.taken)))
    }

    /// Applies a maintenance event.
    pub fn maintenance(&mut self, rules: &[AlarmRule], event: &MaintenanceEvent) -> Vec<PanelChange> {
        for (alarm, rule) in self.alarms.iter_mut().zip(rules) {
            // The step to a depth that was measured is not growth.
            if rule.quantity.is_wear() {
                alarm.clear_rate();
            }
        }
        let each = self.alarms.iter_mut().zip(rules).enumerate();
        let resets = each.filter(|(_, (_, rule))| rule.quantity.is_reset_by(event.kind));
        resets.filter_map(|(n, (alarm, _))| Some((n, alarm.reset(event)?))).collect()
    }
}
