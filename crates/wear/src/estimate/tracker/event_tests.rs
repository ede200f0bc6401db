//! Tests of excluded records, chosen baselines, replaced gears and inspections.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::super::event::Inspection;
use super::tests::{NEED, seen, tracker};
use super::*;
use crate::library::testing::synthetic_library;

#[test]
fn an_excluded_record_does_not_change_the_state() {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut state = tracker.start();
    for n in 1..=NEED + 2 {
        tracker.update(&mut state, Timestamp::UNIX_EPOCH, &seen(&library, 0.0, 0.05, &mut rng));
        let wear = tracker.excluded(&state);
        assert_eq!(
            (wear.status, wear.median_um, wear.baseline.have),
            (WearStatus::Excluded, None, n.min(NEED))
        );
    }
}

#[test]
fn a_chosen_baseline_replaces_the_learnt_one() {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let mut rng = ChaCha8Rng::seed_from_u64(23);
    let mut state = tracker.start();
    let at = |hour: u32| Timestamp::UNIX_EPOCH + jiff::SignedDuration::from_hours(i64::from(hour));
    for hour in 0..NEED + 10 {
        tracker.update(&mut state, at(hour), &seen(&library, 0.0, 0.03, &mut rng));
    }
    let (from, until) = (NEED + 10, NEED + 22);
    let event = MaintenanceEvent {
        time: at(from),
        kind: MaintenanceKind::BaselineChosen,
        by: "Ada".to_owned(),
        comment: String::new(),
        inspection: None,
        until: Some(at(until)),
    };
    tracker.event(&mut state, &event);
    for hour in from..until {
        let wear = tracker.update(&mut state, at(hour), &seen(&library, 60.0, 0.03, &mut rng));
        assert_eq!(wear.status, WearStatus::CollectingBaseline, "{}", wear.reason);
        // Continue with a copy through JSON.
        state = serde_json::from_str(&serde_json::to_string(&state).unwrap()).unwrap();
    }
    let mut last = None;
    for hour in until..until + 10 {
        let wear = tracker.update(&mut state, at(hour), &seen(&library, 60.0, 0.03, &mut rng));
        assert_ne!(wear.status, WearStatus::CollectingBaseline, "{}", wear.reason);
        last = Some(wear);
    }
    let wear = last.unwrap();
    assert!(wear.median_um.unwrap() < 30.0, "wear counts from zero there: {}", wear.reason);
}

#[test]
fn too_few_chosen_records_are_no_baseline() {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let mut rng = ChaCha8Rng::seed_from_u64(29);
    let mut state = tracker.start();
    let at = |hour: u32| Timestamp::UNIX_EPOCH + jiff::SignedDuration::from_hours(i64::from(hour));
    let event = MaintenanceEvent {
        time: at(0),
        kind: MaintenanceKind::BaselineChosen,
        by: "Ada".to_owned(),
        comment: String::new(),
        inspection: None,
        until: Some(at(3)),
    };
    tracker.event(&mut state, &event);
    for hour in 0..NEED {
        let wear = tracker.update(&mut state, at(hour), &seen(&library, 0.0, 0.03, &mut rng));
        assert_eq!((wear.status, wear.baseline.have), (WearStatus::CollectingBaseline, hour + 1));
    }
    let wear = tracker.update(&mut state, at(NEED), &seen(&library, 0.0, 0.03, &mut rng));
    assert_ne!(wear.status, WearStatus::CollectingBaseline);
}

#[test]
fn wear_restarts_after_a_replaced_gear_and_continues_after_a_replaced_sensor() {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut state = tracker.start();
    let at = |state: &mut TrackerState, um: f64, rng: &mut ChaCha8Rng| {
        tracker.update(state, Timestamp::UNIX_EPOCH, &seen(&library, um, 0.03, rng))
    };
    for _ in 0..NEED {
        at(&mut state, 0.0, &mut rng);
    }
    let before = (0..120).map(|i| at(&mut state, f64::from(i), &mut rng)).last().unwrap().median_um.unwrap();
    let event = |kind| MaintenanceEvent {
        time: Timestamp::UNIX_EPOCH,
        kind,
        by: "Ada".to_owned(),
        comment: String::new(),
        inspection: None,
        until: None,
    };
    for (kind, truth) in [(MaintenanceKind::SensorReplaced, 119.0), (MaintenanceKind::GearReplaced, 0.0)] {
        let mut state = state.clone();
        tracker.event(&mut state, &event(kind));
        for have in 1..=NEED {
            let wear = at(&mut state, truth, &mut rng);
            assert_eq!((wear.status, wear.baseline.have), (WearStatus::CollectingBaseline, have));
        }
        let after = at(&mut state, truth, &mut rng);
        let (low, high) = (after.low_um.unwrap(), after.high_um.unwrap());
        assert!(low <= truth && truth <= high, "{kind:?} before {before}: {}", after.reason);
    }
}

