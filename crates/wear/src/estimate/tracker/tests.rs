//! Tests of the fold over records of a synthetic library.

use flankwatch_signal::{BearingLine, ByName, EnvelopeLine, LineSource, NotComputed};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use super::super::novelty::SuspectedFault;
use super::*;
use crate::library::testing::synthetic_library;
use crate::library::{FlankPlace, Library};

pub(super) const NEED: u32 = 20;

pub(super) fn settings() -> EstimatorSettings {
    EstimatorSettings { baseline_records: NEED, limit_um: Some(200.0) }
}

/// Noisy features that the synthetic library gives at a wear depth through a path with its own gain per line.
pub(super) fn seen(library: &Library, wear_um: f64, noise: f64, rng: &mut ChaCha8Rng) -> Features {
    let states = library.states();
    let step = library.max_wear_um() / (states.len() - 1) as f64;
    let lower = ((wear_um / step) as usize).min(states.len() - 2);
    let part = wear_um / step - lower as f64;
    let scatter = Normal::new(0.0, noise).unwrap();
    let values: ByName<f64> = states[lower]
        .features
        .values
        .iter()
        .enumerate()
        .map(|(i, (name, low))| {
            let high = states[lower + 1].features.values[name];
            let path_gain = (i as f64 * 1.7).sin();
            (name.clone(), low + part * (high - low) + path_gain + scatter.sample(rng))
        })
        .collect();
    let background = values.keys().map(|name| (name.clone(), -6.0)).collect();
    Features { values, background, ..Features::default() }
}

pub(super) fn tracker(library: &Arc<Library>) -> Tracker {
    Tracker::new(settings(), Some(Arc::new(Ensemble::of(library.clone()))))
}

/// A run from 0 to 240 µm: the estimates after the baseline, with the true depths.
fn run(library: &Arc<Library>, records: usize, seed: u64) -> Vec<(WearEstimate, f64)> {
    let tracker = tracker(library);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut state = tracker.start();
    for _ in 0..NEED {
        tracker.update(&mut state, Timestamp::UNIX_EPOCH, &seen(library, 0.0, 0.05, &mut rng));
    }
    (0..records)
        .map(|i| {
            let truth = 240.0 * i as f64 / (records - 1) as f64;
            (tracker.update(&mut state, Timestamp::UNIX_EPOCH, &seen(library, truth, 0.05, &mut rng)), truth)
        })
        .collect()
}

#[test]
fn the_baseline_is_counted_and_no_depth_is_claimed_meanwhile() {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut state = tracker.start();
    for have in 1..=NEED {
        let wear = tracker.update(&mut state, Timestamp::UNIX_EPOCH, &seen(&library, 0.0, 0.05, &mut rng));
        assert_eq!((wear.status, wear.median_um), (WearStatus::CollectingBaseline, None));
        assert_eq!(wear.reason, format!("collecting baseline, {have} of {NEED}"));
    }
    let wear = tracker.update(&mut state, Timestamp::UNIX_EPOCH, &seen(&library, 0.0, 0.05, &mut rng));
    assert_eq!(wear.status, WearStatus::Estimated);
    assert!(wear.low_um.unwrap() <= 2.0 && wear.high_um.unwrap() < 40.0, "{}", wear.reason);
    let quantiles = [wear.low_um, wear.p25_um, wear.median_um, wear.p75_um, wear.high_um].map(Option::unwrap);
    assert!(quantiles.is_sorted() && quantiles[1] < quantiles[3], "{quantiles:?}");
}

#[test]
fn a_run_through_an_unknown_path_is_followed_and_its_interval_holds_the_truth() {
    let library = Arc::new(synthetic_library());
    let mut error_um = 0.0;
    let mut covered = 0;
    let mut count = 0;
    for seed in 0..5 {
        for (wear, truth) in run(&library, 200, seed) {
            error_um += (wear.median_um.unwrap() - truth).abs();
            covered += usize::from((wear.low_um.unwrap()..=wear.high_um.unwrap()).contains(&truth));
            count += 1;
        }
    }
    let (error_um, coverage) = (error_um / f64::from(count), covered as f64 / f64::from(count));
    // Four lines, each with a model error of up to a half: a tenth of the library's depths.
    assert!(error_um < 24.5, "mean error {error_um} µm");
    assert!(coverage >= 0.85, "the 90 % interval holds the truth in {coverage} of the records");
}

