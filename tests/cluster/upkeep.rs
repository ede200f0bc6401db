//! Periodic upkeep makes up for lost notifications.

use std::time::Duration;

use flankwatch::store::{Store, StoreError, StoreSettings};
use serde_json::json;

use super::nodes::{TestCluster, database};
use crate::running::{minute, plain_asset, record};

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and NATS at FLANKWATCH_TEST_NATS"]
fn upkeep_analyses_earlier_records_for_a_new_asset_of_the_sensor() {
    let cluster = TestCluster::start(1, 2);
    let node = cluster.client(0);
    node.send_json("POST", "/v1/assets", &plain_asset("first"), 201);
    for n in 0..8 {
        node.upload("first", &record("in", n));
    }
    node.wait_for_segments("first", 8);
    let mut second = plain_asset("second");
    second["gear"] = json!({ "teeth": [17, 50], "shaft_speed_hz": 5.0, "shaft_ratio": [31, 62] });
    second["sensor"]["of"] = json!("first");
    let second = serde_json::from_value(second).unwrap();
    cluster.behind_their_backs(async |store| store.insert_asset(&second, None, minute(0)).await.unwrap());
    node.wait_for_segments("second", 8);
    let late = cluster.behind_their_backs(async |store| {
        for _ in 0..200 {
            let late = store.late_members(10).await.unwrap();
            if late.is_empty() {
                return late;
            }
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        }
        store.late_members(10).await.unwrap()
    });
    assert!(late.is_empty(), "{late:?} is looked at again and again");
}

/// Creates an unreferenced object, as another process may have left it.
fn put_orphan(cluster: &TestCluster) -> String {
    cluster.behind_their_backs(async |store| {
        let store = store.clone();
        let put = move || {
            let bytes = b"nobody's".as_slice();
            let name = flankwatch::store::Objects::name(bytes);
            store.objects().put_all(&[(name.clone(), bytes.into())], &[]).unwrap();
            name
        };
        tokio::task::spawn_blocking(put).await.unwrap()
    })
}

/// Returns which of these objects are in quarantine.
fn quarantined(cluster: &TestCluster) -> Vec<String> {
    cluster.behind_their_backs(async |store| {
        let store = store.clone();
        let list = move || store.objects().quarantined().unwrap();
        let listed = tokio::task::spawn_blocking(list).await.unwrap();
        listed.into_iter().map(|quarantined| quarantined.name).collect()
    })
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and NATS at FLANKWATCH_TEST_NATS"]
fn old_objects_in_the_queue_are_kept_and_unreferenced_ones_are_quarantined() {
    let mut cluster = TestCluster::start(1, 0);
    let node = cluster.client(0);
    node.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    for n in 0..3 {
        node.upload("pump", &record("in", n));
    }
    let orphan = put_orphan(&cluster);
    let _keeper = cluster.keeper(Duration::ZERO, 0);
    let began = std::time::Instant::now();
    while quarantined(&cluster).is_empty() {
        assert!(began.elapsed() < Duration::from_secs(60), "nothing is in quarantine");
        std::thread::sleep(Duration::from_millis(50));
    }
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(quarantined(&cluster), [orphan]);
    cluster.start_worker();
    node.wait_for_segments("pump", 3);
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and NATS at FLANKWATCH_TEST_NATS"]
fn a_worker_whose_clock_is_ahead_expires_nothing() {
    let mut cluster = TestCluster::start(1, 0);
    put_orphan(&cluster);
    let _keeper = cluster.keeper(Duration::from_secs(7 * 24 * 3600), 8);
    std::thread::sleep(Duration::from_secs(3));
    assert!(quarantined(&cluster).is_empty());
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and NATS at FLANKWATCH_TEST_NATS"]
fn a_cluster_does_not_start_on_another_clusters_bucket() {
    let cluster = TestCluster::start(1, 1);
    let mut mine = cluster.settings();
    let other = database();
    mine.database_url = other.settings(&cluster.objects_folder()).database_url;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    let opened = runtime.block_on(Store::open(&StoreSettings::Shared(mine)));
    assert!(matches!(opened, Err(StoreError::OtherStore { .. })), "{opened:?}");
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and NATS at FLANKWATCH_TEST_NATS"]
fn leases_and_uploads_expire_by_the_databases_clock() {
    let cluster = TestCluster::start(1, 0);
    cluster.client(0).send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    cluster.behind_their_backs(async |store| {
        let now = jiff::Timestamp::now();
        let ahead = now + jiff::SignedDuration::from_hours(8 * 24);
        assert!(store.begin_building("library", now).await.unwrap());
        assert!(!store.begin_building("library", ahead).await.unwrap());
        let upload = flankwatch::store::NewUpload {
            id: "upload".to_owned(),
            asset: flankwatch::asset::AssetId::new("pump").unwrap(),
            length: 10,
            expires_at: now + jiff::SignedDuration::from_hours(24),
        };
        assert!(store.begin_resumable(&upload, 256, 64).await.unwrap());
        assert!(store.expire_resumable(ahead, 10).await.unwrap().is_empty());
        assert!(store.resumable("upload", ahead).await.unwrap().is_some());
    });
}
