//! Tests of a channel's state: its copies, its size in memory, and which trackers continue from it.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::tests::{NEED, seen, settings, tracker};
use super::*;
use crate::library::testing::synthetic_library;

#[test]
fn a_copy_through_json_continues_with_the_same_bits() {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut state = tracker.start();
    for i in 0..60 {
        let features = seen(&library, f64::from(i), 0.05, &mut rng);
        let mut copy: TrackerState = serde_json::from_str(&serde_json::to_string(&state).unwrap()).unwrap();
        let expected = tracker.update(&mut state, Timestamp::UNIX_EPOCH, &features);
        assert_eq!(tracker.update(&mut copy, Timestamp::UNIX_EPOCH, &features), expected);
        assert_eq!(copy, state);
    }
}

/// A service keeps several states of each channel in memory.
#[test]
fn states_of_a_channel_share_their_baseline() {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let mut rng = ChaCha8Rng::seed_from_u64(16);
    let mut state = tracker.start();
    let mut states = Vec::new();
    for _ in 0..NEED + 3 {
        tracker.update(&mut state, Timestamp::UNIX_EPOCH, &seen(&library, 0.0, 0.05, &mut rng));
        states.push(state.clone());
    }
    let (collecting, tracking) = states.split_at(NEED as usize - 1);
    let last: &[Arc<Features>] = match &collecting[collecting.len() - 1].0 {
        Stage::Collecting(collecting) => collecting.records(),
        Stage::Tracking(_) => panic!("the baseline is not complete"),
    };
    for (n, record) in last.iter().enumerate() {
        assert_eq!(Arc::strong_count(record), collecting.len() - n, "record {n} is in each later state once");
    }
    let baselines: Vec<_> = tracking
        .iter()
        .map(|state| match &state.0 {
            Stage::Tracking(tracking) => tracking.baseline(),
            Stage::Collecting(_) => panic!("the baseline is complete"),
        })
        .collect();
    assert_eq!(baselines.len(), 4);
    assert!(baselines.iter().all(|baseline| Arc::ptr_eq(baseline, baselines[0])));
}

#[test]
fn a_state_continues_only_with_as_many_members() {
    let library = Arc::new(synthetic_library());
    let (tracker, without) = (tracker(&library), Tracker::new(settings(), None));
    let mut rng = ChaCha8Rng::seed_from_u64(43);
    let mut state = tracker.start();
    for _ in 0..=NEED {
        assert!(tracker.continues(&state) && without.continues(&state));
        tracker.update(&mut state, Timestamp::UNIX_EPOCH, &seen(&library, 0.0, 0.05, &mut rng));
    }
    assert!(tracker.continues(&state) && !without.continues(&state));
}
