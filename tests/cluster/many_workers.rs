//! Any number of workers on one database: the same records give the same bits as on one machine, in whatever
//! order and however often they are delivered.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use flankwatch::asset::{AssetId, AssetSpec};
use flankwatch::library::{EnsembleSettings, FIRST_MEMBERS, GridSettings};
use flankwatch::recording::{BlockEncoding, encode_block};
use flankwatch::service::{
    LiveEvent, Precondition, Readiness, RecordFormat, Role, Service, ServiceFolders, UploadMetadata,
    WorkLimits,
};
use flankwatch::store::{AlarmFilter, SegmentFilter, Store, StoreSettings};
use jiff::Timestamp;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use serde_json::json;

use crate::running::{ManualClock, minute, plain_asset, record, samples};
use crate::shared_store::TestDatabase;
use flankwatch_test_support::needed;

/// The bytes of a record, with its asset.
type Sent = (AssetId, Bytes);

fn asset(id: &str) -> AssetSpec {
    let pair =
        flankwatch::gear::PairSpec::from_toml(include_str!("../../fixtures/pairs/shen2022.toml")).unwrap();
    let asset = json!({
        "id": id,
        "gear": { "teeth": pair.geometry.teeth, "shaft_speed_hz": pair.operation.shaft_speed_hz, "pair": pair },
        "baseline": { "records": 8 },
        "alarms": [
            { "quantity": { "indicator": "rms" }, "warning": 1.0, "danger": 1.5, "settings": { "raise": 1, "raise_of": 1, "clear": 1, "clear_of": 1 } },
            { "quantity": "novelty", "warning": 2 },
        ],
    });
    serde_json::from_value(asset).unwrap()
}

/// Returns a changed description, for which the records are analysed again.
fn described_anew(spec: &AssetSpec) -> AssetSpec {
    let mut spec = serde_json::to_value(spec).unwrap();
    spec["bands"] = json!([{ "name": "mesh", "band_hz": [200, 400] }]);
    serde_json::from_value(spec).unwrap()
}

fn records(asset: &AssetId, channel: &str, count: u32) -> Vec<Sent> {
    let one = |n: u32| {
        let mut one = record(channel, n);
        if n % 7 == 3 {
            // Loud enough for an alarm.
            let loud = samples(n).iter().map(|sample| 3.0 * sample).collect();
            one = flankwatch::signal::Record::new(channel, minute(n.into()), 4000.0, "m/s2", loud).unwrap();
        }
        (asset.clone(), Bytes::from(encode_block(&one, BlockEncoding::Protobuf)))
    };
    (0..count).map(one).collect()
}

async fn worker(settings: &StoreSettings, folder: &Path) -> Arc<Service> {
    worker_with(settings, folder, EnsembleSettings::described_alone()).await
}

async fn worker_with(settings: &StoreSettings, folder: &Path, neighbours: EnsembleSettings) -> Arc<Service> {
    let store = Store::open(settings).await.unwrap();
    let folders = ServiceFolders {
        libraries: folder.join("libraries"),
        recordings: folder.join("recordings"),
        uploads: folder.join("uploads"),
        streams: folder.join("streams"),
    };
    let limits = WorkLimits { workers: 1, neighbours, ..WorkLimits::default() };
    let grid = GridSettings { states: 4, seconds: 0.25, ..GridSettings::default() };
    Service::new(store, folders, &limits, grid, Arc::new(ManualClock::default()), Role::Standalone).unwrap()
}

