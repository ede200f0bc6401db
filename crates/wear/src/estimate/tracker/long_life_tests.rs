//! Tests of machines that run for thousands of records.

use jiff::SignedDuration;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::tests::{NEED, seen, tracker};
use super::*;
use crate::library::testing::synthetic_library;

/// After a long healthy life a unit of growth has 30 intervals between records; then the gear fails within a
/// hundred of them.
#[test]
fn wear_that_begins_late_is_within_the_interval() {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut state = tracker.start();
    let begins = NEED + 1800;
    let mut held = 0;
    let mut highest_um: f64 = 0.0;
    for record in 0..begins + 100 {
        let um = 2.0 * f64::from(record.saturating_sub(begins));
        let at = Timestamp::UNIX_EPOCH + SignedDuration::from_hours(record.into());
        let wear = tracker.update(&mut state, at, &seen(&library, um, 0.05, &mut rng));
        if record >= begins {
            held += u32::from((wear.low_um.unwrap()..=wear.high_um.unwrap()).contains(&um));
        } else if record >= NEED {
            highest_um = highest_um.max(wear.high_um.unwrap());
        }
    }
    assert!(highest_um < 40.0, "a healthy machine's interval ends at {highest_um} µm");
    assert!(held >= 85, "{held} of 100 records");
}
