use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use super::*;
use crate::asset::{AssetSpec, Segment};
use crate::estimate::{MaintenanceEvent, MaintenanceKind};
use crate::library::{EnsembleSettings, GridSettings};
use crate::recording::{BlockEncoding, encode_block};
use crate::service::{
    Accepted, Precondition, RecordFormat, Role, ServiceFolders, SystemClock, UploadMetadata, WorkLimits,
};
use crate::signal::Record;
use crate::store::{Asset, SegmentFilter, Store, StoreSettings, Tombstone, back_up, restore_backup};

const QUARANTINED_FOR: Duration = Duration::from_secs(3600);

fn spec(machine: &str) -> AssetSpec {
    let text = serde_json::json!({
        "id": "pump",
        "location": { "machine": machine },
        "gear": { "teeth": [31, 62], "shaft_speed_hz": 10.0 },
        "sensor": { "unit": "m/s2" },
    });
    serde_json::from_value(text).unwrap()
}

fn pump() -> AssetId {
    AssetId::new("pump").unwrap()
}

fn event(minute: i64, kind: MaintenanceKind) -> MaintenanceEvent {
    MaintenanceEvent {
        time: time(minute),
        kind,
        by: "Ada".to_owned(),
        comment: String::new(),
        inspection: None,
        until: None,
    }
}

fn time(minute: i64) -> Timestamp {
    Timestamp::from_second(1_600_000_000 + 60 * minute).unwrap()
}

/// A service that takes fewer records at once than a rebuild ingests, and fewer bytes than one has.
async fn service_on(folder: &Path) -> Arc<Service> {
    let settings = StoreSettings::Folder(folder.to_path_buf());
    let store = Store::open_to_rebuild(&settings).await.unwrap();
    let limits = WorkLimits {
        workers: 1,
        simulation_threads: 1,
        requests_at_once: 2,
        bytes_at_once: 4096,
        ensemble: EnsembleSettings::described_alone(),
        ..WorkLimits::default()
    };
    let folders = ServiceFolders::in_data_folder(folder);
    let clock = Arc::new(SystemClock);
    Service::new(store, folders, &limits, GridSettings::default(), clock, Role::Standalone).unwrap()
}

async fn upload(service: &Service, minute: i64) -> Segment {
    let samples = (0..2000).map(|k| ((k * (minute + 3)) as f32).sin()).collect();
    let record = Record::new("1", time(minute), 4000.0, "m/s2", samples).unwrap();
    let bytes = encode_block(&record, BlockEncoding::Protobuf).into();
    let ticket = service.workers.admit().unwrap();
    let (pump, metadata) = (pump(), UploadMetadata::default());
    let accepted = service.pipeline.accept(&pump, RecordFormat::Protobuf, bytes, metadata, ticket);
    match accepted.await.unwrap().remove(0) {
        Accepted::Stored(segment) => *segment,
        other => panic!("{other:?}"),
    }
}

/// What users entered: the asset, its events, and its records with their exclusions.
type Entered = ((AssetSpec, Timestamp, Timestamp), Vec<MaintenanceEvent>, Vec<(SegmentId, bool)>);

async fn entered(service: &Service) -> Entered {
    let store = &service.store;
    let Asset { spec, created_at, updated_at, .. } = store.asset(&pump()).await.unwrap();
    let segments = store.segments(&pump(), &SegmentFilter::default(), 100).await.unwrap();
    let mut records: Vec<_> = segments.into_iter().map(|segment| (segment.id, segment.excluded)).collect();
    records.sort_unstable();
    ((spec, created_at, updated_at), store.maintenance(&pump()).await.unwrap(), records)
}

fn lose_database(folder: &Path) {
    for name in ["flankwatch.db", "flankwatch.db-wal", "flankwatch.db-shm"] {
        let _ = std::fs::remove_file(folder.join(name));
    }
}

#[tokio::test]
async fn a_restored_database_gets_what_users_entered_since_the_backup() {
    let place = tempfile::tempdir().unwrap();
    let (folder, copy) = (place.path().join("data"), place.path().join("copy"));
    let service = service_on(&folder).await;
    service.assets.create(&spec("old")).await.unwrap();
    service.maintenance.add(&pump(), event(0, MaintenanceKind::GearReplaced)).await.unwrap();
    let mut segments = Vec::new();
    for minute in 1..5 {
        segments.push(upload(&service, minute).await);
    }
    back_up(&folder, &copy, QUARANTINED_FOR).await.unwrap();

    service.assets.update(&spec("new"), &Precondition::default()).await.unwrap();
    service.maintenance.add(&pump(), event(2, MaintenanceKind::SensorReplaced)).await.unwrap();
    service.exclusions.set_one(&segments[1], true).await.unwrap();
    service.removals.remove_one(&segments[2]).await.unwrap();
    service.removals.remove_one(&segments[3]).await.unwrap();
    // Sent again after its removal.
    upload(&service, 4).await;
    upload(&service, 5).await;
    let expected = entered(&service).await;
    service.store.close().await;

    lose_database(&folder);
    restore_backup(&copy, &folder).await.unwrap();
    let service = service_on(&folder).await;
    assert!(service.store.removal_hold().is_some(), "the database is older");
    let rebuilt = service.rebuild(false, |_, _| {}).await.unwrap();
    assert_eq!(entered(&service).await, expected);
    let counts = (rebuilt.assets, rebuilt.updated, rebuilt.records, rebuilt.removed_again);
    assert_eq!((counts, rebuilt.failed), ((0, 1, 1, 1), 0), "{rebuilt:?}");
    let audit = service.store.audit(true, Duration::ZERO).await.unwrap();
    assert!(audit.findings.is_empty(), "{:?}", audit.findings);
    let again = service.rebuild(false, |_, _| {}).await.unwrap();
    assert_eq!((again.updated, again.records, again.removed_again), (0, 0, 0), "{again:?}");
    assert_eq!(entered(&service).await, expected);
    service.store.close().await;
}

