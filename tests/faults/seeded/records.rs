//! Single records of a schedule, which are sent, repeated, deleted and excluded.

use std::collections::BTreeMap;
use std::sync::Arc;

use bytes::Bytes;
use flankwatch::asset::{AssetId, Segment, SegmentId};
use flankwatch::recording::{BlockEncoding, encode_block};
use flankwatch::service::{Accepted, RecordFormat, Service, ServiceError, UploadMetadata};
use flankwatch::store::{Objects, RecordRange};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use tokio::task::JoinSet;

use super::life::Life;
use crate::running::{plain_asset, record};

pub(super) const ASSETS: [&str; 2] = ["pump", "fan"];

/// Number of records per asset of a schedule.
const RECORDS: usize = 8;

/// The records that schedules send, with the names of their objects.
pub(super) struct SentRecords(Vec<(Bytes, String)>);

impl SentRecords {
    pub(super) fn new() -> Self {
        let records = (0..RECORDS as u32).map(|n| {
            let bytes = Bytes::from(encode_block(&record("1", n), BlockEncoding::Protobuf));
            let name = Objects::name(&bytes);
            (bytes, name)
        });
        Self(records.collect())
    }

    /// The descriptions of the assets.
    pub(super) fn assets(&self) -> impl Iterator<Item = Value> {
        ASSETS.into_iter().map(plain_asset)
    }
}

/// The last response about a record.
#[derive(Debug, Clone, Default)]
struct Known {
    presence: Presence,
    id: Option<SegmentId>,
    is_excluded: Option<bool>,
    /// Whether its deletion was acknowledged, and it was not sent again.
    is_deleted: bool,
}

#[derive(Debug, Clone, Copy, Default, PartialEq)]
enum Presence {
    #[default]
    Absent,
    Present,
    /// The last response was an error, or there was none.
    Unknown,
}

#[derive(Debug, Clone, Copy)]
enum Change {
    Upload,
    Delete,
    Exclude(bool),
}

type Key = (&'static str, usize);

/// What is known about each record.
pub(super) struct KnownRecords<'a> {
    sent: &'a SentRecords,
    all: BTreeMap<Key, Known>,
}

impl<'a> KnownRecords<'a> {
    pub(super) fn new(sent: &'a SentRecords) -> Self {
        Self { sent, all: BTreeMap::new() }
    }

    /// Compares the stored records with the responses.
    pub(super) fn check(&mut self, life: &Life) {
        for asset in ASSETS {
            let stored = life.stored(asset);
            for n in 0..RECORDS {
                let known = self.all.entry((asset, n)).or_default();
                check_record(life, &self.sent.0[n], &stored, known);
            }
            assert!(stored.len() <= RECORDS, "{asset}: more than was sent");
        }
    }

    /// Compares the records of a database that was built anew with the responses. A deletion that was not
    /// acknowledged may be lost with the database.
    pub(super) fn check_rebuilt(&self, life: &Life) {
        for asset in ASSETS {
            let stored = life.stored(asset);
            for n in 0..RECORDS {
                let Some(known) = self.all.get(&(asset, n)) else { continue };
                let found = stored.iter().find(|segment| segment.raw.sha256 == self.sent.0[n].1);
                match known.presence {
                    Presence::Present => {
                        let found = found.unwrap_or_else(|| panic!("record {n} of {asset} is not rebuilt"));
                        assert_eq!(
                            (Some(&found.id), Some(found.excluded)),
                            (known.id.as_ref(), known.is_excluded)
                        );
                    }
                    _ if known.is_deleted => assert!(found.is_none(), "record {n} of {asset} was deleted"),
                    _ => {}
                }
            }
        }
    }

    /// Applies changes of different records concurrently, as far as the disk allows.
    pub(super) fn make(&mut self, life: &Life, random: &mut ChaCha8Rng) {
        let changes = some_changes(random);
        let mut answers = Vec::new();
        life.block_on(async {
            let mut under_way = JoinSet::new();
            for (&key, &change) in &changes {
                let (service, (bytes, name)) = (Arc::clone(life.service()), self.sent.0[key.1].clone());
                under_way.spawn(async move { (key, make(&service, key.0, change, bytes, name).await) });
            }
            while let Some(ended) = life.disk.unless_stopped(under_way.join_next()).await.flatten() {
                // A response after the disk has stopped does not count.
                if life.disk.is_stopped() {
                    break;
                }
                answers.push(ended.unwrap());
            }
        });
        for (key, change) in &changes {
            if !answers.iter().any(|(answered, _)| answered == key) {
                learn(self.all.entry(*key).or_default(), *change, None);
            }
        }
        for (key, answer) in answers {
            learn(self.all.entry(key).or_default(), changes[&key], answer.ok());
        }
    }
}