#[test]
fn a_record_without_its_mesh_line_is_not_counted_into_the_baseline() {
    let tracker = Tracker::new(settings(), None);
    let mut state = tracker.start();
    let wear = tracker.update(&mut state, Timestamp::UNIX_EPOCH, &Features::default());
    assert_eq!((wear.status, wear.baseline.have), (WearStatus::NoFeatures, 0));
}

#[test]
fn a_baseline_that_lacks_most_records_leaves_the_depth_open_until_an_inspection() {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let healthy_after = |state: &mut TrackerState, records: u32, rng: &mut ChaCha8Rng| {
        let mut update = || tracker.update(state, Timestamp::UNIX_EPOCH, &seen(&library, 0.0, 0.05, rng));
        (1..records).for_each(|_| drop(update()));
        update()
    };
    let status_after = |passed_over: u32, event: Option<MaintenanceKind>| {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut state = tracker.start();
        for i in 0..NEED + passed_over {
            let healthy = seen(&library, 0.0, 0.05, &mut rng);
            let features = match i.checked_sub(NEED - 1) {
                Some(beyond) if beyond >= passed_over => healthy,
                Some(_) if i % 2 == 0 => Features { fault: Some(NotComputed::Clipped), ..healthy },
                Some(_) => Features { speed_doubt: Some("another mesh fits".to_owned()), ..healthy },
                None => healthy,
            };
            tracker.update(&mut state, Timestamp::UNIX_EPOCH, &features);
        }
        let Some(kind) = event else { return healthy_after(&mut state, 1, &mut rng) };
        let inspection = (kind == MaintenanceKind::Inspected).then(|| Inspection {
            depth_um: 0.0,
            error_um: 5.0,
            gear: None,
            place: FlankPlace::default(),
        });
        let (time, by) = (Timestamp::UNIX_EPOCH, "Ada".to_owned());
        let event = MaintenanceEvent { time, kind, by, comment: String::new(), inspection, until: None };
        tracker.event(&mut state, &event);
        healthy_after(&mut state, NEED + 1, &mut rng)
    };
    assert_eq!(status_after(NEED, None).status, WearStatus::Estimated);
    let wear = status_after(NEED + 1, None);
    assert_eq!(wear.status, WearStatus::NotIdentifiable);
    assert!(
        wear.reason.contains("21 records before its end were clipped or had a speed in doubt"),
        "{}",
        wear.reason
    );
    for (kind, status) in [
        (MaintenanceKind::Inspected, WearStatus::Estimated),
        (MaintenanceKind::GearReplaced, WearStatus::Estimated),
        (MaintenanceKind::SensorReplaced, WearStatus::NotIdentifiable),
    ] {
        assert_eq!(status_after(NEED + 1, Some(kind)).status, status, "{kind:?}");
    }
}

#[test]
fn the_reason_names_what_is_wrong_with_a_records_samples() {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let healthy = seen(&library, 0.0, 0.05, &mut ChaCha8Rng::seed_from_u64(1));
    let clipped = Features { fault: Some(NotComputed::Clipped), ..healthy };
    let wear = tracker.update(&mut tracker.start(), Timestamp::UNIX_EPOCH, &clipped);
    assert_eq!(wear.status, WearStatus::NoFeatures);
    assert_eq!(wear.reason, "the signal is clipped, so this record is not used");
}

#[test]
fn without_a_library_the_status_says_so() {
    let library = synthetic_library();
    let tracker = Tracker::new(settings(), None);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut state = tracker.start();
    for _ in 0..NEED {
        tracker.update(&mut state, Timestamp::UNIX_EPOCH, &seen(&library, 0.0, 0.05, &mut rng));
    }
    assert_eq!(
        tracker.update(&mut state, Timestamp::UNIX_EPOCH, &seen(&library, 0.0, 0.05, &mut rng)).status,
        WearStatus::NoLibrary
    );
}

#[test]
fn a_speed_in_doubt_is_reported_without_a_library_too_and_excluded_from_the_baseline() {
    let tracker = Tracker::new(settings(), None);
    let normal = Normal::new(0.0, 0.02).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut state = tracker.start();
    let mut take = |doubt: Option<&str>, level: f64| {
        let octaves = [1000, 2000, 4000, 8000];
        let checks = octaves.map(|hz| (format!("ln_floor_{hz}hz"), level + normal.sample(&mut rng)));
        let speed_doubt = doubt.map(str::to_owned);
        let features = Features { checks: checks.into(), speed_doubt, ..Features::default() };
        tracker.update(&mut state, Timestamp::UNIX_EPOCH, &features)
    };
    let doubted = take(Some("the lines fit another mesh"), 0.0);
    assert_eq!((doubted.status, doubted.baseline.have), (WearStatus::SpeedInDoubt, 0));
    assert_eq!(doubted.reason, "the lines fit another mesh");
    for have in 1..=NEED {
        assert_eq!(take(None, 0.0).baseline.have, have);
    }
    assert_eq!(take(None, 0.0).status, WearStatus::NoLibrary);
    let doubted = take(Some("the lines fit another mesh"), 0.0);
    assert_eq!(doubted.status, WearStatus::SpeedInDoubt);
    assert!(doubted.novelty.is_some_and(|novelty| !novelty.outside));
    assert_eq!(take(Some("the lines fit another mesh"), 1.0).status, WearStatus::OutsideLibrary);
}

