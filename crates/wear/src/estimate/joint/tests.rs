use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::super::cusum::Cusums;
use super::*;
use crate::estimate::{BaselineProgress, Posterior};

const CHANNELS: usize = 4;
const CHECKS: [&str; 8] = ["a", "b", "c", "d", "e", "f", "g", "h"];

fn estimate(status: WearStatus, p_value: f64) -> WearEstimate {
    let baseline = BaselineProgress { have: 20, need: 20 };
    let mut wear = WearEstimate::without_number(status, "reason".to_owned(), baseline);
    wear.novelty = Some(Novelty {
        p_value,
        score: Novelty::score_of(p_value),
        outside: status == WearStatus::OutsideLibrary,
        sensor_fault: None,
        suspected_fault: None,
        other_suspected_faults: Vec::new(),
        band_hz: None,
        envelope_line: None,
        lasting: None,
        largest_deviations: Vec::new(),
    });
    wear
}

/// An estimate with all probability evenly within a range of a library up to 100 µm.
fn estimated(low_um: f64, high_um: f64) -> WearEstimate {
    let wear_um: Vec<f64> = (0..=100).map(f64::from).collect();
    let inside = |um: &f64| (low_um..=high_um).contains(um);
    let count = wear_um.iter().filter(|um| inside(um)).count() as f64;
    let probability = wear_um.iter().map(|um| if inside(um) { 1.0 / count } else { 0.0 }).collect();
    let mut wear = estimate(WearStatus::Estimated, 0.5);
    wear.library_id = Some("library".to_owned());
    wear.posterior = Some(Posterior { wear_um, probability });
    (wear.low_um, wear.median_um, wear.high_um) =
        (Some(low_um), Some(0.5 * (low_um + high_um)), Some(high_um));
    wear.above_limit = Some(if low_um > 10.0 { 1.0 } else { 0.0 });
    wear
}

/// Records of channels with correlated deviates; each channel pools its own with CUSUMs, as in a history.
struct Machine {
    random: ChaCha8Rng,
    correlation: f64,
    cusums: Vec<Cusums>,
}

impl Machine {
    fn new(seed: u64, correlation: f64) -> Self {
        let random = ChaCha8Rng::seed_from_u64(seed);
        Self { random, correlation, cusums: vec![Cusums::default(); CHANNELS] }
    }

    /// P-values of the channels after one record; `shift` is the mean deviation of the checks called "a".
    fn record(&mut self, shift: f64) -> [f64; CHANNELS] {
        let mut normal = || -> f64 { StandardNormal.sample(&mut self.random) };
        let shared: Vec<f64> = CHECKS.iter().map(|_| self.correlation.sqrt() * normal()).collect();
        let own = (1.0 - self.correlation).sqrt();
        let mut p_values = [1.0; CHANNELS];
        for (cusums, p_value) in self.cusums.iter_mut().zip(&mut p_values) {
            let deviates: Vec<f64> = shared.iter().map(|shared| shared + own * normal()).collect();
            let shifted = CHECKS.into_iter().zip(deviates);
            cusums.update(shifted.map(|(name, z)| (name, z + if name == "a" { shift } else { 0.0 })));
            *p_value = cusums.highest().map_or(1.0, |(_, p)| p);
        }
        p_values
    }
}

/// 50 000 healthy records of four channels with eight CUSUMs each: the asset is flagged no more often than
/// stated, for independent channels and for the assumed correlation.
#[test]
fn healthy_channels_pass_a_level_no_more_often_than_stated() {
    for (seed, correlation) in [(1, 0.0), (2, 0.3), (3, 0.5), (4, CORRELATION)] {
        let mut machine = Machine::new(seed, correlation);
        let levels = [1e-2, 1e-3, MIN_P_VALUE];
        let mut passed = [0_u32; 3];
        for _ in 0..50_000 {
            let p = pooled_p_value(machine.record(0.0).into_iter()).unwrap();
            for (passed, level) in passed.iter_mut().zip(levels) {
                *passed += u32::from(p < level);
            }
        }
        for (passed, level) in passed.into_iter().zip(levels) {
            let part = f64::from(passed) / 5e4;
            // An excursion lasts for a few records: at the lowest level, 10 may pass where 5 are expected.
            assert!(part <= 2.0 * level, "{part} below {level} at a correlation of {correlation}");
        }
    }
}

