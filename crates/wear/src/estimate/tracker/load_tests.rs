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
