use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::Duration;

use futures_util::future::BoxFuture;
use tokio::time::timeout;

use super::*;
use crate::asset::{AssetId, AssetSpec, RawReference, SegmentId};
use crate::service::{PartHealth, QueueOverview, QueuedRecord, WorkLimits, WorkQueue};
use crate::signal::OperatingPoint;
use crate::store::{Disk, SystemDisk};

const SHORT: Duration = Duration::from_millis(200);
const LONG: Duration = Duration::from_secs(20);

/// A disk whose first operation on a path with this text waits for a message.
#[derive(Debug)]
struct WaitingDisk {
    text: String,
    is_waiting: Arc<AtomicBool>,
    release: std::sync::Mutex<mpsc::Receiver<()>>,
}

impl WaitingDisk {
    fn new(text: &str) -> (Arc<Self>, mpsc::Sender<()>) {
        let (sender, receiver) = mpsc::channel();
        let release = std::sync::Mutex::new(receiver);
        (Arc::new(Self { text: text.to_owned(), is_waiting: Arc::default(), release }), sender)
    }

    fn pass(&self, path: &Path) {
        if path.to_string_lossy().contains(&self.text) && !self.is_waiting.swap(true, Ordering::SeqCst) {
            self.release.lock().unwrap().recv().unwrap();
        }
    }

    async fn wait_until_waiting(&self) {
        while !self.is_waiting.load(Ordering::SeqCst) {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }
}

impl Disk for WaitingDisk {
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.pass(to);
        SystemDisk.rename(from, to)
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        self.pass(path);
        SystemDisk.remove_file(path)
    }
}

/// A queue whose scan waits for a permit, and finds one object.
struct SlowQueue {
    scan: tokio::sync::Semaphore,
    found: String,
}

impl WorkQueue for SlowQueue {
    fn enqueue<'a>(&'a self, _: &'a [QueuedRecord]) -> BoxFuture<'a, Result<(), ServiceError>> {
        Box::pin(async { Ok(()) })
    }

    fn objects_waiting(&self) -> BoxFuture<'_, Result<HashSet<String>, ServiceError>> {
        Box::pin(async {
            self.scan.acquire().await.unwrap().forget();
            Ok(HashSet::from([self.found.clone()]))
        })
    }

    fn notify_changed(&self, _: &AssetId) {}

    fn overview(&self) -> BoxFuture<'_, Result<QueueOverview, ServiceError>> {
        Box::pin(async { Err(ServiceError::WorkerLost("read the queue")) })
    }

    fn health(&self) -> BoxFuture<'_, Vec<PartHealth>> {
        Box::pin(async { Vec::new() })
    }
}

async fn raw_objects(folder: &Path, disk: Arc<dyn Disk>, role: Role) -> Arc<RawObjects> {
    let store = Store::open_on(folder, disk).await.unwrap();
    let workers = Arc::new(Workers::new(&WorkLimits { workers: 2, ..WorkLimits::default() }).unwrap());
    Arc::new(RawObjects::new(store, workers, role, Duration::ZERO))
}

/// The metadata of a record with this object.
fn record_metadata(name: &str) -> RecordMetadata {
    RecordMetadata {
        id: SegmentId(name.to_owned()),
        asset_id: pump(),
        channel: "1".to_owned(),
        start_time: Timestamp::UNIX_EPOCH,
        received_at: Timestamp::UNIX_EPOCH,
        unit: "g".to_owned(),
        operating_point: OperatingPoint::default(),
        reference_wear_um: None,
        raw: RawReference {
            sha256: name.to_owned(),
            bytes: 3,
            media_type: "audio/wav".to_owned(),
            channel_index: 0,
        },
    }
}

fn object(bytes: &'static [u8]) -> (String, Bytes) {
    (Objects::name(bytes), Bytes::from_static(bytes))
}