#[test]
fn first_records_at_a_doubtful_given_speed_ask_about_it() {
    let library = synthetic_library();
    let tracker = Tracker::new(settings(), None);
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut state = tracker.start();
    let doubt =
        "the lines fit 24 × 16.64 Hz better than 32 × 30.00 Hz; are the tooth counts and the speed correct?";
    let mut take = || {
        let given_speed_doubt = Some(doubt.to_owned());
        let features = Features { given_speed_doubt, ..seen(&library, 0.0, 0.05, &mut rng) };
        tracker.update(&mut state, Timestamp::UNIX_EPOCH, &features)
    };
    for have in 1..=NEED {
        let wear = take();
        assert_eq!((wear.status, wear.baseline.have), (WearStatus::CollectingBaseline, have));
        assert!(wear.reason.ends_with(doubt), "{}", wear.reason);
    }
    assert!(!take().reason.contains(doubt), "asked after the baseline");
}

#[test]
fn while_there_is_no_library_every_answer_says_why() {
    let library = synthetic_library();
    for (missing_library, status, word) in [
        (MissingLibrary::Simulating, WearStatus::AwaitingLibrary, "being simulated"),
        (MissingLibrary::Failed("no teeth".into()), WearStatus::LibraryFailed, "no teeth"),
    ] {
        let tracker = Tracker::without_library(settings(), missing_library);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut state = tracker.start();
        for n in 1..=NEED + 3 {
            let wear =
                tracker.update(&mut state, Timestamp::UNIX_EPOCH, &seen(&library, 0.0, 0.05, &mut rng));
            assert_eq!((wear.status, wear.baseline.have), (status, n.min(NEED)), "{}", wear.reason);
            assert!(wear.reason.contains(word), "{}", wear.reason);
        }
        let wear = tracker.update(&mut state, Timestamp::UNIX_EPOCH, &Features::default());
        assert_ne!(wear.status, WearStatus::NoLibrary);
    }
}

/// The baseline has its usual status; later records have one of their own.
#[test]
fn a_machine_without_a_mesh_is_judged_by_novelty_alone() {
    let record = |level: f64, kurtosis: f64, rng: &mut ChaCha8Rng| {
        let normal = Normal::new(0.0, 0.02).unwrap();
        let mut scatter = || normal.sample(rng);
        let octaves = [1000, 2000, 4000, 8000];
        let checks = octaves.into_iter().flat_map(|hz| {
            let grown = if hz == 4000 { level } else { 0.0 };
            [(format!("ln_floor_{hz}hz"), grown + scatter()), (format!("ln_band_{hz}hz"), grown + scatter())]
        });
        Features {
            checks: checks.collect(),
            values: [("ln_kurtosis".to_owned(), kurtosis.ln() + 0.01)].into(),
            envelope_line: Some(EnvelopeLine {
                frequency_hz: 107.3,
                to_background: 9.0,
                band_hz: [1600.0, 11520.0],
                source: Some(LineSource::Bearing {
                    bearing: "fan".into(),
                    line: BearingLine::Bpfo,
                    harmonic: 1,
                }),
            }),
            ..Features::default()
        }
    };
    let tracker = Tracker::without_library(settings(), MissingLibrary::NoMesh);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut state = tracker.start();
    let mut take = |level: f64, kurtosis: f64| {
        tracker.update(&mut state, Timestamp::UNIX_EPOCH, &record(level, kurtosis, &mut rng))
    };
    for n in 1..=NEED {
        let wear = take(0.0, 3.0);
        assert_eq!((wear.status, wear.baseline.have), (WearStatus::CollectingBaseline, n), "{}", wear.reason);
    }
    let calm = take(0.0, 3.0);
    assert_eq!(calm.status, WearStatus::NoMesh, "{}", calm.reason);
    assert!(calm.novelty.is_some_and(|novelty| novelty.score < 4.0));
    let failing = take(1.0, 9.0);
    assert_eq!(failing.status, WearStatus::OutsideLibrary, "{}", failing.reason);
    for words in [
        "impulses have grown: a bearing fault or looseness",
        "mostly between 2828 and 5657 Hz",
        "line is at 107.3 Hz, the outer race of bearing fan (1 × BPFO)",
    ] {
        assert!(failing.reason.contains(words), "{}", failing.reason);
    }
    assert!(!failing.reason.contains("mesh"), "{}", failing.reason);
}

