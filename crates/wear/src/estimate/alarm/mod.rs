//! Alarms: rules over readings, and the states an alarm goes through.
//!
//! An [`Alarm`] is a pure fold over readings, maintenance events and users' actions in time order; an
//! [`AlarmPanel`] has one alarm for each rule of a measuring channel. After a late record the fold is
//! repeated, as for estimates; actions keep their place among the readings.
//!
//! A level is entered when N of the last M readings lie beyond it. It is left when N of the last M lie on the
//! good side of its clear level, so a value that wanders around a level changes nothing. Missing records are
//! no readings; the caller, who has a clock, reports them as an action.

mod change;
mod error;
mod panel;
mod quantity;
mod rate;
mod rule;
mod severity;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use self::rate::RateWindow;
use super::event::MaintenanceEvent;

pub use change::{ActionTaken, AlarmAction, AlarmChange, AlarmReading, AlarmState};
pub use error::AlarmError;
pub use panel::{AlarmPanel, PanelAction, PanelChange};
pub use quantity::{AlarmQuantity, RatedQuantity};
pub use rule::{AlarmRule, AlarmSettings};
pub use severity::Severity;

/// The alarm of one rule. A copy through JSON continues with the same results.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Alarm {
    /// The raised severity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    raised: Option<Severity>,
    /// Time since which the alarm is raised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    raised_at: Option<Timestamp>,
    acknowledged: bool,
    /// Whether it was raised after the last acknowledgement.
    outstanding: bool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    shelved_until: Option<Timestamp>,
    /// The latest readings, the newest at the back.
    recent: VecDeque<f64>,
    /// Readings from which a rate is measured.
    #[serde(default, skip_serializing_if = "RateWindow::is_empty")]
    rate: RateWindow,
    /// The reading that caused the latest change of severity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    value: Option<f64>,
    /// The latest change.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    last: Option<AlarmChange>,
}

impl Alarm {
    /// Returns the state at a time.
    pub fn state(&self, now: Timestamp) -> AlarmState {
        if self.shelved_until.is_some_and(|until| now < until) {
            return AlarmState::Shelved;
        }
        self.unshelved_state()
    }

    /// Returns the state regardless of shelving.
    pub fn unshelved_state(&self) -> AlarmState {
        match (self.raised, self.acknowledged, self.outstanding) {
            (Some(_), true, _) => AlarmState::Acknowledged,
            (Some(_), false, _) => AlarmState::Unacknowledged,
            (None, _, true) => AlarmState::ReturnedUnacknowledged,
            (None, _, false) => AlarmState::Normal,
        }
    }

    /// Returns the raised severity, shelved or not.
    pub fn severity(&self) -> Option<Severity> {
        self.raised
    }

    /// Returns the time since which the alarm is raised, at any severity.
    pub fn raised_at(&self) -> Option<Timestamp> {
        self.raised_at
    }

    /// Returns the time until which the alarm is shelved.
    pub fn shelved_until(&self) -> Option<Timestamp> {
        self.shelved_until
    }

    /// Returns the reading that caused the latest change of severity, in the unit of the quantity.
    pub fn value(&self) -> Option<f64> {
        self.value
    }

    /// Returns the latest change; `None` before the first one.
    pub fn last(&self) -> Option<&AlarmChange> {
        self.last.as_ref()
    }

    /// Adds a reading. Returns the change where it raised, worsened, eased or cleared the alarm.
    pub fn reading(&mut self, rule: &AlarmRule, reading: AlarmReading) -> Option<AlarmChange> {
        let value = reading.value.filter(|value| value.is_finite())?;
        let value = match rule.over_s {
            Some(over_s) => self.rate.update(over_s, reading.time, value)?,
            None => value,
        };
        let AlarmSettings { raise_of, clear_of, .. } = rule.settings;
        self.recent.push_back(value);
        while self.recent.len() > raise_of.max(clear_of) as usize {
            self.recent.pop_front();
        }
        let severity = [Severity::Danger, Severity::Warning]
            .into_iter()
            .find(|&severity| self.calls_for(rule, severity));
        if severity == self.raised {
            return None;
        }
        self.set_severity(severity, reading.time);
        self.value = Some(value);
        Some(self.record_change(reading.time, |change| change.value = Some(value)))
    }

    /// Returns the severity after further readings of a rule, in order, without changing the alarm.
    pub fn severity_after(&self, rule: &AlarmRule, readings: &[AlarmReading]) -> Option<Severity> {
        let mut alarm = Self { raised: self.raised, ..Self::default() };
        for reading in readings {
            alarm.reading(rule, *reading);
        }
        alarm.raised
    }

    /// Clears an alarm on missing records as a record arrives. Returns the change where it was raised.
    pub fn record_arrived(&mut self, time: Timestamp) -> Option<AlarmChange> {
        self.raised?;
        self.set_severity(None, time);
        self.value = Some(0.0);
        Some(self.record_change(time, |change| change.value = Some(0.0)))
    }

    /// Discards the readings from which a rate is measured.
    pub(crate) fn clear_rate(&mut self) {
        self.rate.clear();
    }