fn pump() -> AssetId {
    AssetId::new("pump").unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn records_are_stored_while_the_queue_is_scanned() {
    let folder = tempfile::tempdir().unwrap();
    let (one, waiting) = (object(b"one"), object(b"waiting"));
    let queue = SlowQueue { scan: tokio::sync::Semaphore::new(0), found: waiting.0.clone() };
    let queue = Arc::new(queue);
    let role = Role::Worker(queue.clone());
    let raw = raw_objects(folder.path(), Arc::new(SystemDisk), role).await;
    raw.put(vec![one.clone(), waiting.clone()], Vec::new()).await.unwrap();
    let names = vec![one.0.clone(), waiting.0.clone()];
    let removing = tokio::spawn({
        let raw = Arc::clone(&raw);
        async move { raw.remove(names, &WaitingObjects::new()).await.unwrap() }
    });
    tokio::time::sleep(SHORT).await;
    drop(timeout(SHORT, raw.uncommitted(Vec::new())).await.unwrap());
    assert!(!removing.is_finished());
    queue.scan.add_permits(1);
    assert_eq!(removing.await.unwrap(), [one.0]);
    assert!(raw.store.objects().written_at(&waiting.0).unwrap().is_some());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_record_that_is_stored_again_keeps_its_note() {
    let folder = tempfile::tempdir().unwrap();
    let (name, bytes) = object(b"abc");
    let (disk, release) = WaitingDisk::new(&name);
    let raw = raw_objects(folder.path(), Arc::new(SystemDisk), Role::Standalone).await;
    raw.put(vec![(name.clone(), bytes.clone())], vec![record_metadata(&name)]).await.unwrap();
    raw.store.objects().remove(&name).unwrap();
    raw.store.close().await;
    drop(raw);

    let raw = raw_objects(folder.path(), disk.clone(), Role::Standalone).await;
    let sweep = tokio::spawn({
        let raw = Arc::clone(&raw);
        async move { raw.sweep().await.unwrap() }
    });
    disk.wait_until_waiting().await;
    let stored = tokio::spawn({
        let (raw, name) = (Arc::clone(&raw), name.clone());
        async move {
            let mut uncommitted = raw.uncommitted(vec![name.clone()]).await;
            raw.put(vec![(name.clone(), bytes)], vec![record_metadata(&name)]).await.unwrap();
            uncommitted.are_committed();
        }
    });
    tokio::time::sleep(SHORT).await;
    release.send(()).unwrap();
    timeout(LONG, sweep).await.unwrap().unwrap();
    timeout(LONG, stored).await.unwrap().unwrap();
    let shard = u8::from_str_radix(&name[..2], 16).unwrap();
    assert_eq!(raw.store.objects().record_metadata(shard).unwrap(), [record_metadata(&name)]);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_note_of_an_asset_has_its_latest_change() {
    let folder = tempfile::tempdir().unwrap();
    let (disk, release) = WaitingDisk::new("assets/");
    let raw = raw_objects(folder.path(), disk.clone(), Role::Standalone).await;
    let spec = |machine: &str| -> AssetSpec {
        let text = serde_json::json!({
            "id": "pump",
            "location": { "machine": machine },
            "gear": { "teeth": [31, 62], "shaft_speed_hz": 10.0 },
            "sensor": { "unit": "m/s2" },
        });
        serde_json::from_value(text).unwrap()
    };
    raw.store.insert_asset(&spec("one"), None, Timestamp::UNIX_EPOCH).await.unwrap();
    let write = || {
        let raw = Arc::clone(&raw);
        tokio::spawn(async move { raw.write_asset_metadata(&pump()).await.unwrap() })
    };
    let slow = write();
    disk.wait_until_waiting().await;
    raw.store.update_asset(&spec("two"), None, Timestamp::UNIX_EPOCH).await.unwrap();
    let later = write();
    tokio::time::sleep(SHORT).await;
    release.send(()).unwrap();
    timeout(LONG, slow).await.unwrap().unwrap();
    timeout(LONG, later).await.unwrap().unwrap();
    let written = raw.store.objects().asset_metadata(&pump()).unwrap().unwrap();
    assert_eq!(written.spec, spec("two"));
}
