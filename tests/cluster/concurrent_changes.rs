//! Processes that change the same things of one database concurrently: tables, quotas, descriptions.

use flankwatch::asset::{AssetId, AssetSpec};
use flankwatch::service::Precondition;
use flankwatch::store::{Store, StoreSettings};
use serde_json::json;

use super::nodes::{database, runtime};
use super::workers::{asset, records, send, worker};
use crate::running::plain_asset;

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE"]
fn concurrently_started_nodes_create_the_tables_once() {
    let database = database();
    let folder = tempfile::tempdir().unwrap();
    let settings = StoreSettings::Shared(database.settings(folder.path()));
    runtime().block_on(async {
        let opened = futures_util::future::join_all((0..6).map(|_| Store::open(&settings))).await;
        for store in opened {
            let store = store.unwrap();
            store.check().await.unwrap();
            store.close().await;
        }
    });
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE"]
fn workers_that_enforce_a_quota_concurrently_remove_no_more_than_needed() {
    let database = database();
    let folder = tempfile::tempdir().unwrap();
    let spec = asset("pump");
    let all = records(&spec.id, "1", 24);
    runtime().block_on(async {
        let settings = StoreSettings::Shared(database.settings(folder.path()));
        let mut workers = Vec::new();
        for _ in 0..4 {
            workers.push(worker(&settings, folder.path()).await);
        }
        workers[0].assets.create(&spec).await.unwrap();
        for sent in &all {
            send(&workers[0], sent).await;
        }
        let volume: u64 = all.iter().map(|(_, bytes)| bytes.len() as u64).sum();
        let largest = all.iter().map(|(_, bytes)| bytes.len() as u64).max().unwrap();
        for quota in [volume / 2, volume / 4] {
            let deleted =
                workers.iter().map(|worker| worker.store.delete_oldest_raw(Some(&spec.id), quota, 256));
            let deleted = futures_util::future::join_all(deleted).await;
            assert_eq!(deleted.iter().filter(|one| one.as_ref().unwrap().objects > 0).count(), 1);
            let left = workers[0].store.raw_volumes().await.unwrap()["pump"];
            assert!(left <= quota && left + largest > quota, "{left} of {volume} left, expected {quota}");
        }
        for worker in &workers {
            worker.store.close().await;
        }
    });
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE"]
fn nodes_that_describe_assets_of_one_sensor_concurrently_stay_consistent() {
    let database = database();
    let folder = tempfile::tempdir().unwrap();
    let listener = |n: usize, of: &str| -> AssetSpec {
        let mut spec = plain_asset(&format!("mesh{n}"));
        spec["sensor"]["of"] = json!(of);
        serde_json::from_value(spec).unwrap()
    };
    let plain = |id: &str| -> AssetSpec { serde_json::from_value(plain_asset(id)).unwrap() };
    runtime().block_on(async {
        let settings = StoreSettings::Shared(database.settings(folder.path()));
        let mut nodes = Vec::new();
        for n in 0..4 {
            nodes.push(worker(&settings, &folder.path().join(n.to_string())).await);
        }
        nodes[0].assets.create(&plain("first")).await.unwrap();
        // More assets than a sensor may have.
        let specs: Vec<AssetSpec> = (0..16).map(|n| listener(n, "first")).collect();
        let made = specs.iter().enumerate().map(|(n, spec)| nodes[n % 4].assets.create(spec));
        let made = futures_util::future::join_all(made).await;
        let refused = made.iter().filter_map(|made| made.as_ref().err());
        for error in refused {
            assert!(error.to_string().contains("fewer than 8"), "{error}");
        }
        let there = nodes[0].store.assets_of_sensor(&plain("first").id).await.unwrap().len();
        assert_eq!(made.iter().filter(|made| made.is_ok()).count() + 1, there);
        assert_eq!(there, flankwatch::asset::MAX_ON_ONE_SENSOR, "{made:?}");
        // An asset is deleted while another one is created on its sensor: one of the requests fails with the
        // reason.
        for n in 100..110 {
            let of = format!("sensor{n}");
            let through = listener(n, &of);
            nodes[0].assets.create(&plain(&of)).await.unwrap();
            let id = AssetId::new(of).unwrap();
            let always = Precondition::default();
            let (made, gone) =
                tokio::join!(nodes[1].assets.create(&through), nodes[2].assets.delete(&id, &always));
            match (made, gone) {
                (Ok(_), Err(error)) => assert!(error.to_string().contains(through.id.as_str()), "{error}"),
                (Err(error), Ok(())) => assert!(error.to_string().contains("sensor.of"), "{error}"),
                other => panic!("{other:?}"),
            }
        }
        for node in &nodes {
            node.store.close().await;
        }
    });
}