#[tokio::test]
async fn an_interrupted_rebuild_is_completed_by_a_repeat() {
    let place = tempfile::tempdir().unwrap();
    let service = service_on(place.path()).await;
    service.assets.create(&spec("old")).await.unwrap();
    service.assets.update(&spec("new"), &Precondition::default()).await.unwrap();
    service.maintenance.add(&pump(), event(2, MaintenanceKind::SensorReplaced)).await.unwrap();
    for minute in 1..13 {
        let segment = upload(&service, minute).await;
        if minute == 1 {
            service.exclusions.set_one(&segment, true).await.unwrap();
        }
    }
    let expected = entered(&service).await;
    service.store.close().await;

    lose_database(place.path());
    let service = service_on(place.path()).await;
    // Stopped after the asset and before its events, and after some records and before the exclusions.
    let metadata = service.store.objects().asset_metadata(&pump()).unwrap().unwrap();
    service.store.insert_asset(&metadata.spec, None, metadata.created_at).await.unwrap();
    let missing = service.missing_records(&mut HashMap::new(), &mut Rebuilt::default()).await.unwrap();
    for metadata in missing.into_iter().take(3) {
        let record = QueuedRecord { metadata, asset_created_at: expected.0.1, dead_letters: 0 };
        service.ingest(&record).await.unwrap();
    }
    assert_ne!(entered(&service).await, expected);
    let rebuilt = service.rebuild(false, |_, _| {}).await.unwrap();
    assert_eq!((rebuilt.known, rebuilt.records, rebuilt.failed), (3, 9, 0), "{rebuilt:?}");
    assert_eq!(entered(&service).await, expected);
    service.store.close().await;
}

#[tokio::test]
async fn a_record_whose_removal_failed_is_not_removed_by_a_rebuild() {
    let place = tempfile::tempdir().unwrap();
    let service = service_on(place.path()).await;
    service.assets.create(&spec("old")).await.unwrap();
    let segments = [upload(&service, 1).await.id, upload(&service, 2).await.id];
    let tombstone =
        |n: usize| Tombstone { removed_at: Timestamp::now(), segments: vec![segments[n].clone()] };
    service.store.objects().put_tombstone(&tombstone(0)).unwrap();
    // The database is that of the recordings.
    let rebuilt = service.rebuild(false, |_, _| {}).await.unwrap();
    assert_eq!((rebuilt.known, rebuilt.removed_again), (2, 0), "{rebuilt:?}");
    service.sweep().await.unwrap();
    assert_eq!(service.store.objects().tombstones().unwrap(), []);
    service.store.close().await;

    lose_database(place.path());
    let service = service_on(place.path()).await;
    service.store.objects().put_tombstone(&tombstone(1)).unwrap();
    let rebuilt = service.rebuild(false, |_, _| {}).await.unwrap();
    assert_eq!((rebuilt.records, rebuilt.removed), (1, 1), "{rebuilt:?}");
    service.store.close().await;
}

#[tokio::test]
async fn the_note_of_a_deleted_asset_is_removed_unless_removals_are_suspended() {
    let place = tempfile::tempdir().unwrap();
    let service = service_on(place.path()).await;
    service.assets.create(&spec("old")).await.unwrap();
    let metadata = service.store.objects().asset_metadata(&pump()).unwrap().unwrap();
    // As if the process had been killed before it removed its metadata.
    let mark = service.store.descriptions_mark().await.unwrap();
    service.store.delete_asset(&pump(), mark).await.unwrap();
    service.sweep().await.unwrap();
    assert_eq!(service.store.objects().asset_metadata(&pump()).unwrap(), None);
    service.store.objects().put_asset_metadata(&metadata).unwrap();
    service.store.close().await;

    lose_database(place.path());
    let service = service_on(place.path()).await;
    service.sweep().await.unwrap();
    assert_eq!(service.store.objects().asset_metadata(&pump()).unwrap(), Some(metadata));
    service.store.close().await;
}
