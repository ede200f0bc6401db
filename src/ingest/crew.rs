//! Several processes on one store: some take records and hand them over, others analyse, fold and commit them.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;

use bytes::Bytes;
use jiff::Timestamp;
use serde::Serialize;

use super::accept::{Accepted, Named};
use super::hearing::Hearers;
use super::recall::decode_again;
use super::{Ingest, IngestError};
use crate::asset::{AssetId, AssetSpec, RawReference, Segment, SegmentId};
use crate::recording::RecordDefaults;
use crate::signal::OperatingPoint;
use crate::store::{Asset, StoreError};

/// What a member of the crew answers later.
pub type Later<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

/// A record that is decoded, named and kept raw, and is still to be analysed: all that it takes besides its raw bytes.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct QueuedRecord {
    /// Identifier of the segment that it becomes.
    pub id: SegmentId,
    /// The asset it belongs to.
    pub asset_id: AssetId,
    /// When that asset was made: one of the same name that is made later is another.
    #[serde(skip)]
    pub asset_created_at: Timestamp,
    /// The measuring channel.
    pub channel: String,
    /// The time of the first sample.
    pub start_time: Timestamp,
    /// When the service took it.
    pub received_at: Timestamp,
    /// Unit of the samples.
    pub unit: String,
    /// Operating point as given with the record.
    pub operating_point: OperatingPoint,
    /// Wear depth in µm known from elsewhere.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference_wear_um: Option<f64>,
    /// Where the raw bytes are.
    pub raw: RawReference,
    /// How often it was given up lately as one that cannot be stored: sent again it is another one to the queue.
    #[serde(skip)]
    pub given_up: u32,
}

/// What became of a record that was handed over.
#[derive(Debug)]
pub enum TakenOver {
    /// It is stored, now.
    Stored(Box<Segment>),
    /// It was stored before.
    Repeated,
    /// Its asset was removed since.
    AssetGone,
}

/// How a part that the service needs is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PartHealth {
    /// Which part.
    pub part: &'static str,
    /// Why it cannot be used; none where it can.
    pub fault: Option<String>,
}

/// What joins the processes on one store.
pub trait Crew: Send + Sync + 'static {
    /// Hands records over to the workers; they are safe once this returns without an error.
    ///
    /// Error: [`IngestError::Busy`] where they cannot be taken now.
    fn hand_over<'a>(&'a self, records: &'a [QueuedRecord]) -> Later<'a, Result<(), IngestError>>;

    /// Tells the workers that an asset's description or what happened to it changed. Where the word is lost they find out by themselves later.
    fn tell_of(&self, asset: &AssetId);

    /// Whether what joins the processes works.
    fn health(&self) -> Later<'_, Vec<PartHealth>>;
}

/// What a process does of a record's path.
#[derive(Clone, Default)]
pub enum Part {
    /// All of it, alone on its store.
    #[default]
    Whole,
    /// Takes records and hands them over.
    Entrance(Arc<dyn Crew>),
    /// Analyses, folds and commits what was handed over, and computes histories again.
    Worker(Arc<dyn Crew>),
}

impl Part {
    /// What joins this process with others; none where it is alone.
    pub fn crew(&self) -> Option<&Arc<dyn Crew>> {
        match self {
            Self::Whole => None,
            Self::Entrance(crew) | Self::Worker(crew) => Some(crew),
        }
    }
}

impl QueuedRecord {
    fn new(asset: &Asset, named: &Named, received_at: Timestamp, given_up: u32) -> Self {
        let record = &named.record;
        Self {
            id: named.id.clone(),
            asset_id: asset.spec.id.clone(),
            asset_created_at: asset.created_at,
            channel: record.channel().to_owned(),
            start_time: record.start_time(),
            received_at,
            unit: record.unit().to_owned(),
            operating_point: record.operating_point(),
            reference_wear_um: named.reference_wear_um,
            raw: named.raw.clone(),
            given_up,
        }
    }
}

impl Ingest {
    /// What joins this process with others; none where it is alone.
    pub fn crew(&self) -> Option<&Arc<dyn Crew>> {
        self.inner.part.crew()
    }

    /// Whether records are handed over here.
    pub(super) fn is_entrance(&self) -> bool {
        matches!(self.inner.part, Part::Entrance(_))
    }

    /// Keeps the raw bytes of named records, and says what there is to hand over.
    pub(super) async fn keep_for_others(
        &self,
        asset: &Asset,
        named: &[Named],
        raws: Vec<(String, Bytes)>,
        received_at: Timestamp,
    ) -> Result<Vec<QueuedRecord>, IngestError> {
        self.keep_raw(raws).await?;
        let ids: Vec<SegmentId> = named.iter().map(|named| named.id.clone()).collect();
        let given_up = self.inner.store.dead_letters_of(&ids).await?;
        let queued = named.iter().map(|named| {
            let times = given_up.get(&named.id).copied().unwrap_or(0);
            QueuedRecord::new(asset, named, received_at, times)
        });
        Ok(queued.collect())
    }

