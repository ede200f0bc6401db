//! Workers of one database inside the test's process, and the records that they get.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use flankwatch::asset::{AssetId, AssetSpec};
use flankwatch::library::{EnsembleSettings, GridSettings};
use flankwatch::recording::{BlockEncoding, encode_block};
use flankwatch::service::{
    Readiness, RecordFormat, Role, Service, ServiceFolders, UploadMetadata, WorkLimits,
};
use flankwatch::store::{AlarmFilter, SegmentFilter, Store, StoreSettings};
use jiff::Timestamp;
use serde_json::json;

use crate::running::{ManualClock, minute, record, samples};

/// The bytes of a record, with its asset.
pub(super) type Sent = (AssetId, Bytes);

pub(super) fn asset(id: &str) -> AssetSpec {
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
pub(super) fn described_anew(spec: &AssetSpec) -> AssetSpec {
    let mut spec = serde_json::to_value(spec).unwrap();
    spec["bands"] = json!([{ "name": "mesh", "band_hz": [200, 400] }]);
    serde_json::from_value(spec).unwrap()
}

pub(super) fn records(asset: &AssetId, channel: &str, count: u32) -> Vec<Sent> {
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

pub(super) async fn worker(settings: &StoreSettings, folder: &Path) -> Arc<Service> {
    worker_with(settings, folder, EnsembleSettings::described_alone()).await
}

pub(super) async fn worker_with(
    settings: &StoreSettings,
    folder: &Path,
    ensemble: EnsembleSettings,
) -> Arc<Service> {
    let store = Store::open(settings).await.unwrap();
    let folders = ServiceFolders {
        libraries: folder.join("libraries"),
        recordings: folder.join("recordings"),
        uploads: folder.join("uploads"),
        streams: folder.join("streams"),
    };
    let limits = WorkLimits { workers: 1, ensemble, ..WorkLimits::default() };
    let grid = GridSettings { states: 4, seconds: 0.25, ..GridSettings::default() };
    Service::new(store, folders, &limits, grid, Arc::new(ManualClock::default()), Role::Standalone).unwrap()
}

/// Waits until a worker has the complete ensemble of an asset.
pub(super) async fn simulated(worker: &Service, spec: &AssetSpec) {
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
pub(super) async fn send(worker: &Service, (asset, bytes): &Sent) {
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
pub(super) async fn settle(worker: &Service, asset: &AssetId, keys: &[String]) {
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

pub(super) async fn keys(worker: &Service, asset: &AssetId) -> Vec<String> {
    let channels = worker.store.channels(asset).await.unwrap();
    channels.iter().map(|channel| format!("{:?}", channel.keys)).collect()
}

/// Returns all values of all records, and the alarms.
pub(super) async fn everything(worker: &Service, asset: &AssetId) -> BTreeMap<String, String> {
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
