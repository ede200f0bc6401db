//! Thinning of the results of old records, whose raw bytes are gone.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::alarms::{act, at_once, history_entries, loud, wait_for_alarm, watched, whole};
use crate::running::{Service, mcap, minute, plain_asset, record};
use flankwatch::asset::AssetId;
use flankwatch::service::OldResults;
use flankwatch::store::{StoredEvent, Thinning};
use jiff::SignedDuration;

const RECORDS: u32 = 240;

fn minutes(n: u64) -> Duration {
    Duration::from_secs(60 * n)
}

fn thinning() -> Thinning {
    Thinning {
        now: minute(365 * 24 * 60),
        age: SignedDuration::from_mins(100),
        interval: SignedDuration::from_mins(10),
    }
}

/// Thins results that are older than 100 minutes to one in ten minutes; returns how many records went.
fn thin(service: &Service) -> u64 {
    service.run(service.service().store.thin_results(thinning())).unwrap()
}

/// Sends one record a minute for four hours, with a service of the machine after the first.
fn send(service: &Service) {
    service.plain_asset("pump");
    let event = json!({ "time": minute(60), "kind": "gear_replaced", "by": "a mechanic" });
    service.post_json("/v1/assets/pump/maintenance", &event).expect(201);
    let records: Vec<_> = (0..RECORDS).map(|n| record("1", n)).collect();
    service.post("/v1/assets/pump/segments", "application/mcap", &mcap(&records)).expect(201);
}

fn items(service: &Service) -> Vec<Value> {
    let trend = service.get("/v1/assets/pump/wear/history?max_points=1000").expect(200).json();
    trend["items"].as_array().unwrap().clone()
}

fn wait_for_the_quota(service: &Service) {
    let oldest = items(service)[0]["segment_id"].as_str().unwrap().to_owned();
    let began = Instant::now();
    while service.get(&format!("/v1/segments/{oldest}/waveform")).status != 410 {
        assert!(began.elapsed() < Duration::from_secs(60), "the quota is not applied");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn of_old_records_one_in_each_interval_is_kept_with_its_results() {
    let service = Service::start_with(|config| config.work.quotas.bytes = Some(100_000));
    send(&service);
    let all = items(&service);
    assert_eq!(all.len(), RECORDS as usize);
    wait_for_the_quota(&service);
    // The baseline is of 8 records, and twice as many are kept after the start and after the event.
    let is_kept = |n: u32| n < 16 || (60..76).contains(&n) || n.is_multiple_of(10) || n >= RECORDS - 1 - 100;
    let kept: Vec<Value> =
        (0..RECORDS).zip(&all).filter(|(n, _)| is_kept(*n)).map(|(_, item)| item.clone()).collect();
    assert_eq!(thin(&service), u64::from(RECORDS) - kept.len() as u64);
    assert_eq!(items(&service), kept);
    assert_eq!(service.get("/v1/assets/pump").expect(200).json()["summary"]["segments"], kept.len());
    assert_eq!(thin(&service), 0);

    // The history that is left can be folded again, and goes on.
    let mut asset = plain_asset("pump");
    asset["baseline"]["records"] = json!(10);
    service.put_json("/v1/assets/pump", &asset).expect(200);
    service.upload("pump", &record("1", RECORDS));
    service.wait_for("/v1/assets/pump", |asset| asset["summary"]["segments"] == kept.len() + 1);
    let folded = service.wait_for("/v1/assets/pump/wear/history?max_points=1000", |trend| {
        trend["items"].as_array().unwrap().iter().all(|item| item["status"] != "recomputing")
    });
    assert_eq!(folded["items"].as_array().unwrap().len(), kept.len() + 1);
}

#[test]
fn records_after_an_event_that_is_being_added_are_kept() {
    let service = Service::start_with(|config| config.work.quotas.bytes = Some(100_000));
    send(&service);
    wait_for_the_quota(&service);
    let event = json!({ "time": minute(100), "kind": "gear_replaced", "by": "a mechanic" });
    let event = StoredEvent::new(serde_json::from_value(event).unwrap()).unwrap();
    service.run(async {
        let store = service.service().store.clone();
        let mut transaction = store.begin().await.unwrap();
        transaction.add_maintenance(&AssetId::new("pump").unwrap(), &event).await.unwrap();
        let thinning = tokio::spawn(async move { store.thin_results(thinning()).await.unwrap() });
        // It waits for this transaction.
        tokio::time::sleep(Duration::from_millis(300)).await;
        transaction.commit().await.unwrap();
        assert!(thinning.await.unwrap() > 0);
    });
    let kept: Vec<Value> = items(&service);
    for n in 100..116 {
        assert!(kept.iter().any(|item| item["start_time"] == json!(minute(n))), "minute {n}");
    }
}

#[test]
fn an_operator_action_after_thinning_follows_the_raised_alarm_and_is_stored_once() {
    let service = Service::start_with(|config| config.work.quotas.bytes = Some(100_000));
    service.post_json("/v1/assets", &watched("pump", &at_once())).expect(201);
    let factor = |n| if n + 1 < RECORDS { 1.0 } else { 4.0 };
    let records: Vec<_> = (0..RECORDS).map(|n| loud(n, factor(n))).collect();
    service.post("/v1/assets/pump/segments", "application/mcap", &mcap(&records)).expect(201);
    wait_for_the_quota(&service);
    assert!(thin(&service) > 0);
    let alarm = wait_for_alarm(&service, "pump", |_| true);
    act(&service, &alarm, "acknowledge", &json!({ "by": "Ada" })).expect(200);
    let entries = history_entries(&whole(&service, "pump"));
    let states: Vec<&Value> = entries.iter().map(|entry| &entry[0]).collect();
    assert_eq!(states, ["unacknowledged", "acknowledged"]);
    service.upload("pump", &loud(RECORDS, 4.0));
    assert_eq!(history_entries(&whole(&service, "pump")), entries);
}

#[test]
fn results_of_records_with_raw_bytes_are_all_kept() {
    let service = Service::start();
    send(&service);
    assert_eq!(thin(&service), 0);
    assert_eq!(items(&service).len(), RECORDS as usize);
}

#[test]
fn a_service_thins_by_itself() {
    let mut service = Service::start_with(|config| {
        config.work.quotas.bytes = Some(100_000);
        config.work.old_results = Some(OldResults { age: minutes(100), interval: minutes(10) });
    });
    send(&service);
    wait_for_the_quota(&service);
    // The next round is due an hour after the first one, at the start.
    service.stop();
    service.clock.advance(2 * 24 * 3600);
    service.launch();
    service.wait_for("/v1/assets/pump", |asset| asset["summary"]["segments"] != RECORDS);
}
