//! Any number of workers on one database: the same records give the same bits as on one machine, in whatever
//! order and however often they are delivered.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use flankwatch::asset::AssetSpec;
use flankwatch::library::{EnsembleSettings, FIRST_MEMBERS};
use flankwatch::service::{LiveEvent, Precondition, RecordOutcome, Service};
use flankwatch::store::StoreSettings;
use rand::SeedableRng;
use rand::seq::SliceRandom;

use super::nodes::{database, runtime};
use super::workers::{
    Sent, asset, described_anew, everything, keys, records, send, settle, simulated, worker, worker_with,
};

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
            let stored: u64 =
                workers.iter().map(|worker| worker.record_counts.of(RecordOutcome::Stored)).sum();
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
async fn notices_of(workers: &[Arc<Service>], all: &[Sent]) -> Vec<String> {
    let mut subscribers: Vec<_> = workers.iter().map(|worker| worker.events.subscribe()).collect();
    for sent in all {
        futures_util::future::join_all(workers.iter().map(|worker| send(worker, sent))).await;
    }
    let mut announced = Vec::new();
    for subscriber in &mut subscribers {
        while let Ok(announcement) = subscriber.try_recv() {
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
        let expected = notices_of(std::slice::from_ref(&alone), &all).await;
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
        assert_eq!(notices_of(&workers, &all).await, expected);
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
    let ensemble = EnsembleSettings { members: FIRST_MEMBERS + 4 };
    runtime().block_on(async {
        let alone = worker_with(&folder.path().join("alone").as_path().into(), folder.path(), ensemble).await;
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
    let ensemble = |members| EnsembleSettings { members };
    runtime().block_on(async {
        let settings = StoreSettings::Shared(database.settings(folder.path()));
        let with = worker_with(&settings, &folder.path().join("with"), ensemble(FIRST_MEMBERS + 4)).await;
        with.assets.create(&spec).await.unwrap();
        simulated(&with, &spec).await;
        for sent in &all[..12] {
            send(&with, sent).await;
        }
        let made_with = keys(&with, &spec.id).await;
        // So many take this worker longer than the test does.
        let awaiting = worker_with(&settings, &folder.path().join("awaiting"), ensemble(5000)).await;
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
