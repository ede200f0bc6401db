//! Events between the records of a channel: maintenance of its asset, and operator actions on its alarms.

use jiff::Timestamp;

use crate::estimate::{MaintenanceEvent, PanelAction};

/// An event between two records.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum TimelineEvent {
    /// An operator action on an alarm.
    Action(PanelAction),
    /// A maintenance event of the machine.
    Maintenance(MaintenanceEvent),
}

/// All events between the records of a channel.
#[derive(Debug, Default)]
pub(crate) struct Timeline {
    /// Sorted by time; at the same time, actions before maintenance events.
    all: Vec<TimelineEvent>,
    /// Whether the channel has stored alarms.
    pub(crate) has_alarms: bool,
}

impl TimelineEvent {
    /// The time at which it takes effect: an action after the records of that time, a maintenance event
    /// before them.
    fn time(&self) -> Timestamp {
        match self {
            Self::Action(action) => action.taken.after,
            Self::Maintenance(event) => event.time,
        }
    }

    fn lies_between(&self, before: Option<Timestamp>, next: Timestamp) -> bool {
        let time = self.time();
        match self {
            Self::Action(_) => before.is_none_or(|before| before <= time) && time < next,
            Self::Maintenance(_) => before.is_none_or(|before| before < time) && time <= next,
        }
    }
}

impl Timeline {
    /// Merges maintenance events and actions, each given in the order of time.
    pub(crate) fn new(events: Vec<MaintenanceEvent>, actions: Vec<PanelAction>, has_alarms: bool) -> Self {
        let actions = actions.into_iter().map(TimelineEvent::Action);
        let mut all: Vec<TimelineEvent> =
            actions.chain(events.into_iter().map(TimelineEvent::Maintenance)).collect();
        // Stable: at the same time actions stay before maintenance events, and each kind keeps its order.
        all.sort_by_key(TimelineEvent::time);
        Self { all, has_alarms }
    }

    /// The events between a record at the time `before`, `None` at the start of the history, and one at the
    /// time `next`.
    pub(crate) fn between(
        &self,
        before: Option<Timestamp>,
        next: Timestamp,
    ) -> impl Iterator<Item = &TimelineEvent> {
        let first = before.map_or(0, |before| self.all.partition_point(|one| one.time() < before));
        let not_beyond = self.all[first..].iter().take_while(move |one| one.time() <= next);
        not_beyond.filter(move |one| one.lies_between(before, next))
    }

    /// The operator actions after a record at the time `last`.
    pub(crate) fn actions_from(&self, last: Option<Timestamp>) -> impl Iterator<Item = &PanelAction> {
        self.all.iter().filter_map(move |one| match one {
            TimelineEvent::Action(action) if last.is_none_or(|last| last <= action.taken.after) => {
                Some(action)
            }
            _ => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use jiff::SignedDuration;

    use super::*;
    use crate::estimate::{ActionTaken, AlarmAction, AlarmQuantity, MaintenanceKind};

    fn at(minute: i64) -> Timestamp {
        Timestamp::UNIX_EPOCH + SignedDuration::from_mins(minute)
    }

    fn action(after: i64) -> PanelAction {
        PanelAction {
            quantity: AlarmQuantity::Novelty,
            taken: ActionTaken {
                time: at(1000),
                after: at(after),
                action: AlarmAction::Comment,
                seen: None,
                by: String::new(),
                comment: String::new(),
            },
        }
    }

    fn event(minute: i64) -> MaintenanceEvent {
        MaintenanceEvent {
            time: at(minute),
            kind: MaintenanceKind::GearReplaced,
            by: String::new(),
            comment: String::new(),
            inspection: None,
            until: None,
        }
    }

    #[test]
    fn each_event_lies_between_two_records_and_no_others() {
        let timeline = Timeline::new((0..7).map(event).collect(), (0..7).map(action).collect(), true);
        // Two records share a time.
        let records = [1, 3, 3, 4];
        let mut before = None;
        let mut seen = Vec::new();
        for minute in records {
            for one in timeline.between(before, at(minute)) {
                let minutes = one.time().as_second() / 60;
                seen.push((minute, matches!(one, TimelineEvent::Action(_)), minutes));
            }
            before = Some(at(minute));
        }
        let expected = [
            (1, true, 0),
            (1, false, 0),
            (1, false, 1),
            (3, true, 1),
            (3, true, 2),
            (3, false, 2),
            (3, false, 3),
            (4, true, 3),
            (4, false, 4),
        ];
        assert_eq!(seen, expected);
        let later: Vec<_> = timeline.actions_from(before).map(|action| action.taken.after).collect();
        assert_eq!(later, [at(4), at(5), at(6)]);
    }
}
