//! Alarms: rules over readings, and the states an alarm goes through.
//!
//! Pure: an [`Alarm`] is a fold over readings and people's actions in time order. To use it: keep one `Alarm` for each [`AlarmRule`] of a
//! measuring channel; after each record call [`Alarm::reading`] with the rule's value ([`AlarmQuantity`] says which); call [`Alarm::act`] for
//! what people do; store and announce the [`AlarmChange`] that either returns. Late records fold again like estimates do: actions carry
//! their times, so readings and actions are merged by time.
//!
//! A level is entered when N of the last M readings lie above it, and left when N of the last M lie below its clear level: a value that
//! wanders around one level changes nothing.

use std::collections::VecDeque;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// What a rule watches.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AlarmQuantity {
    /// The median wear depth in µm.
    WearUm,
    /// The probability that wear has passed the asset's limit, 0 to 1.
    WearAboveLimit,
    /// The novelty score: −log₁₀ of the p-value.
    Novelty,
    /// A condition indicator by name, in its own unit.
    Indicator(String),
}

/// How bad it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Look at it.
    Warning,
    /// Act now.
    Danger,
}

/// When an alarm is raised and cleared.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AlarmRule {
    /// What is watched.
    pub quantity: AlarmQuantity,
    /// A reading above this warns.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warning: Option<f64>,
    /// A reading above this is dangerous.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub danger: Option<f64>,
    /// How far below its level a reading has to lie to clear it.
    #[serde(default)]
    pub hysteresis: f64,
    /// How many of the last readings decide.
    #[serde(default)]
    pub settings: AlarmSettings,
}

/// N of M, for raising and for clearing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AlarmSettings {
    /// So many ...
    pub raise: u32,
    /// ... of the last so many readings above a level raise it.
    pub raise_of: u32,
    /// So many ...
    pub clear: u32,
    /// ... of the last so many readings below its clear level clear it.
    pub clear_of: u32,
}

impl Default for AlarmSettings {
    fn default() -> Self {
        Self {
            raise: 3,
            raise_of: 5,
            clear: 5,
            clear_of: 5,
        }
    }
}

/// The most readings that a rule may look back on.
const MOST_READINGS: u32 = 1000;

/// Entries of an alarm's history that are kept.
const MOST_CHANGES: usize = 500;

/// Why a rule cannot be used or an action not be done.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum AlarmError {
    /// A number of the rule.
    #[error("{field} is {value}, expected {expected}")]
    Field {
        /// Which number.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would have been right.
        expected: &'static str,
    },
    /// Neither level is given.
    #[error("the alarm has neither a warning nor a danger level, expected at least one")]
    NoLevel,
    /// The alarm is in a state in which this cannot be done.
    #[error("the alarm is {state:?}, expected {expected}")]
    State {
        /// Its state.
        state: AlarmState,
        /// The states that would have been right.
        expected: &'static str,
    },
}

impl AlarmRule {
    /// Whether every number can be used.
    ///
    /// # Errors
    /// The first one that cannot, with what was expected.
    pub fn validate(&self) -> Result<(), AlarmError> {
        let refuse = |field, value, expected| Err(AlarmError::Field { field, value, expected });
        for (field, level) in [("warning", self.warning), ("danger", self.danger)] {
            if let Some(value) = level.filter(|value| !value.is_finite()) {
                return refuse(field, value, "a finite number");
            }
        }
        match (self.warning, self.danger) {
            (None, None) => return Err(AlarmError::NoLevel),
            (Some(warning), Some(danger)) if danger <= warning => return refuse("danger", danger, "a level above the warning's"),
            _ => {}
        }
        if !(self.hysteresis >= 0.0 && self.hysteresis.is_finite()) {
            return refuse("hysteresis", self.hysteresis, "a finite number of at least 0");
        }
        let AlarmSettings {
            raise,
            raise_of,
            clear,
            clear_of,
        } = self.settings;
        for (field, some, of) in [("raise", raise, raise_of), ("clear", clear, clear_of)] {
            if some == 0 || some > of || of > MOST_READINGS {
                return refuse(
                    field,
                    f64::from(some),
                    "a number from 1 to that of the readings looked back on, at most 1000",
                );
            }
        }
        Ok(())
    }

    fn level(&self, severity: Severity) -> Option<f64> {
        match severity {
            Severity::Warning => self.warning,
            Severity::Danger => self.danger,
        }
    }
}