/// Waits until a worker has the complete ensemble of an asset.
async fn simulated(worker: &Service, spec: &AssetSpec) {
    for tries in 0.. {
        let simulation = worker.simulations.of(spec).1;
        if matches!(simulation.readiness, Readiness::Ready(_)) && simulation.progress.is_none() {
            return;
        }
        assert!(tries < 9000, "still {simulation:?}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Processes a record until it succeeds: a worker may request a retry.
async fn send(worker: &Service, (asset, bytes): &Sent) {
    for tries in 0.. {
        let ticket = worker.workers.admit().unwrap();
        let taken = worker
            .pipeline
            .accept(asset, RecordFormat::Protobuf, bytes.clone(), UploadMetadata::default(), ticket)
            .await;
        match taken {
            Ok(_) => return,
            Err(error) => assert!(tries < 100, "{error}"),
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Waits until the histories of an asset are up to date.
async fn settle(worker: &Service, asset: &AssetId, keys: &[String]) {
    for tries in 0.. {
        let channels = worker.store.channels(asset).await.unwrap();
        let found: Vec<String> = channels.iter().map(|channel| format!("{:?}", channel.keys)).collect();
        if channels.iter().all(|channel| !channel.must_fold) && (keys.is_empty() || found == keys) {
            return;
        }
        assert!(tries < 3000, "still {channels:?}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

async fn keys(worker: &Service, asset: &AssetId) -> Vec<String> {
    let channels = worker.store.channels(asset).await.unwrap();
    channels.iter().map(|channel| format!("{:?}", channel.keys)).collect()
}

/// Returns all values of all records, and the alarms.
async fn everything(worker: &Service, asset: &AssetId) -> BTreeMap<String, String> {
    let store = &worker.store;
    let mut all = BTreeMap::new();
    for segment in store.segments(asset, &SegmentFilter::default(), 10_000).await.unwrap() {
        all.insert(segment.id.to_string(), format!("{segment:?}"));
    }
    let filter = AlarmFilter { asset: Some(asset.clone()), ..AlarmFilter::default() };
    for alarm in store.alarms(&filter, Timestamp::UNIX_EPOCH, 100).await.unwrap() {
        let (history, _) = store.alarm_history(&alarm.id, 10_000).await.unwrap();
        // Without the latest readings: those that changed nothing are only in the states of the fold.
        let held = &alarm.alarm;
        let stands = (held.unshelved_state(), held.severity(), held.raised_at(), held.value(), held.last());
        let announced: Vec<_> =
            history.iter().filter(|entry| entry.withdrawn_at.is_none()).map(|entry| &entry.change).collect();
        // Withdrawn changes, which another order of records raised temporarily, are not compared.
        if !announced.is_empty() {
            all.insert(format!("alarm {}", alarm.id), format!("{:?} {stands:?} {announced:?}", alarm.rule));
        }
    }
    all
}

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap()
}

fn database() -> TestDatabase {
    needed(TestDatabase::named(), "FLANKWATCH_TEST_DATABASE, the address of a PostgreSQL database,")
}

/// Returns the results of one machine on SQLite for the records in order: all values, and the keys of the
/// histories.
async fn on_one_machine(
    folder: &Path,
    specs: &[AssetSpec],
    all: &[Sent],
) -> Vec<(Vec<String>, BTreeMap<String, String>)> {
    let alone = worker(&folder.join("alone").as_path().into(), folder).await;
    for spec in specs {
        alone.assets.create(spec).await.unwrap();
        simulated(&alone, spec).await;
    }
    for sent in all {
        send(&alone, sent).await;
    }
    let mut answers = Vec::new();
    for spec in specs {
        answers.push((keys(&alone, &spec.id).await, everything(&alone, &spec.id).await));
    }
    alone.store.close().await;
    answers
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE"]
fn any_number_of_workers_gives_the_bits_of_one_machine() {
    let runtime = runtime();
    let folder = tempfile::tempdir().unwrap();
    let before = ["pump", "fan"].map(asset);
    // One asset is described anew while its records come in.
    let after = [described_anew(&before[0]), before[1].clone()];
    let all: Vec<Sent> = before
        .iter()
        .flat_map(|spec| ["1", "2"].map(|channel| records(&spec.id, channel, 90)))
        .flatten()
        .collect();
    let mut expected = None;
    for count in [1, 2, 4] {
        let database = database();
        let settings = StoreSettings::Shared(database.settings(&folder.path().join(count.to_string())));
        runtime.block_on(async {
            if expected.is_none() {
                expected = Some(on_one_machine(folder.path(), &after, &all).await);
            }
            let mut workers = Vec::new();
            for n in 0..count {
                // Each worker has its own library cache and fetches what another one has built.
                workers.push(worker(&settings, &folder.path().join(format!("{n} of {count}"))).await);
            }
            for spec in &before {
                workers[0].assets.create(spec).await.unwrap();
                // Alarms of records without their library are among the announced changes.
                for worker in &workers {
                    simulated(worker, spec).await;
                }
            }
            let mut tasks = tokio::task::JoinSet::new();
            for (n, worker) in workers.iter().cloned().enumerate() {
                // Each worker gets two thirds of the records, so that most come to more than one, in an order
                // of its own.
                let mut mine: Vec<Sent> = all
                    .iter()
                    .enumerate()
                    .filter(|(k, _)| count == 1 || k % 3 != n % 3)
                    .map(|(_, sent)| sent.clone())
                    .collect();
                mine.shuffle(&mut rand_chacha::ChaCha8Rng::seed_from_u64(n as u64));
                let anew = (n == 0).then(|| after[0].clone());
                tasks.spawn(async move {
                    let middle = mine.len() / 2;
                    for (k, sent) in mine.iter().enumerate() {
                        if let Some(anew) = anew.as_ref().filter(|_| k == middle) {
                            worker.assets.update(anew, &Precondition::default()).await.unwrap();
                        }
                        send(&worker, sent).await;
                    }
                });
            }
            while let Some(done) = tasks.join_next().await {
                done.unwrap();
            }
            let stored: u64 = workers.iter().map(|worker| worker.tally.stored()).sum();
            assert_eq!(stored, all.len() as u64, "{count} workers");
            for (spec, (keys, expected)) in after.iter().zip(expected.as_ref().unwrap()) {
                settle(&workers[count - 1], &spec.id, keys).await;
                let found = everything(&workers[count - 1], &spec.id).await;
                assert_eq!(found.len(), expected.len(), "{count} workers");
                for (name, expected) in expected {
                    assert_eq!(found.get(name), Some(expected), "{name} of {count} workers");
                }
            }
            let libraries =
                (0..count).map(|n| files(&folder.path().join(format!("{n} of {count}/libraries"))));
            for found in libraries {
                assert!(found == files(&folder.path().join("libraries")), "{count} workers");
            }
            for worker in &workers {
                worker.store.close().await;
            }
        });
    }
}

/// Returns the files of a folder by name.
fn files(folder: &Path) -> BTreeMap<std::ffi::OsString, Vec<u8>> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    entries.map(|entry| (entry.file_name(), std::fs::read(entry.path()).unwrap())).collect()
}

/// Returns the announced alarm changes if every record reaches every worker concurrently.
async fn told_of(workers: &[Arc<Service>], all: &[Sent]) -> Vec<String> {
    let mut followers: Vec<_> = workers.iter().map(|worker| worker.events.follow()).collect();
    for sent in all {
        futures_util::future::join_all(workers.iter().map(|worker| send(worker, sent))).await;
    }
    let mut announced = Vec::new();
    for follower in &mut followers {
        while let Ok(announcement) = follower.try_recv() {
            if let LiveEvent::AlarmChanged(notice) = announcement {
                announced.push(format!("{} {:?}", notice.alarm.id, notice.change));
            }
        }
    }
    announced.sort_unstable();
    announced
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE"]
fn an_alarm_is_notified_once_by_any_worker() {
    let database = database();
    let folder = tempfile::tempdir().unwrap();
    let spec = asset("pump");
    let all = records(&spec.id, "1", 20);
    runtime().block_on(async {
        let alone = worker(&folder.path().join("alone").as_path().into(), folder.path()).await;
        alone.assets.create(&spec).await.unwrap();
        simulated(&alone, &spec).await;
        let expected = told_of(std::slice::from_ref(&alone), &all).await;
        assert!(expected.len() >= 6, "{expected:?}");
        let settings = StoreSettings::Shared(database.settings(folder.path()));
        let mut workers = Vec::new();
        for _ in 0..3 {
            workers.push(worker(&settings, folder.path()).await);
        }
        workers[0].assets.create(&spec).await.unwrap();
        for worker in &workers {
            simulated(worker, &spec).await;
        }
        assert_eq!(told_of(&workers, &all).await, expected);
        for worker in &workers {
            worker.store.close().await;
        }
    });
}

#[test]
fn a_history_is_recomputed_when_the_ensemble_is_complete() {
    let folder = tempfile::tempdir().unwrap();
    let spec = asset("pump");
    // More than the first ones.
    let neighbours = EnsembleSettings { members: FIRST_MEMBERS + 4 };
    runtime().block_on(async {
        let alone =
            worker_with(&folder.path().join("alone").as_path().into(), folder.path(), neighbours).await;
        alone.assets.create(&spec).await.unwrap();
        send(&alone, &records(&spec.id, "1", 1)[0]).await;
        let without = keys(&alone, &spec.id).await;
        for tries in 0.. {
            if keys(&alone, &spec.id).await != without {
                break;
            }
            assert!(tries < 3000, "nothing was folded again");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        alone.store.close().await;
    });
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE"]
fn a_worker_that_awaits_neighbours_leaves_a_history_that_was_made_with_them() {
    let database = database();
    let folder = tempfile::tempdir().unwrap();
    let spec = asset("pump");
    let all = records(&spec.id, "1", 13);
    let neighbours = |members| EnsembleSettings { members };
    runtime().block_on(async {
        let settings = StoreSettings::Shared(database.settings(folder.path()));
        let with = worker_with(&settings, &folder.path().join("with"), neighbours(FIRST_MEMBERS + 4)).await;
        with.assets.create(&spec).await.unwrap();
        simulated(&with, &spec).await;
        for sent in &all[..12] {
            send(&with, sent).await;
        }
        let made_with = keys(&with, &spec.id).await;
        // So many take this worker longer than the test does.
        let awaiting = worker_with(&settings, &folder.path().join("awaiting"), neighbours(5000)).await;
        send(&awaiting, &all[12]).await;
        awaiting.assets.refresh(&spec.id).await.unwrap();
        with.assets.refresh(&spec.id).await.unwrap();
        settle(&with, &spec.id, &made_with).await;
        tokio::time::sleep(Duration::from_millis(500)).await;
        assert_eq!(keys(&with, &spec.id).await, made_with);
        assert!(
            awaiting.history.recomputations(None).is_empty(),
            "{:?}",
            awaiting.history.recomputations(None)
        );
        for worker in [with, awaiting] {
            worker.store.close().await;
        }
    });
}

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
            let given_up =
                workers.iter().map(|worker| worker.store.delete_oldest_raw(Some(&spec.id), quota, 256));
            let given_up = futures_util::future::join_all(given_up).await;
            assert_eq!(given_up.iter().filter(|one| one.as_ref().unwrap().objects > 0).count(), 1);
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
