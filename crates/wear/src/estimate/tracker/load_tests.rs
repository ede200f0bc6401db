//! Tests of lines that a change of load may have moved.

use jiff::SignedDuration;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::tests::{NEED, seen, tracker};
use super::*;
use crate::library::testing::synthetic_library;

/// The last estimate of a healthy machine whose lines change at once, as at 100 µm, and then stay.
fn after_a_step(torque_nm: Option<f64>) -> WearEstimate {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut state = tracker.start();
    let mut last = None;
    for record in 0..2 * NEED + 60 {
        let um = if record < 2 * NEED { 0.0 } else { 100.0 };
        let mut features = seen(&library, um, 0.05, &mut rng);
        features.operating_point.torque_nm = torque_nm;
        let at = Timestamp::UNIX_EPOCH + SignedDuration::from_hours(record.into());
        last = Some(tracker.update(&mut state, at, &features));
    }
    last.unwrap()
}

#[test]
fn a_sudden_change_proves_no_wear_unless_the_torque_is_known() {
    let library = synthetic_library();
    let without = after_a_step(None);
    assert!(without.low_um.unwrap() < 10.0, "{}", without.reason);
    assert!(without.reason.contains("changed suddenly"), "{}", without.reason);
    let with = after_a_step(Some(library.pair().operation.torque_nm));
    assert!(with.low_um.unwrap() > 30.0, "{}", with.reason);
    assert!(!with.reason.contains("changed suddenly"), "{}", with.reason);
}

/// By the load mapping, lines at half the torque show half the depth, so the wear grows half as fast.
#[test]
fn the_forecast_takes_the_torque_into_account() {
    let library = Arc::new(synthetic_library());
    let rate_at = |torque: f64| {
        let tracker = tracker(&library);
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let mut state = tracker.start();
        let mut last = None;
        for record in 0..NEED + 120 {
            let um = 1.2 * f64::from(record.saturating_sub(NEED));
            let mut features = seen(&library, um, 0.05, &mut rng);
            features.operating_point.torque_nm = Some(torque * library.pair().operation.torque_nm);
            let at = Timestamp::UNIX_EPOCH + SignedDuration::from_hours(record.into());
            last = Some(tracker.update(&mut state, at, &features));
        }
        last.unwrap().prognosis.unwrap().rate_um_per_day
    };
    let (whole, half) = (rate_at(1.0), rate_at(0.5));
    assert!(half < 0.7 * whole, "{half} of {whole} µm a day");
}