/// Where an alarm stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AlarmState {
    /// Nothing is the matter.
    Normal,
    /// Raised, and nobody has said that they know.
    Unacknowledged,
    /// Raised, and somebody knows.
    Acknowledged,
    /// It was raised and is over, and nobody has said that they know.
    ReturnedUnacknowledged,
    /// Put aside by somebody until a time.
    Shelved,
}

/// What a person does.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AlarmAction {
    /// They know.
    Acknowledge,
    /// They want to hear no more of it until a time.
    Shelve {
        /// Until when.
        until: Timestamp,
    },
    /// They want to hear of it again.
    Unshelve,
    /// They have something to say.
    Comment,
}

/// One reading of what a rule watches.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AlarmReading {
    /// When.
    pub time: Timestamp,
    /// The value; none where there is none (no wear is claimed, an indicator is absent), which neither raises nor clears.
    pub value: Option<f64>,
}

/// An entry of an alarm's history.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AlarmChange {
    /// When.
    pub time: Timestamp,
    /// The state after it.
    pub state: AlarmState,
    /// The severity after it; none where nothing is raised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub severity: Option<Severity>,
    /// The reading that caused it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<f64>,
    /// What a person did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<AlarmAction>,
    /// Who did it; empty where a reading caused it.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub by: String,
    /// What they said.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub comment: String,
}

/// One rule's alarm; an exact copy in JSON goes on the same.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Alarm {
    /// The severity that the readings call for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    raised: Option<Severity>,
    acknowledged: bool,
    /// Raised or returned since somebody acknowledged last.
    outstanding: bool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    shelved_until: Option<Timestamp>,
    /// The latest readings, the last one at the back.
    recent: VecDeque<f64>,
    history: Vec<AlarmChange>,
}

impl Alarm {
    /// Where it stands at a time.
    pub fn state(&self, now: Timestamp) -> AlarmState {
        if self.shelved_until.is_some_and(|until| now < until) {
            return AlarmState::Shelved;
        }
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

    /// What happened, oldest first; the latest 500 entries.
    pub fn history(&self) -> &[AlarmChange] {
        &self.history
    }

    /// Takes a reading; the change where it raised, worsened, eased or cleared the alarm.
    pub fn reading(&mut self, rule: &AlarmRule, reading: AlarmReading) -> Option<AlarmChange> {
        let value = reading.value.filter(|value| value.is_finite())?;
        let AlarmSettings { raise_of, clear_of, .. } = rule.settings;
        self.recent.push_back(value);
        while self.recent.len() > raise_of.max(clear_of) as usize {
            self.recent.pop_front();
        }
        let before = self.raised;
        self.raised = [Severity::Danger, Severity::Warning]
            .into_iter()
            .find(|&severity| self.calls_for(rule, severity));
        if self.raised == before {
            return None;
        }
        // What is worse than before has to be acknowledged again; what is less bad does not.
        if self.raised > before {
            self.acknowledged = false;
            self.outstanding = true;
        }
        if self.raised.is_none() {
            self.outstanding = self.outstanding && !self.acknowledged;
            self.acknowledged = false;
        }
        let change = AlarmChange {
            time: reading.time,
            state: self.state(reading.time),
            severity: self.raised,
            value: Some(value),
            action: None,
            by: String::new(),
            comment: String::new(),
        };
        Some(self.keep(change))
    }

    /// Takes what a person does.
    ///
    /// # Errors
    /// [`AlarmError::State`] where there is nothing to acknowledge or nothing shelved; nothing changes then.
    pub fn act(&mut self, time: Timestamp, action: AlarmAction, by: &str, comment: &str) -> Result<AlarmChange, AlarmError> {
        let state = self.state(time);
        let refuse = |expected| Err(AlarmError::State { state, expected });
        match &action {
            AlarmAction::Acknowledge => {
                let open = self.outstanding && !self.acknowledged;
                if !open {
                    return refuse("unacknowledged or returned_unacknowledged");
                }
                self.acknowledged = self.raised.is_some();
                self.outstanding = false;
            }
            AlarmAction::Shelve { until } => {
                if *until <= time {
                    return refuse("shelving until a later time");
                }
                self.shelved_until = Some(*until);
            }
            AlarmAction::Unshelve => {
                if state != AlarmState::Shelved {
                    return refuse("shelved");
                }
                self.shelved_until = None;
            }
            AlarmAction::Comment => {}
        }
        let change = AlarmChange {
            time,
            state: self.state(time),
            severity: self.raised,
            value: None,
            action: Some(action),
            by: by.to_owned(),
            comment: comment.to_owned(),
        };
        Ok(self.keep(change))
    }

    /// Whether the latest readings call for a severity: raised by N of M above it, or raised before and not cleared by N of M below.
    fn calls_for(&self, rule: &AlarmRule, severity: Severity) -> bool {
        let Some(level) = rule.level(severity) else { return false };
        let AlarmSettings {
            raise,
            raise_of,
            clear,
            clear_of,
        } = rule.settings;
        let count =
            |of: u32, holds: &dyn Fn(f64) -> bool| self.recent.iter().rev().take(of as usize).filter(|value| holds(**value)).count();
        if self.raised >= Some(severity) {
            count(clear_of, &|value| value < level - rule.hysteresis) < clear as usize
        } else {
            count(raise_of, &|value| value > level) >= raise as usize
        }
    }

    fn keep(&mut self, change: AlarmChange) -> AlarmChange {
        if self.history.len() == MOST_CHANGES {
            self.history.remove(0);
        }
        self.history.push(change.clone());
        change
    }
}

#[cfg(test)]
mod tests {
    use jiff::SignedDuration;
    use proptest::prelude::*;