    fn set_severity(&mut self, severity: Option<Severity>, time: Timestamp) {
        let before = std::mem::replace(&mut self.raised, severity);
        // A higher severity has to be acknowledged again, a lower one does not.
        if severity > before {
            self.acknowledged = false;
            self.outstanding = true;
            self.raised_at.get_or_insert(time);
        }
        if severity.is_none() {
            self.close();
        }
    }

    /// Applies an action and returns the change. An action that is no longer possible, because late records
    /// changed the alarm, is recorded without effect.
    pub fn act(&mut self, taken: &ActionTaken) -> AlarmChange {
        if self.check(taken.time, &taken.action).is_ok() {
            match taken.action {
                AlarmAction::Acknowledge if self.raised <= taken.seen => {
                    self.acknowledged = self.raised.is_some();
                    self.outstanding = false;
                }
                AlarmAction::Shelve { until } => self.shelved_until = Some(until),
                AlarmAction::Unshelve | AlarmAction::ShelvingOver => self.shelved_until = None,
                AlarmAction::Stale { .. } | AlarmAction::Joint { .. } => {
                    let (severity, value) = taken.action.automatic_reading().unzip();
                    self.set_severity(severity.flatten(), taken.time);
                    self.value = value;
                }
                AlarmAction::Acknowledge | AlarmAction::Comment => {}
            }
        }
        self.record_change(taken.time, |change| {
            change.value = taken.action.automatic_reading().map(|(_, value)| value);
            change.action = Some(taken.action.clone());
            change.by.clone_from(&taken.by);
            change.comment.clone_from(&taken.comment);
        })
    }

    /// Checks whether an action is possible.
    ///
    /// # Errors
    /// [`AlarmError::State`] where there is nothing to acknowledge, nothing is shelved, or a shelving would
    /// have expired already.
    pub fn check(&self, time: Timestamp, action: &AlarmAction) -> Result<(), AlarmError> {
        let state = self.state(time);
        let is_open = self.outstanding && !self.acknowledged;
        match action {
            AlarmAction::Acknowledge if !is_open => {
                Err(AlarmError::State { state, expected: "unacknowledged or returned_unacknowledged" })
            }
            AlarmAction::Shelve { until } if *until <= time => {
                Err(AlarmError::State { state, expected: "a shelving until a future time" })
            }
            AlarmAction::Unshelve if state != AlarmState::Shelved => {
                Err(AlarmError::State { state, expected: "shelved" })
            }
            AlarmAction::ShelvingOver if self.shelved_until.is_none_or(|until| until > time) => {
                Err(AlarmError::State { state, expected: "an expired shelving" })
            }
            AlarmAction::Stale { severity, .. } | AlarmAction::Joint { severity, .. }
                if *severity == self.raised =>
            {
                Err(AlarmError::State { state, expected: "a different severity" })
            }
            _ => Ok(()),
        }
    }

    /// Discards the readings, as of another gear or sensor. Returns the change where the alarm was raised.
    pub fn reset(&mut self, event: &MaintenanceEvent) -> Option<AlarmChange> {
        self.recent.clear();
        self.rate.clear();
        self.raised.take()?;
        self.close();
        Some(self.record_change(event.time, |change| change.maintenance = Some(event.kind)))
    }

    fn close(&mut self) {
        self.outstanding = self.outstanding && !self.acknowledged;
        self.acknowledged = false;
        self.raised_at = None;
    }

    /// Whether the latest readings call for a severity: N of M lie beyond it on one side, or it is raised
    /// already and not cleared by N of M on the good side of all its levels.
    fn calls_for(&self, rule: &AlarmRule, severity: Severity) -> bool {
        let (above, below) = (rule.above(severity), rule.below(severity));
        if above.is_none() && below.is_none() {
            return false;
        }
        let AlarmSettings { raise, raise_of, clear, clear_of } = rule.settings;
        let count = |of: u32, holds: &dyn Fn(f64) -> bool| {
            self.recent.iter().rev().take(of as usize).filter(|value| holds(**value)).count()
        };
        if self.raised >= Some(severity) {
            let is_good = |value: f64| {
                above.is_none_or(|level| value < level - rule.hysteresis)
                    && below.is_none_or(|level| value > level + rule.hysteresis)
            };
            count(clear_of, &is_good) < clear as usize
        } else {
            let is_beyond = |holds: &dyn Fn(f64) -> bool| count(raise_of, holds) >= raise as usize;
            above.is_some_and(|level| is_beyond(&|value| value > level))
                || below.is_some_and(|level| is_beyond(&|value| value < level))
        }
    }

    fn record_change(&mut self, time: Timestamp, fill: impl FnOnce(&mut AlarmChange)) -> AlarmChange {
        let mut change = AlarmChange {
            time,
            state: self.state(time),
            severity: self.raised,
            value: None,
            action: None,
            maintenance: None,
            by: String::new(),
            comment: String::new(),
        };
        fill(&mut change);
        self.last = Some(change.clone());
        change
    }
}