    /// Hands over the records of one upload that are not among those stored, and answers for all in their order.
    pub(super) async fn hand_over(
        &self,
        crew: &Arc<dyn Crew>,
        asset: &Asset,
        mut named: Vec<Named>,
        bytes: Bytes,
        known: Vec<Segment>,
        received_at: Timestamp,
    ) -> Result<Vec<Accepted>, IngestError> {
        named.retain(|named| !known.iter().any(|segment| segment.id == named.id));
        let name = named.first().map(|named| named.raw.sha256.clone()).unwrap_or_default();
        let queued = self.keep_for_others(asset, &named, vec![(name, bytes)], received_at).await?;
        crew.hand_over(&queued).await?;
        self.count_queued(queued.len());
        self.count(0, known.len(), 0);
        let mut accepted: Vec<Accepted> = known.into_iter().map(|segment| Accepted::Stored(Box::new(segment))).collect();
        accepted.extend(queued.into_iter().map(|record| Accepted::Queued(Box::new(record))));
        accepted.sort_by_key(Accepted::channel_index);
        Ok(accepted)
    }

    /// Analyses, folds and stores a record that another process took. The answer comes once everything is committed; a repeat changes
    /// nothing.
    ///
    /// Errors: those of the store, which may pass; [`IngestError::Busy`] while the asset's library is simulated; a record whose raw bytes are
    /// damaged, or are not the record that was handed over, will never do.
    pub async fn take_over(&self, record: &QueuedRecord) -> Result<TakenOver, IngestError> {
        let Hearers { asset, listeners } = match self.hearers(&record.asset_id).await {
            Ok(hearers) if hearers.asset.created_at == record.asset_created_at => hearers,
            Ok(_) | Err(IngestError::Store(StoreError::AssetUnknown(_))) => return Ok(TakenOver::AssetGone),
            Err(error) => return Err(error),
        };
        let stored = self.inner.store.segments_by_id(std::slice::from_ref(&record.id)).await?;
        if !stored.is_empty() && listeners.is_empty() {
            self.count(0, 1, 0);
            return Ok(TakenOver::Repeated);
        }
        self.libraries_are_there(&asset.spec, &listeners).await?;
        let named = self.name_again(asset.spec.clone(), record.clone()).await?;
        if !listeners.is_empty() && !self.known_to_all(&[&named], &listeners).await?.is_empty() {
            self.count(0, 1, 0);
            return Ok(TakenOver::Repeated);
        }
        let kept = self.analyse_kept(asset.spec, vec![named], record.received_at).await?;
        let stored = match self.store_kept(kept).await {
            Err(IngestError::Store(StoreError::AssetUnknown(_))) => return Ok(TakenOver::AssetGone),
            stored => stored?.pop(),
        };
        match stored {
            Some(stored) if !stored.repeated => {
                self.count(1, 0, 0);
                Ok(TakenOver::Stored(Box::new(stored.segment)))
            }
            _ => {
                self.count(0, 1, 0);
                Ok(TakenOver::Repeated)
            }
        }
    }

    /// Says that a record was given up, as the `letter`th of the queue; said again of the same one it changes nothing.
    pub async fn count_given_up(&self, record: &QueuedRecord, letter: u64) -> Result<(), IngestError> {
        let letter = i64::try_from(letter).unwrap_or(i64::MAX);
        let now = self.inner.clock.now();
        Ok(self.inner.store.count_dead_letter(&record.id, letter, now).await?)
    }

    async fn name_again(&self, spec: AssetSpec, record: QueuedRecord) -> Result<Named, IngestError> {
        let bytes = self.raw_bytes(&record.raw).await?;
        let name = move || {
            let defaults = RecordDefaults {
                channel: Some(record.channel.clone()),
                start_time: record.start_time,
                unit: Some(record.unit),
                operating_point: record.operating_point,
                ..RecordDefaults::default()
            };
            let read = decode_again(&bytes, &record.raw, &defaults)?.with_channel(record.channel);
            let named = Named::new(&spec.id, read, record.raw, record.reference_wear_um)?;
            if named.id == record.id {
                Ok(named)
            } else {
                Err(IngestError::HandedOverOtherwise {
                    found: named.id,
                    expected: record.id,
                })
            }
        };
        self.inner.workers.run("read a record", name).await?
    }

    /// Brings an asset's history up to what is asked for now, and starts its library, in the background; for a worker that is told of the asset.
    pub async fn look_at(&self, asset: &AssetId) -> Result<(), IngestError> {
        match self.inner.store.asset(asset).await {
            Ok(asset) => {
                self.inner.libraries.prepare(&asset.spec);
                if asset.spec.sensor.of.is_some() {
                    self.catch_up_in_background(vec![asset.spec.id.clone()]);
                }
                self.recompute_in_background(vec![asset.spec.id]);
                Ok(())
            }
            Err(StoreError::AssetUnknown(asset)) => {
                self.inner.channels.forget(&asset);
                self.forget_recomputations(&asset);
                Ok(())
            }
            Err(error) => Err(error.into()),
        }
    }
}