    use super::*;

    fn rule(raise: u32, raise_of: u32, clear: u32, clear_of: u32) -> AlarmRule {
        AlarmRule {
            quantity: AlarmQuantity::WearUm,
            warning: Some(100.0),
            danger: Some(200.0),
            hysteresis: 10.0,
            settings: AlarmSettings {
                raise,
                raise_of,
                clear,
                clear_of,
            },
        }
    }

    fn at(minute: i64) -> Timestamp {
        Timestamp::UNIX_EPOCH + SignedDuration::from_mins(minute)
    }

    fn feed(alarm: &mut Alarm, rule: &AlarmRule, values: &[f64]) -> Vec<Option<Severity>> {
        let mut read = |(i, value): (usize, &f64)| {
            let reading = AlarmReading {
                time: at(i as i64),
                value: Some(*value),
            };
            alarm.reading(rule, reading);
            alarm.severity()
        };
        values.iter().enumerate().map(&mut read).collect()
    }

    #[test]
    fn n_of_m_raise_and_n_of_m_clear() {
        let (mut alarm, rule) = (Alarm::default(), rule(2, 3, 2, 3));
        let got = feed(&mut alarm, &rule, &[101.0, 50.0, 101.0, 95.0, 95.0, 89.0, 95.0, 89.0]);
        let warning = Some(Severity::Warning);
        assert_eq!(got, [None, None, warning, warning, warning, warning, warning, None]);
        assert_eq!(alarm.state(at(9)), AlarmState::ReturnedUnacknowledged);
        assert_eq!(alarm.history().len(), 2);
    }

    #[test]
    fn an_alarm_goes_through_its_states() {
        let (mut alarm, rule) = (Alarm::default(), rule(1, 1, 1, 1));
        assert_eq!(alarm.state(at(0)), AlarmState::Normal);
        feed(&mut alarm, &rule, &[150.0]);
        assert_eq!(alarm.state(at(0)), AlarmState::Unacknowledged);
        let change = alarm.act(at(1), AlarmAction::Acknowledge, "Ada", "seen").unwrap();
        assert_eq!(
            (change.state, change.by.as_str(), change.comment.as_str()),
            (AlarmState::Acknowledged, "Ada", "seen")
        );
        assert!(alarm.act(at(1), AlarmAction::Acknowledge, "Ada", "").is_err());
        // Worse: to be acknowledged again. Less bad: not.
        feed(&mut alarm, &rule, &[250.0]);
        assert_eq!(
            (alarm.state(at(2)), alarm.severity()),
            (AlarmState::Unacknowledged, Some(Severity::Danger))
        );
        alarm.act(at(2), AlarmAction::Acknowledge, "Ada", "").unwrap();
        feed(&mut alarm, &rule, &[150.0]);
        assert_eq!(
            (alarm.state(at(3)), alarm.severity()),
            (AlarmState::Acknowledged, Some(Severity::Warning))
        );
        feed(&mut alarm, &rule, &[0.0]);
        assert_eq!(alarm.state(at(4)), AlarmState::Normal);
        feed(&mut alarm, &rule, &[150.0, 0.0]);
        assert_eq!(alarm.state(at(5)), AlarmState::ReturnedUnacknowledged);
        alarm.act(at(6), AlarmAction::Acknowledge, "Ada", "").unwrap();
        assert_eq!(alarm.state(at(6)), AlarmState::Normal);
    }

