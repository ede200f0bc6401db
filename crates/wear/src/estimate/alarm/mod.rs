//! Alarms: rules over readings, and the states an alarm goes through.
//!
//! Pure: an [`Alarm`] is a fold over readings, maintenance events and people's actions in the order of time;
//! an [`AlarmPanel`] is one for each rule of a measuring channel. Late records fold again like estimates do:
//! actions keep their place among the readings.
//!
//! A level is entered when N of the last M readings lie beyond it, and left when N of the last M lie on the
//! good side of its clear level: a value that wanders around one level changes nothing. That no record comes
//! is no reading: whoever has a clock tells of it as of an action.

mod change;
mod error;
mod panel;
mod quantity;
mod rate;
mod rule;
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
pub use rule::{AlarmRule, AlarmSettings, Severity};

/// One rule's alarm; an exact copy in JSON goes on the same.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Alarm {
    /// The severity that the readings call for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    raised: Option<Severity>,
    /// Since when something is raised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    raised_at: Option<Timestamp>,
    acknowledged: bool,
    /// Raised or returned since somebody acknowledged last.
    outstanding: bool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    shelved_until: Option<Timestamp>,
    /// The latest readings, the last one at the back.
    recent: VecDeque<f64>,
    /// What a rate is measured from.
    #[serde(default, skip_serializing_if = "RateWindow::is_empty")]
    rate: RateWindow,
    /// The reading of the latest change that a reading made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    value: Option<f64>,
    /// The latest change.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    last: Option<AlarmChange>,
}

impl Alarm {
    /// Where it stands at a time.
    pub fn state(&self, now: Timestamp) -> AlarmState {
        if self.shelved_until.is_some_and(|until| now < until) {
            return AlarmState::Shelved;
        }
        self.unshelved_state()
    }

    /// Where it stands apart from being put aside.
    pub fn unshelved_state(&self) -> AlarmState {
        match (self.raised, self.acknowledged, self.outstanding) {
            (Some(_), true, _) => AlarmState::Acknowledged,
            (Some(_), false, _) => AlarmState::Unacknowledged,
            (None, _, true) => AlarmState::ReturnedUnacknowledged,
            (None, _, false) => AlarmState::Normal,
        }
    }

    /// The severity that is raised, shelved or not.
    pub fn severity(&self) -> Option<Severity> {
        self.raised
    }

    /// Since when something is raised, whatever its severity.
    pub fn raised_at(&self) -> Option<Timestamp> {
        self.raised_at
    }

    /// Until when it is put aside.
    pub fn shelved_until(&self) -> Option<Timestamp> {
        self.shelved_until
    }

    /// The reading of the latest change that a reading made, in the unit of the quantity.
    pub fn value(&self) -> Option<f64> {
        self.value
    }

    /// The latest change; none where nothing ever happened.
    pub fn last(&self) -> Option<&AlarmChange> {
        self.last.as_ref()
    }

    /// Takes a reading; the change where it raised, worsened, eased or cleared the alarm.
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

    /// The severity that these latest readings of a rule call for, in order, as it stands before them; the
    /// alarm stays as it is.
    pub fn severity_after(&self, rule: &AlarmRule, readings: &[AlarmReading]) -> Option<Severity> {
        let mut alarm = Self { raised: self.raised, ..Self::default() };
        for reading in readings {
            alarm.reading(rule, *reading);
        }
        alarm.raised
    }

    /// Takes that a record came, where its absence is what is watched; the change where that was raised.
    pub fn record_arrived(&mut self, time: Timestamp) -> Option<AlarmChange> {
        self.raised?;
        self.set_severity(None, time);
        self.value = Some(0.0);
        Some(self.record_change(time, |change| change.value = Some(0.0)))
    }

    /// Forgets what a rate is measured from.
    pub(crate) fn clear_rate(&mut self) {
        self.rate.clear();
    }

    fn set_severity(&mut self, severity: Option<Severity>, time: Timestamp) {
        let before = std::mem::replace(&mut self.raised, severity);
        // What is worse than before has to be acknowledged again; what is less bad does not.
        if severity > before {
            self.acknowledged = false;
            self.outstanding = true;
            self.raised_at.get_or_insert(time);
        }
        if severity.is_none() {
            self.close();
        }
    }

    /// Takes what a person did. What cannot be done any more, because records that came late changed the
    /// alarm, leaves it as it is.
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

    /// Whether an action can be done.
    ///
    /// # Errors
    /// [`AlarmError::State`] where there is nothing to acknowledge or nothing shelved, or a shelving would be
    /// over already.
    pub fn check(&self, time: Timestamp, action: &AlarmAction) -> Result<(), AlarmError> {
        let state = self.state(time);
        let is_open = self.outstanding && !self.acknowledged;
        match action {
            AlarmAction::Acknowledge if !is_open => {
                Err(AlarmError::State { state, expected: "unacknowledged or returned_unacknowledged" })
            }
            AlarmAction::Shelve { until } if *until <= time => {
                Err(AlarmError::State { state, expected: "shelving until a later time" })
            }
            AlarmAction::Unshelve if state != AlarmState::Shelved => {
                Err(AlarmError::State { state, expected: "shelved" })
            }
            AlarmAction::ShelvingOver if self.shelved_until.is_none_or(|until| until > time) => {
                Err(AlarmError::State { state, expected: "a shelving that is over" })
            }
            AlarmAction::Stale { severity, .. } | AlarmAction::Joint { severity, .. }
                if *severity == self.raised =>
            {
                Err(AlarmError::State { state, expected: "another severity" })
            }
            _ => Ok(()),
        }
    }

    /// Forgets the readings, since those to come are of another gear or sensor; the change where something
    /// was raised.
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

    /// Whether the latest readings call for a severity: raised by N of M beyond it on one side, or raised
    /// before and not cleared by N of M on the good side of all its levels.
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