#[test]
fn a_part_of_the_library_gives_provisional_answers_and_reports_no_fault() {
    let library = synthetic_library();
    let first = Arc::new(Ensemble::of(Arc::new(synthetic_library())));
    let [provisional, whole] = [
        Tracker::provisional(settings(), Arc::clone(&first)),
        Tracker::new(settings(), Some(Arc::clone(&first))),
    ];
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let records: Vec<Features> = (0..NEED + 5)
        .map(|n| {
            let mut record = seen(&library, 0.0, 0.05, &mut rng);
            if n >= NEED + 3 {
                // Changes of the lines that no wear explains.
                let changed = record.values.into_iter().enumerate();
                record.values = changed
                    .map(|(i, (name, value))| (name, value + if i % 2 == 0 { 4.0 } else { -4.0 }))
                    .collect();
            }
            record
        })
        .collect();
    let follow = |tracker: &Tracker| -> Vec<WearEstimate> {
        let mut state = tracker.start();
        records.iter().map(|record| tracker.update(&mut state, Timestamp::UNIX_EPOCH, record)).collect()
    };
    let estimates = follow(&provisional).into_iter().zip(follow(&whole)).skip(NEED as usize);
    for (n, (first, whole)) in estimates.enumerate() {
        assert_eq!((first.status, first.median_um), (WearStatus::Provisional, whole.median_um), "{n}");
        assert_eq!(whole.status == WearStatus::OutsideLibrary, n >= 3, "{}", whole.reason);
        assert!(first.novelty.is_none_or(|novelty| !novelty.outside));
    }
}

#[test]
fn lines_in_the_noise_give_novelty_but_no_depth() {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut state = tracker.start();
    let normal = Normal::new(0.0, 0.02).unwrap();
    let drowned = |level: f64, rng: &mut ChaCha8Rng| {
        let mut features = seen(&library, 0.0, 0.05, rng);
        features.background = features.values.clone();
        let octaves = [1000, 2000, 4000, 8000];
        features.checks =
            octaves.map(|hz| (format!("ln_floor_{hz}hz"), level + normal.sample(rng))).into_iter().collect();
        features
    };
    for _ in 0..NEED {
        tracker.update(&mut state, Timestamp::UNIX_EPOCH, &drowned(0.0, &mut rng));
    }
    let wear = tracker.update(&mut state, Timestamp::UNIX_EPOCH, &drowned(0.0, &mut rng));
    assert_eq!((wear.status, wear.median_um), (WearStatus::NotIdentifiable, None));
    assert!(wear.reason.contains("cannot show wear"), "{}", wear.reason);
    let failing = tracker.update(&mut state, Timestamp::UNIX_EPOCH, &drowned(1.0, &mut rng));
    assert_eq!(failing.status, WearStatus::OutsideLibrary, "{}", failing.reason);
}

#[test]
fn an_unexplained_record_leaves_the_filter_unchanged() {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let mut rng = ChaCha8Rng::seed_from_u64(13);
    let mut state = tracker.start();
    let record = |shift: f64, rng: &mut ChaCha8Rng| {
        let mut features = seen(&library, 0.0, 0.03, rng);
        let scatter = Normal::new(0.0, 0.03).unwrap();
        for band in 1..=4 {
            features.checks.insert(format!("ln_floor_{band}"), -3.0 + scatter.sample(rng));
            features.checks.insert(format!("ln_rest_{band}"), -2.0 + shift + scatter.sample(rng));
        }
        features
    };
    let filter = |state: &TrackerState| match &state.0 {
        Stage::Tracking(tracking) => (tracking.filter.clone(), tracking.clock.clone()),
        Stage::Collecting { .. } => panic!("the baseline is complete"),
    };
    let mut take = |state: &mut TrackerState, shift: f64| {
        tracker.update(state, Timestamp::UNIX_EPOCH, &record(shift, &mut rng))
    };
    for _ in 0..NEED {
        take(&mut state, 0.0);
    }
    let calm = take(&mut state, 0.0);
    assert!(!calm.novelty.unwrap().outside);
    let before = filter(&state);
    let other = take(&mut state, 0.8);
    assert_eq!((other.status, other.median_um), (WearStatus::OutsideLibrary, None));
    let novelty = other.novelty.unwrap();
    assert!(
        novelty.score > 4.0 && novelty.suspected_fault == Some(SuspectedFault::BandEnergy),
        "{novelty:?}"
    );
    assert_eq!(filter(&state), before);
}