    #[test]
    fn what_is_shelved_comes_back_by_itself() {
        let (mut alarm, rule) = (Alarm::default(), rule(1, 1, 1, 1));
        feed(&mut alarm, &rule, &[150.0]);
        assert!(alarm.act(at(5), AlarmAction::Unshelve, "Ada", "").is_err());
        assert!(alarm.act(at(5), AlarmAction::Shelve { until: at(5) }, "Ada", "").is_err());
        alarm
            .act(at(5), AlarmAction::Shelve { until: at(20) }, "Ada", "till tomorrow")
            .unwrap();
        assert_eq!(
            (alarm.state(at(19)), alarm.state(at(20))),
            (AlarmState::Shelved, AlarmState::Unacknowledged)
        );
        alarm.act(at(6), AlarmAction::Unshelve, "Ada", "").unwrap();
        assert_eq!(alarm.state(at(7)), AlarmState::Unacknowledged);
    }

    #[test]
    fn no_value_neither_raises_nor_clears() {
        let (mut alarm, rule) = (Alarm::default(), rule(1, 1, 1, 1));
        feed(&mut alarm, &rule, &[150.0]);
        for value in [None, Some(f64::NAN)] {
            assert_eq!(alarm.reading(&rule, AlarmReading { time: at(1), value }), None);
        }
        assert_eq!(alarm.severity(), Some(Severity::Warning));
    }

    #[test]
    fn rules_that_cannot_be_used_are_refused() {
        let good = rule(1, 3, 1, 3);
        assert!(good.validate().is_ok());
        let refused = [
            AlarmRule {
                warning: None,
                danger: None,
                ..good.clone()
            },
            AlarmRule {
                danger: Some(90.0),
                ..good.clone()
            },
            AlarmRule {
                hysteresis: -1.0,
                ..good.clone()
            },
            AlarmRule {
                warning: Some(f64::NAN),
                ..good.clone()
            },
            rule(0, 3, 1, 3),
            rule(4, 3, 1, 3),
            rule(1, 3, 1, 2000),
        ];
        for rule in refused {
            assert!(rule.validate().is_err(), "{rule:?}");
        }
    }

    proptest! {
        /// Between two changes of one direction and the other lie at least as many readings as the rule asks for: a severity cannot be left before
        /// N readings below it, nor entered before N above.
        #[test]
        fn nothing_flaps_faster_than_n(
            values in prop::collection::vec(60.0..240.0f64, 1..200),
            raise in 1u32..5, more in 0u32..4, clear in 1u32..5, clear_more in 0u32..4,
        ) {
            let rule = rule(raise, raise + more, clear, clear + clear_more);
            let mut alarm = Alarm::default();
            let states = feed(&mut alarm, &rule, &values);
            let mut before = None;
            for (i, state) in states.into_iter().enumerate() {
                let window = |of: u32| &values[(i + 1).saturating_sub(of as usize)..=i];
                for (severity, level) in [(Severity::Warning, 100.0), (Severity::Danger, 200.0)] {
                    let (was, is) = (before >= Some(severity), state >= Some(severity));
                    if is && !was {
                        let above = window(raise + more).iter().filter(|value| **value > level).count();
                        prop_assert!(above >= raise as usize);
                    }
                    if was && !is {
                        let below = window(clear + clear_more).iter().filter(|value| **value < level - 10.0).count();
                        prop_assert!(below >= clear as usize);
                    }
                }
                before = state;
            }
        }

        /// A value that stays between the clear level and the level never changes the alarm.
        #[test]
        fn between_clear_level_and_level_nothing_changes(values in prop::collection::vec(90.0..100.0f64, 1..100), raised in any::<bool>()) {
            let (mut alarm, rule) = (Alarm::default(), rule(1, 1, 1, 1));
            if raised {
                feed(&mut alarm, &rule, &[150.0]);
            }
            let changes = alarm.history().len();
            feed(&mut alarm, &rule, &values);
            prop_assert_eq!(alarm.history().len(), changes);
        }

        #[test]
        fn a_copy_in_json_goes_on_the_same(values in prop::collection::vec(60.0..240.0f64, 1..60)) {
            let (mut alarm, rule) = (Alarm::default(), rule(2, 3, 2, 4));
            for (i, value) in values.iter().enumerate() {
                let mut copy: Alarm = serde_json::from_str(&serde_json::to_string(&alarm).unwrap()).unwrap();
                let reading = AlarmReading { time: at(i as i64), value: Some(*value) };
                prop_assert_eq!(copy.reading(&rule, reading), alarm.reading(&rule, reading));
                prop_assert_eq!(&copy, &alarm);
            }
        }
    }
}