#[test]
fn an_inspection_narrows_the_interval_around_the_measured_depth() {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let mut rng = ChaCha8Rng::seed_from_u64(17);
    let mut state = tracker.start();
    let at = |record: u32| Timestamp::UNIX_EPOCH + jiff::SignedDuration::from_hours(i64::from(record));
    let mut take = |state: &mut TrackerState, record: u32, um: f64| {
        tracker.update(state, at(record), &seen(&library, um, 0.05, &mut rng))
    };
    for record in 0..NEED {
        take(&mut state, record, 0.0);
    }
    let mut before = take(&mut state, NEED, 0.0);
    for record in NEED + 1..NEED + 60 {
        before = take(&mut state, record, f64::from(record - NEED));
    }
    let inspection =
        Inspection { depth_um: 60.0, error_um: 3.0, gear: None, place: crate::library::FlankPlace::Greatest };
    assert!(inspection.fault().is_none());
    assert_eq!(Inspection { error_um: 0.0, ..inspection }.fault().unwrap().0, "inspection.error_um");
    let event = MaintenanceEvent {
        time: at(NEED + 60),
        kind: MaintenanceKind::Inspected,
        by: "Ada".to_owned(),
        comment: String::new(),
        inspection: Some(inspection),
        until: None,
    };
    tracker.event(&mut state, &event);
    let after = take(&mut state, NEED + 60, 60.0);
    let width = |wear: &WearEstimate| wear.high_um.unwrap() - wear.low_um.unwrap();
    assert!(width(&after) < width(&before), "{} {}", after.reason, before.reason);
    assert!((after.median_um.unwrap() - 60.0).abs() < 6.0, "{}", after.reason);
}

#[test]
fn hindsight_reaches_from_the_teeth_to_their_last_inspection() {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let mut rng = ChaCha8Rng::seed_from_u64(23);
    let at = |record: u32| Timestamp::UNIX_EPOCH + jiff::SignedDuration::from_hours(i64::from(record));
    let depth = |record: u32| f64::from(record.saturating_sub(NEED));
    let features: Vec<Features> =
        (0..NEED + 60).map(|record| seen(&library, depth(record), 0.05, &mut rng)).collect();
    let event = |record: u32, kind: MaintenanceKind, depth_um: Option<f64>| MaintenanceEvent {
        time: at(record),
        kind,
        by: String::new(),
        comment: String::new(),
        inspection: depth_um.map(|depth_um| Inspection {
            depth_um,
            error_um: 3.0,
            gear: None,
            place: crate::library::FlankPlace::Greatest,
        }),
        until: None,
    };
    let inspected =
        [20, 40].map(|record| event(NEED + record, MaintenanceKind::Inspected, Some(f64::from(record))));
    let replaced = event(NEED + 50, MaintenanceKind::GearReplaced, None);
    let mut steps: Vec<HistoryStep<'_>> = features
        .iter()
        .zip(0..)
        .map(|(features, record)| HistoryStep::Record(at(record), features))
        .collect();
    for (place, event) in [(NEED + 50, &replaced), (NEED + 40, &inspected[1]), (NEED + 20, &inspected[0])] {
        steps.insert(place as usize, HistoryStep::Event(event));
    }
    let in_hindsight = tracker.in_hindsight(&steps);
    assert_eq!(in_hindsight.len(), steps.len());
    // Records after the last inspection, and those of the new teeth, have no estimate in hindsight.
    let last = steps
        .iter()
        .rposition(|step| matches!(step, HistoryStep::Event(event) if event.inspection.is_some()));
    assert!(in_hindsight[last.unwrap()..].iter().all(Option::is_none));
    let estimate = in_hindsight[NEED as usize + 30].as_ref().unwrap();
    assert!((estimate.median_um.unwrap() - 29.0).abs() < 8.0, "{}", estimate.reason);
    // Without an inspection there are no estimates in hindsight.
    let records: Vec<HistoryStep<'_>> =
        steps.iter().filter(|step| matches!(step, HistoryStep::Record(..))).copied().collect();
    assert!(tracker.in_hindsight(&records).iter().all(Option::is_none));
}