/// 1.7 standard deviations on every channel: within ten records, all channels together flag more machines
/// than the first channel does.
#[test]
fn a_small_deviation_on_each_channel_is_detected_jointly() {
    let (mut together, mut alone) = (0, 0);
    for seed in 0..200 {
        let mut machine = Machine::new(100 + seed, 0.2);
        for _ in 0..50 {
            machine.record(0.0);
        }
        let (mut joint, mut single) = (1.0_f64, 1.0_f64);
        for _ in 0..10 {
            let p_values = machine.record(1.7);
            joint = joint.min(pooled_p_value(p_values.into_iter()).unwrap());
            single = single.min(p_values[0]);
        }
        together += u32::from(joint < MIN_P_VALUE);
        alone += u32::from(single < MIN_P_VALUE);
    }
    assert!(together > 180 && together > alone, "{together} together, {alone} alone, of 200");
}

#[test]
fn no_depth_is_claimed_where_one_channel_is_outside_the_library() {
    let (calm, novel) = (estimated(0.0, 2.0), estimate(WearStatus::OutsideLibrary, 1e-12));
    let joint = JointEstimate::of(&[("a1", &calm), ("a2", &novel)]).unwrap();
    assert_eq!((joint.leading, joint.wear.status), (1, WearStatus::OutsideLibrary));
    assert_eq!((joint.wear.median_um, joint.wear.high_um), (None, None));
    assert_eq!(joint.wear.reason, "channel a2: reason");
    let parts: Vec<_> = joint.channels.iter().map(|part| (part.channel.as_str(), part.status)).collect();
    assert_eq!(parts, [("a1", WearStatus::Estimated), ("a2", WearStatus::OutsideLibrary)]);
    assert_eq!(joint.channels[0].high_um, Some(2.0));
}

#[test]
fn channels_that_all_deviate_a_little_are_named_together() {
    let mut channels = vec![estimated(0.0, 2.0); 4];
    for (wear, p_value) in channels.iter_mut().zip([1e-3, 1e-4, 1e-4, 1e-4]) {
        wear.novelty.as_mut().unwrap().p_value = p_value;
    }
    let latest: Vec<(&str, &WearEstimate)> = ["a1", "a2", "a3", "a4"].into_iter().zip(&channels).collect();
    let joint = JointEstimate::of(&latest).unwrap();
    assert_eq!((joint.leading, joint.wear.status), (1, WearStatus::OutsideLibrary));
    assert!(joint.wear.reason.starts_with("no wear explains the channels together"));
    let parts = "a1 (novelty 3.0), a2 (novelty 4.0), a3 (novelty 4.0), a4 (novelty 4.0)";
    assert!(joint.wear.reason.ends_with(parts), "{}", joint.wear.reason);
    let novelty = joint.wear.novelty.unwrap();
    assert!(novelty.outside && novelty.score > 4.0 && joint.wear.median_um.is_none());
    // The order of the channels does not matter.
    let reversed: Vec<_> = latest.iter().rev().copied().collect();
    let other = JointEstimate::of(&reversed).unwrap().wear.novelty.unwrap();
    assert!((other.p_value / novelty.p_value - 1.0).abs() < 1e-9);
}