/// The depth stays at the library's last one for a long time. One limit lies within the library, the other
/// beyond it.
#[test]
fn at_the_end_of_the_library_a_least_depth_is_reported() {
    let library = Arc::new(synthetic_library());
    let estimates = |limit_um: f64| -> Vec<WearEstimate> {
        let settings = EstimatorSettings { limit_um: Some(limit_um), ..settings() };
        let tracker = Tracker::new(settings, Some(Arc::new(Ensemble::of(library.clone()))));
        let mut rng = ChaCha8Rng::seed_from_u64(19);
        let mut state = tracker.start();
        let update = |record: u32| {
            let um = (f64::from(record.saturating_sub(NEED)) * 1.2).min(245.0);
            let at = Timestamp::UNIX_EPOCH + jiff::SignedDuration::from_hours(i64::from(record));
            tracker.update(&mut state, at, &seen(&library, um, 0.05, &mut rng))
        };
        (0..NEED + 300).map(update).collect()
    };
    let (within, beyond) = (estimates(200.0), estimates(300.0));
    let (early, last) = (NEED as usize + 10, NEED as usize + 299);
    assert!(within[last].at_least_um.is_some_and(|least| least > 150.0), "{}", within[last].reason);
    assert!(within[last].above_limit.is_some_and(|above| above > 0.5));
    assert_eq!(beyond[last].median_um, within[last].median_um);
    assert_eq!((beyond[early].above_limit, beyond[last].above_limit), (Some(0.0), None));
    assert!(beyond[last].reason.contains("the limit of 300 µm lies beyond that"), "{}", beyond[last].reason);
}

#[test]
fn far_from_the_described_speed_intervals_widen_until_records_are_rejected() {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let described = library.pair().operation.shaft_speed_hz;
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let at = |part: f64, wear_um: f64, rng: &mut ChaCha8Rng| {
        let mut features = seen(&library, wear_um, 0.05, rng);
        features.operating_point.shaft_speed_hz = Some(part * described);
        features
    };
    let mut state = tracker.start();
    let idling = tracker.update(&mut state, Timestamp::UNIX_EPOCH, &at(0.3, 0.0, &mut rng));
    assert_eq!((idling.status, idling.baseline.have), (WearStatus::NotComparable, 0));
    for record in 0..NEED {
        // The path is known at all of these speeds.
        let part = [0.6, 1.0, 1.6][record as usize % 3];
        tracker.update(&mut state, Timestamp::UNIX_EPOCH, &at(part, 0.0, &mut rng));
    }
    let worn: Vec<WearEstimate> = [1.0, 0.6]
        .map(|part| {
            let mut state = state.clone();
            (0..40).for_each(|n| {
                let features = at(part, 3.0 * f64::from(n), &mut rng);
                tracker.update(&mut state, Timestamp::UNIX_EPOCH, &features);
            });
            tracker.update(&mut state, Timestamp::UNIX_EPOCH, &at(part, 120.0, &mut rng))
        })
        .into();
    let width = |wear: &WearEstimate| wear.high_um.unwrap() - wear.low_um.unwrap();
    assert!(width(&worn[1]) > 1.1 * width(&worn[0]), "{} and {}", worn[0].reason, worn[1].reason);
    let caveat = "; less certain because the shaft speed is 0.60 times the described one";
    assert!(
        worn[1].reason.ends_with(caveat) && !worn[0].reason.contains("less certain"),
        "{}",
        worn[1].reason
    );
    let mut copy = state.clone();
    let refused = tracker.update(&mut copy, Timestamp::UNIX_EPOCH, &at(2.5, 0.0, &mut rng));
    assert_eq!(refused.status, WearStatus::NotComparable);
    assert!(refused.reason.contains("shaft speed is 2.50 times the described one, expected 0.5 to 2 times"));
    assert_eq!(refused.short_reason.as_deref(), Some("shaft speed × 2.50, × 0.5 to 2 needed"));
    assert!(copy == state, "a rejected record does not change the state");
}
