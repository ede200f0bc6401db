//! Tests of forecasts of when wear passes the limit, which is at 200 µm.

use jiff::SignedDuration;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::tests::{NEED, seen, tracker};
use super::*;
use crate::estimate::prognosis::Prognosis;
use crate::library::FlankPlace;
use crate::library::testing::synthetic_library;

fn at(hours: u32) -> Timestamp {
    Timestamp::UNIX_EPOCH + SignedDuration::from_hours(hours.into())
}

/// Records of a machine that wears by 1.2 µm an hour after its baseline, and the last estimate. The teeth may
/// be inspected at a record, with an error of the true depth by a factor.
fn after(records: u32, inspected: Option<(u32, f64)>) -> WearEstimate {
    let library = Arc::new(synthetic_library());
    let tracker = tracker(&library);
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let mut state = tracker.start();
    let mut last = None;
    for record in 0..NEED + records {
        let um = 1.2 * f64::from(record.saturating_sub(NEED));
        if let Some((_, factor)) = inspected.filter(|(when, _)| record == NEED + when) {
            let inspection =
                Inspection { depth_um: factor * um, error_um: 2.0, gear: None, place: FlankPlace::Greatest };
            let event = MaintenanceEvent {
                time: at(record),
                kind: MaintenanceKind::Inspected,
                by: String::new(),
                comment: String::new(),
                inspection: Some(inspection),
                until: None,
            };
            tracker.event(&mut state, &event);
        }
        last = Some(tracker.update(&mut state, at(record), &seen(&library, um, 0.05, &mut rng)));
    }
    last.unwrap()
}

fn hours_left(forecast: &Prognosis, records: u32) -> [f64; 3] {
    let hours = |time: Timestamp| time.duration_since(at(NEED + records - 1)).as_secs_f64() / 3600.0;
    [forecast.p05, forecast.median, forecast.p95.unwrap()].map(hours)
}

#[test]
fn the_interval_of_a_forecast_is_as_wide_as_the_trend_is_uncertain() {
    for records in [60, 90, 120] {
        let left = 200.0 / 1.2 - f64::from(records - 1);
        let [early, median, late] = hours_left(&after(records, None).prognosis.unwrap(), records);
        assert!(early < left && left < late, "{left} h: {early} to {late} h");
        assert!((0.5..2.0).contains(&(median / left)), "{left} h: {median} h");
        assert!(late < 8.0 * left, "{left} h: {late} h");
    }
}

/// An inspection that corrects the depth by a third is no growth by a third within an hour.
#[test]
fn a_corrected_depth_is_no_growth() {
    let rate = |inspected| after(90, inspected).prognosis.unwrap().rate_um_per_day;
    let without = rate(None);
    for factor in [0.75, 1.33] {
        let with = rate(Some((80, factor)));
        assert!((0.6..1.6).contains(&(with / without)), "{with} in place of {without} µm a day");
    }
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