#[test]
fn depths_of_channels_are_mixed() {
    let (thin, thick, unclear) =
        (estimated(0.0, 9.0), estimated(20.0, 29.0), estimate(WearStatus::NotIdentifiable, 0.5));
    let same = JointEstimate::of(&[("a1", &thin), ("a2", &thin)]).unwrap().wear;
    let alone = DepthGrid::of(&thin.posterior.as_ref().unwrap().wear_um);
    assert_eq!(same.median_um, Some(alone.quantile_um(&thin.posterior.as_ref().unwrap().probability, 0.5)));
    let joint = JointEstimate::of(&[("a1", &thin), ("a2", &unclear), ("a3", &thick)]).unwrap().wear;
    assert_eq!((joint.status, joint.above_limit), (WearStatus::Estimated, Some(0.5)));
    assert!(joint.low_um.unwrap() < 1.5 && joint.high_um.unwrap() > 27.0, "{joint:?}");
    assert!(joint.reason.ends_with("from channels a1, a3"), "{}", joint.reason);
    let far = estimated(80.0, 89.0);
    let joint = JointEstimate::of(&[("a1", &thin), ("a2", &far)]).unwrap().wear;
    assert_eq!(joint.status, WearStatus::NotIdentifiable);
    assert!(joint.reason.starts_with("channels a1, a2 disagree"), "{}", joint.reason);
}

#[test]
fn a_sensor_fault_is_reported_with_the_other_channels_estimate() {
    let (calm, mut dead) = (estimated(0.0, 2.0), estimate(WearStatus::SensorFault, 1e-20));
    dead.novelty.as_mut().unwrap().sensor_fault = Some(crate::estimate::SensorFault::Dead);
    "the sensor gives no signal".clone_into(&mut dead.reason);
    let joint = JointEstimate::of(&[("a1", &dead), ("a2", &calm)]).unwrap();
    assert_eq!((joint.leading, joint.wear.status), (1, WearStatus::Estimated));
    assert!(joint.wear.reason.ends_with("; channel a1: the sensor gives no signal"));
    let all = JointEstimate::of(&[("a1", &dead), ("a2", &dead)]).unwrap();
    assert_eq!((all.leading, all.wear.status), (0, WearStatus::SensorFault));
    assert!(JointEstimate::of(&[]).is_none());
}

fn times(first_s: i64, latest_s: i64, count: u64) -> RecordTimes {
    let at = |s| Timestamp::from_second(s).unwrap();
    RecordTimes { first: at(first_s), latest: at(latest_s), count }
}

#[test]
fn a_channel_that_missed_more_than_ten_of_its_records_is_silent() {
    let every_minute = times(0, 6000, 101);
    let slower = times(0, 5400, 10);
    assert_eq!(RecordTimes::silent(&[every_minute, times(0, 5400, 91), slower]), [false, false, false]);
    assert_eq!(RecordTimes::silent(&[every_minute, times(0, 5399, 91)]), [false, true]);
    // One record has no interval: that of the slowest other channel is used.
    assert_eq!(RecordTimes::silent(&[every_minute, times(0, 0, 1)]), [false, true]);
    assert_eq!(RecordTimes::silent(&[every_minute, times(0, 0, 1), slower]), [false, false, false]);
    assert_eq!(RecordTimes::silent(&[times(0, 0, 1), times(90_000, 90_000, 1)]), [false, false]);
}

#[test]
fn a_silent_channel_is_named_and_not_included() {
    let (near, far) = (estimated(10.0, 20.0), estimated(40.0, 60.0));
    let mut joint = JointEstimate::of(&[("near", &near)]).unwrap();
    joint.add_silent_channel("far", &far, Timestamp::from_second(0).unwrap());
    assert_eq!((joint.wear.low_um, joint.wear.high_um), (near.low_um, near.high_um));
    assert!(joint.wear.reason.ends_with("channel far is not included: no record since 1970-01-01T00:00:00Z"));
    assert_eq!(joint.channels[1].silent_since, Timestamp::from_second(0).ok());
    assert_eq!(joint.channels[0].silent_since, None);
}