/// Feeds hourly records with depths of `um`, and returns the last estimate.
fn take(
    tracker: &Tracker,
    state: &mut TrackerState,
    hours: std::ops::Range<u32>,
    um: impl Fn(u32) -> f64,
    rng: &mut ChaCha8Rng,
) -> WearEstimate {
    let library = synthetic_library();
    let each = hours.map(|hour| tracker.update(state, hourly(hour), &seen(&library, um(hour), 0.05, rng)));
    each.last().unwrap()
}

fn hourly(hour: u32) -> Timestamp {
    Timestamp::UNIX_EPOCH + jiff::SignedDuration::from_hours(i64::from(hour))
}

fn done(hour: u32, kind: MaintenanceKind, depth_um: Option<f64>) -> MaintenanceEvent {
    let place = crate::library::FlankPlace::Greatest;
    MaintenanceEvent {
        time: hourly(hour),
        kind,
        by: String::new(),
        comment: String::new(),
        inspection: depth_um.map(|depth_um| Inspection { depth_um, error_um: 3.0, gear: None, place }),
        until: None,
    }
}

/// The teeth are measured while the machine stands for a new sensor.
#[test]
fn an_inspection_counts_before_and_after_a_replaced_sensor() {
    let tracker = tracker(&Arc::new(synthetic_library()));
    let (sensor, depth) = (MaintenanceKind::SensorReplaced, MaintenanceKind::Inspected);
    for events in [[(depth, Some(100.0)), (sensor, None)], [(sensor, None), (depth, Some(100.0))]] {
        let mut rng = ChaCha8Rng::seed_from_u64(31);
        let mut state = tracker.start();
        let stop = NEED + 60;
        take(&tracker, &mut state, 0..stop, |hour| f64::from(hour.saturating_sub(NEED)), &mut rng);
        for (kind, depth_um) in events {
            tracker.event(&mut state, &done(stop, kind, depth_um));
        }
        let wear = take(&tracker, &mut state, stop..stop + NEED + 1, |_| 100.0, &mut rng);
        assert!((wear.median_um.unwrap() - 100.0).abs() < 10.0, "{events:?}: {}", wear.reason);
    }
}

#[test]
fn an_inspection_before_the_first_record_after_a_chosen_baseline_counts() {
    let tracker = tracker(&Arc::new(synthetic_library()));
    let mut rng = ChaCha8Rng::seed_from_u64(37);
    let mut state = tracker.start();
    let chosen =
        MaintenanceEvent { until: Some(hourly(12)), ..done(0, MaintenanceKind::BaselineChosen, None) };
    tracker.event(&mut state, &chosen);
    take(&tracker, &mut state, 0..12, |_| 0.0, &mut rng);
    tracker.event(&mut state, &done(12, MaintenanceKind::Inspected, Some(20.0)));
    let wear = take(&tracker, &mut state, 12..13, |_| 0.0, &mut rng);
    assert!(wear.low_um.unwrap() > 5.0, "{}", wear.reason);
}

#[test]
fn an_inspection_beyond_the_library_leads_to_its_end() {
    let tracker = tracker(&Arc::new(synthetic_library()));
    let mut rng = ChaCha8Rng::seed_from_u64(41);
    let mut state = tracker.start();
    let stop = NEED + 60;
    take(&tracker, &mut state, 0..stop, |hour| f64::from(hour.saturating_sub(NEED)), &mut rng);
    tracker.event(&mut state, &done(stop, MaintenanceKind::Inspected, Some(400.0)));
    let wear = take(&tracker, &mut state, stop..stop + 1, |_| 60.0, &mut rng);
    assert!(wear.at_least_um.is_some_and(|least_um| least_um > 200.0), "{}", wear.reason);
}
