//! Tests of alarms through their states.

use jiff::SignedDuration;
use proptest::prelude::*;

use super::*;
use crate::estimate::MaintenanceKind;

fn rule(raise: u32, raise_of: u32, clear: u32, clear_of: u32) -> AlarmRule {
    AlarmRule {
        warning: Some(100.0),
        danger: Some(200.0),
        hysteresis: 10.0,
        settings: AlarmSettings { raise, raise_of, clear, clear_of },
        ..AlarmRule::of(AlarmQuantity::WearUm)
    }
}

fn at(minute: i64) -> Timestamp {
    Timestamp::UNIX_EPOCH + SignedDuration::from_mins(minute)
}

fn taken(minute: i64, action: AlarmAction, seen: Option<Severity>) -> ActionTaken {
    ActionTaken {
        time: at(minute),
        after: at(minute),
        action,
        seen,
        by: "Ada".to_owned(),
        comment: "seen".to_owned(),
    }
}

/// Applies an action if it is possible, as a user who sees the present severity.
fn act(alarm: &mut Alarm, minute: i64, action: AlarmAction) -> Result<AlarmChange, AlarmError> {
    alarm.check(at(minute), &action)?;
    Ok(alarm.act(&taken(minute, action, alarm.severity())))
}

fn feed(alarm: &mut Alarm, rule: &AlarmRule, values: &[f64]) -> Vec<Option<Severity>> {
    let mut read = |(i, value): (usize, &f64)| {
        let reading = AlarmReading { time: at(i as i64), value: Some(*value) };
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
    assert_eq!(alarm.last().map(|change| change.value), Some(Some(89.0)));
}

#[test]
fn an_alarm_goes_through_its_states() {
    let (mut alarm, rule) = (Alarm::default(), rule(1, 1, 1, 1));
    assert_eq!(alarm.state(at(0)), AlarmState::Normal);
    feed(&mut alarm, &rule, &[150.0]);
    assert_eq!(alarm.state(at(0)), AlarmState::Unacknowledged);
    let change = act(&mut alarm, 1, AlarmAction::Acknowledge).unwrap();
    assert_eq!(
        (change.state, change.by.as_str(), change.comment.as_str()),
        (AlarmState::Acknowledged, "Ada", "seen")
    );
    assert!(act(&mut alarm, 1, AlarmAction::Acknowledge).is_err());
    // A higher severity has to be acknowledged again, a lower one does not.
    feed(&mut alarm, &rule, &[250.0]);
    assert_eq!((alarm.state(at(2)), alarm.severity()), (AlarmState::Unacknowledged, Some(Severity::Danger)));
    act(&mut alarm, 2, AlarmAction::Acknowledge).unwrap();
    feed(&mut alarm, &rule, &[150.0]);
    assert_eq!((alarm.state(at(3)), alarm.severity()), (AlarmState::Acknowledged, Some(Severity::Warning)));
    feed(&mut alarm, &rule, &[0.0]);
    assert_eq!(alarm.state(at(4)), AlarmState::Normal);
    feed(&mut alarm, &rule, &[150.0, 0.0]);
    assert_eq!(alarm.state(at(5)), AlarmState::ReturnedUnacknowledged);
    act(&mut alarm, 6, AlarmAction::Acknowledge).unwrap();
    assert_eq!(alarm.state(at(6)), AlarmState::Normal);
}

#[test]
fn an_acknowledgement_does_not_cover_a_severity_that_was_not_shown() {
    let (mut alarm, rule) = (Alarm::default(), rule(1, 1, 1, 1));
    feed(&mut alarm, &rule, &[250.0]);
    // Acknowledged as a warning; a late record then raised it to danger.
    let change = alarm.act(&taken(1, AlarmAction::Acknowledge, Some(Severity::Warning)));
    assert_eq!((change.state, change.by.as_str()), (AlarmState::Unacknowledged, "Ada"));
    let change = alarm.act(&taken(1, AlarmAction::Acknowledge, Some(Severity::Danger)));
    assert_eq!(change.state, AlarmState::Acknowledged);
    // No longer possible, as after a late record: recorded without effect.
    let change = alarm.act(&taken(2, AlarmAction::Unshelve, None));
    assert_eq!((change.state, change.action), (AlarmState::Acknowledged, Some(AlarmAction::Unshelve)));
}

#[test]
fn a_new_gear_clears_the_alarms_of_the_old_one() {
    let rules = [rule(2, 2, 2, 2), AlarmRule { quantity: AlarmQuantity::Novelty, ..rule(1, 1, 1, 1) }];
    let mut panel = AlarmPanel::of(&rules);
    let event = |kind| MaintenanceEvent {
        time: at(3),
        kind,
        by: String::new(),
        comment: String::new(),
        inspection: None,
        until: None,
    };
    for alarm in &mut panel.alarms {
        feed(alarm, &rules[0], &[150.0, 150.0]);
    }
    let changed = panel.maintenance(&rules, &event(MaintenanceKind::SensorReplaced));
    let state = AlarmState::ReturnedUnacknowledged;
    assert_eq!(changed.iter().map(|(n, change)| (*n, change.state)).collect::<Vec<_>>(), [(1, state)]);
    let changed = panel.maintenance(&rules, &event(MaintenanceKind::GearReplaced));
    assert_eq!(changed.iter().map(|(n, change)| (*n, change.state)).collect::<Vec<_>>(), [(0, state)]);
    // One more reading above does not raise it: those of the old gear do not count.
    assert_eq!(feed(&mut panel.alarms[0], &rules[0], &[150.0]), [None]);
    let action =
        PanelAction { quantity: AlarmQuantity::Novelty, taken: taken(4, AlarmAction::Acknowledge, None) };
    assert_eq!(panel.act(&rules, &action).unwrap().1.state, AlarmState::Normal);
    assert_eq!(panel.act(&rules[..1], &action), None);
}

#[test]
fn shelving_expires() {
    let (mut alarm, rule) = (Alarm::default(), rule(1, 1, 1, 1));
    feed(&mut alarm, &rule, &[150.0]);
    assert!(act(&mut alarm, 5, AlarmAction::Unshelve).is_err());
    assert!(act(&mut alarm, 5, AlarmAction::Shelve { until: at(5) }).is_err());
    act(&mut alarm, 5, AlarmAction::Shelve { until: at(20) }).unwrap();
    assert_eq!((alarm.state(at(19)), alarm.state(at(20))), (AlarmState::Shelved, AlarmState::Unacknowledged));
    act(&mut alarm, 6, AlarmAction::Unshelve).unwrap();
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
fn invalid_rules_are_rejected() {
    let good = rule(1, 3, 1, 3);
    assert!(good.validate().is_ok());
    let refused = [
        AlarmRule { warning: None, danger: None, ..good.clone() },
        AlarmRule { danger: Some(90.0), ..good.clone() },
        AlarmRule { hysteresis: -1.0, ..good.clone() },
        AlarmRule { warning: Some(f64::NAN), ..good.clone() },
        rule(0, 3, 1, 3),
        rule(4, 3, 1, 3),
        rule(1, 3, 1, 2000),
    ];
    for rule in refused {
        assert!(rule.validate().is_err(), "{rule:?}");
    }
}

proptest! {
    /// A severity cannot be left before N readings below its level, nor entered before N above.
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
        let last = alarm.last().cloned();
        feed(&mut alarm, &rule, &values);
        prop_assert_eq!(alarm.last(), last.as_ref());
    }

    #[test]
    fn a_copy_through_json_continues_with_the_same_results(values in prop::collection::vec(60.0..240.0f64, 1..60)) {
        let (mut alarm, rule) = (Alarm::default(), rule(2, 3, 2, 4));
        for (i, value) in values.iter().enumerate() {
            let mut copy: Alarm = serde_json::from_str(&serde_json::to_string(&alarm).unwrap()).unwrap();
            let reading = AlarmReading { time: at(i as i64), value: Some(*value) };
            prop_assert_eq!(copy.reading(&rule, reading), alarm.reading(&rule, reading));
            prop_assert_eq!(&copy, &alarm);
        }
    }
}

#[test]
fn a_level_can_lie_below_and_on_both_sides() {
    let both = AlarmRule { warning_below: Some(50.0), danger_below: Some(20.0), ..rule(2, 2, 2, 2) };
    assert!(both.validate().is_ok());
    let mut alarm = Alarm::default();
    let got = feed(
        &mut alarm,
        &both,
        &[75.0, 45.0, 45.0, 55.0, 55.0, 65.0, 65.0, 10.0, 10.0, 150.0, 150.0, 75.0, 75.0],
    );
    let (none, warning, danger) = (None, Some(Severity::Warning), Some(Severity::Danger));
    // 55 is within the hysteresis; the alarm goes from danger below to warning above, and back.
    let expected =
        [none, none, warning, warning, warning, warning, none, none, danger, danger, warning, warning, none];
    assert_eq!(got, expected);
    for refused in [
        AlarmRule { danger_below: Some(60.0), ..both.clone() },
        AlarmRule { warning_below: Some(85.0), ..both.clone() },
        AlarmRule { warning_below: Some(f64::NAN), ..both.clone() },
        AlarmRule { danger: Some(1e308), ..both.clone() },
    ] {
        assert!(refused.validate().is_err(), "{refused:?}");
    }
}

#[test]
fn a_rate_raises_an_alarm_and_an_inspection_is_no_growth() {
    let rate = AlarmRule {
        warning: Some(100.0),
        over_s: Some(3600.0),
        settings: rule(1, 1, 1, 1).settings,
        ..AlarmRule::of(AlarmQuantity::RatePerDay(RatedQuantity::WearUm))
    };
    assert!(rate.validate().is_ok());
    let without = AlarmRule { over_s: None, ..rate.clone() };
    assert_eq!(without.validate(), Err(AlarmError::NoRateWindow));
    let stray = AlarmRule { over_s: Some(60.0), ..rule(1, 1, 1, 1) };
    assert!(stray.validate().is_err());
    // 60 µm a day for an hour, then 240.
    let slow: Vec<f64> = (0..60).map(|minute| 60.0 / 1440.0 * f64::from(minute)).collect();
    let fast = (0..60).map(|minute| 2.5 + 240.0 / 1440.0 * f64::from(minute));
    let (mut alarm, values) = (Alarm::default(), slow.iter().copied().chain(fast).collect::<Vec<_>>());
    let got = feed(&mut alarm, &rate, &values);
    assert!(got[..60].iter().all(Option::is_none) && got[119] == Some(Severity::Warning), "{got:?}");
    assert!(alarm.value().unwrap() > 100.0);

    let mut panel = AlarmPanel { alarms: vec![Alarm::default()] };
    let rules = [rate];
    feed(&mut panel.alarms[0], &rules[0], &slow);
    let inspected = MaintenanceEvent {
        time: at(60),
        kind: MaintenanceKind::Inspected,
        by: "Ada".to_owned(),
        comment: String::new(),
        inspection: None,
        until: None,
    };
    panel.maintenance(&rules, &inspected);
    let reading = AlarmReading { time: at(61), value: Some(80.0) };
    assert_eq!(panel.alarms[0].reading(&rules[0], reading), None);
}

#[test]
fn a_record_ends_the_alarm_on_missing_records() {
    let stale =
        AlarmRule { warning: Some(60.0), danger: Some(600.0), ..AlarmRule::of(AlarmQuantity::StaleS) };
    assert!(stale.validate().is_ok());
    let severities = [59.0, 61.0, 601.0].map(|seconds| stale.severity_of_silence(seconds));
    assert_eq!(severities, [None, Some(Severity::Warning), Some(Severity::Danger)]);
    let mut alarm = Alarm::default();
    let silent = |severity, silent_s| AlarmAction::Stale { severity, silent_s };
    assert!(act(&mut alarm, 5, silent(None, 3)).is_err(), "nothing is raised");
    let raised = act(&mut alarm, 5, silent(Some(Severity::Warning), 61)).unwrap();
    assert_eq!((raised.state, raised.value), (AlarmState::Unacknowledged, Some(61.0)));
    assert!(act(&mut alarm, 6, silent(Some(Severity::Warning), 120)).is_err(), "already raised");
    act(&mut alarm, 7, AlarmAction::Acknowledge).unwrap();
    let worse = act(&mut alarm, 8, silent(Some(Severity::Danger), 601)).unwrap();
    assert_eq!((worse.state, worse.severity), (AlarmState::Unacknowledged, Some(Severity::Danger)));
    let back = alarm.record_arrived(at(9)).unwrap();
    assert_eq!((back.state, back.severity), (AlarmState::ReturnedUnacknowledged, None));
    assert_eq!(alarm.record_arrived(at(10)), None);
    let below = AlarmRule { warning_below: Some(1.0), ..stale };
    assert!(below.validate().is_err());
}

#[test]
fn a_sensor_fault_has_a_reading_only_where_it_is_judged() {
    use crate::estimate::{BaselineProgress, Novelty, SensorFault, WearEstimate, WearStatus};
    use flankwatch_signal::Indicators;

    let with = |status, sensor_fault| {
        let novelty = Novelty {
            p_value: 1.0,
            score: 0.0,
            outside: false,
            sensor_fault,
            suspected_fault: None,
            other_suspected_faults: Vec::new(),
            band_hz: None,
            envelope_line: None,
            lasting: None,
            largest_deviations: Vec::new(),
        };
        WearEstimate {
            novelty: Some(novelty),
            ..WearEstimate::without_number(status, String::new(), BaselineProgress { have: 8, need: 8 })
        }
    };
    let none = Indicators::default();
    let value = |wear: &WearEstimate| AlarmQuantity::SensorFault.value(wear, [&none, &none]);
    assert_eq!(value(&with(WearStatus::SensorFault, Some(SensorFault::Clipped))), Some(1.0));
    assert_eq!(value(&with(WearStatus::Estimated, None)), Some(0.0));
    let learning = WearEstimate { novelty: None, ..with(WearStatus::CollectingBaseline, None) };
    assert_eq!(value(&learning), None);
    let level = |danger| AlarmRule { danger: Some(danger), ..AlarmRule::of(AlarmQuantity::SensorFault) };
    assert!(level(0.5).validate().is_ok() && level(1.0).validate().is_err());
}

#[test]
fn an_invalid_number_of_readings_is_named() {
    for (rule, expected) in [
        (rule(3, 101, 5, 5), "raise_of is 101, expected a number of readings from 1 to 100"),
        (rule(6, 5, 5, 5), "raise is 6, expected at least 1 and at most raise_of"),
        (rule(3, 5, 0, 5), "clear is 0, expected at least 1 and at most clear_of"),
        (rule(3, 5, 1, 0), "clear_of is 0, expected a number of readings from 1 to 100"),
    ] {
        let error = rule.validate().unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}