fn check_record(life: &Life, (sent, name): &(Bytes, String), stored: &[Segment], known: &mut Known) {
    let found: Vec<&Segment> = stored.iter().filter(|segment| segment.raw.sha256 == *name).collect();
    assert!(found.len() <= 1, "record {name} is there {} times", found.len());
    match known.presence {
        Presence::Present => assert_eq!(found.len(), 1, "record {name} was acknowledged"),
        Presence::Absent => assert!(found.is_empty(), "record {name} was deleted, or never sent"),
        Presence::Unknown => {}
    }
    let Some(segment) = found.first() else {
        *known = Known { is_deleted: known.is_deleted, ..Known::default() };
        return;
    };
    assert_eq!(life.service().store.objects().get(name).unwrap(), *sent, "the bits of record {name}");
    if known.presence == Presence::Present {
        assert!(known.id.as_ref().is_none_or(|id| *id == segment.id), "record {name} has another name");
        let is_as_said = known.is_excluded.is_none_or(|is_excluded| is_excluded == segment.excluded);
        assert!(is_as_said, "record {name} is excluded: {}", segment.excluded);
    }
    // From here on the record is acknowledged.
    *known = Known {
        is_deleted: false,
        presence: Presence::Present,
        id: Some(segment.id.clone()),
        is_excluded: Some(segment.excluded),
    };
}

async fn make(
    service: &Arc<Service>,
    asset: &str,
    change: Change,
    bytes: Bytes,
    name: String,
) -> Result<Option<SegmentId>, ServiceError> {
    let id = AssetId::new(asset).unwrap();
    let range = RecordRange { raw_sha256: Some(name), ..RecordRange::default() };
    match change {
        Change::Upload => {
            let ticket = service.workers.admit()?;
            let metadata = UploadMetadata::default();
            let accepted = service.pipeline.accept(&id, RecordFormat::Protobuf, bytes, metadata, ticket);
            Ok(accepted.await?.into_iter().next().map(|accepted| match accepted {
                Accepted::Stored(segment) | Accepted::Repeated(segment) => segment.id,
                Accepted::Queued(_) => panic!("there is no queue"),
            }))
        }
        Change::Delete => service.removals.remove_each(&id, &[range]).await.map(|_| None),
        Change::Exclude(is_excluded) => {
            service.exclusions.set_each(&id, &[range], is_excluded).await.map(|_| None)
        }
    }
}

/// Records what a response proves; `None` if it was an error or was not received.
fn learn(known: &mut Known, change: Change, answer: Option<Option<SegmentId>>) {
    known.is_deleted &= !matches!(change, Change::Upload);
    match (change, answer) {
        (Change::Upload, Some(id)) => {
            if known.presence == Presence::Present {
                assert!(known.id.is_none() || known.id == id, "a repeat has another name: {known:?} {id:?}");
            } else {
                known.is_excluded = (known.presence == Presence::Absent).then_some(false);
            }
            (known.presence, known.id) = (Presence::Present, id);
        }
        (Change::Delete, Some(_)) => {
            // Nothing may have been there to delete: then a refused upload may have left its metadata file.
            let is_deleted = known.is_deleted || known.presence == Presence::Present;
            *known = Known { is_deleted, ..Known::default() };
        }
        (Change::Exclude(is_excluded), Some(_)) => known.is_excluded = Some(is_excluded),
        // A repeat of a stored record changes nothing.
        (Change::Upload, None) if known.presence == Presence::Present => {}
        (Change::Upload | Change::Delete, None) => known.presence = Presence::Unknown,
        (Change::Exclude(_), None) => known.is_excluded = None,
    }
}

/// Draws different records, each with an operation.
fn some_changes(random: &mut ChaCha8Rng) -> BTreeMap<Key, Change> {
    let mut changes = BTreeMap::new();
    for _ in 0..random.random_range(1..=4) {
        let key = (ASSETS[random.random_range(0..ASSETS.len())], random.random_range(0..RECORDS));
        let change = match random.random_range(0..10) {
            0..=6 => Change::Upload,
            7 => Change::Delete,
            _ => Change::Exclude(random.random_bool(0.6)),
        };
        changes.insert(key, change);
    }
    changes
}
