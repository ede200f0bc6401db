//! The steps that process a record, the same for an upload, a recording of many records, a replay and the
//! work queue:
//!
//! ```text
//! decode ─▶ identify ─▶ store raw ┬▶ fold ─▶ commit ─▶ publish
//!                       analyse ──┘
//! ```
//!
//! | step | source |
//! | --- | --- |
//! | decode | `record/decode.rs`; for recordings `recording::McapReader` and `recording::RecordingFile` |
//! | identify, and find repeated records | `record/identify.rs` |
//! | store raw | `raw/objects.rs` |
//! | analyse | `record/analyse.rs` |
//! | fold | `history/append.rs`, called by the commit under its locks |
//! | commit | `commit.rs` |
//! | publish | `events.rs`, called by the commit once everything is durable |
//!
//! `read_ahead.rs` runs the readers of recordings on a thread of their own, and passes on batches of records.
//!
//! The calls for the record of an upload, in their order:
//!
//! ```text
//! Pipeline::accept                       as a task that outlives the request
//!  Pipeline::take_upload                 reads SensorGroup and ChannelUnits; decodes and identifies;
//!                                        finds stored records (known_to_all, check_repeat)
//!   Pipeline::begin                      omits these
//!    Pipeline::analyse                   analyse_all while RawObjects::put stores the raw bytes
//!   Pipeline::finish                     counts the outcomes
//!    Pipeline::commit                    commits, then ends the protection of the raw bytes
//!     Pipeline::commit_segments          analyses again if the description has changed
//!      Committer::commit                 waits for the lock, then commits for all that wait
//!       Committer::commit_jobs           if all fail together, commits each job separately
//!        Committer::commit_with_retries  commits again after a conflict with another process
//!         Committer::commit_together     locks the channels and opens the transaction
//!          History::append               folds the records into their channel
//!          Committer::write              writes the rows and ends the transaction
//!           History::committed           updates the channel in memory
//!          EventSender::send_segment     sends the event
//!     Pipeline::analyse_for_group        the same for the other assets of the sensor
//! ```
//!
//! On an API node `begin` stores the raw bytes and `finish` puts the record into the work queue. On a worker,
//! `process` continues with the analysis.

mod commit;
mod read_ahead;
mod recording;
mod summary;

use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use jiff::Timestamp;

use super::clock::Clock;
use super::error::ServiceError;
use super::raw::{RawObjects, UncommittedObjects};
use super::record::{
    ChannelUnits, IdentifiedRecord, RecordFormat, StoredRecord, UploadMetadata, analyse_all, check_repeat,
    check_time, decode_upload, identify_upload, known_to_all, raw_bytes, with_unit,
};
use super::record_counts::{RecordCounts, RecordOutcome};
use super::sensor_group::{SensorGroup, described};
use super::simulations::Simulations;
use super::work_queue::{QueuedRecord, Role, WorkQueue};
use super::workers::{Ticket, Workers, detached};
use crate::asset::{AssetId, AssetSpec, Segment, SegmentId};
use crate::store::{NewSegment, RecordMetadata, Store, StoreError};
use commit::CommittedSegment;
pub(crate) use commit::{CommitQueue, Committer};
pub(crate) use read_ahead::{ReadBatch, RecordStream};
pub(crate) use recording::RecordedBatch;
pub use summary::{BatchSummary, Refused};

/// Maximum number of times that a record is analysed because its asset's description or the unit of its
/// channel changes in the meantime.
const MAX_TRIES: u32 = 5;

/// The outcome of an accepted record.
#[derive(Debug)]
pub enum Accepted {
    /// It is newly stored.
    Stored(Box<Segment>),
    /// It was stored before.
    Repeated(Box<Segment>),
    /// Its raw bytes are stored, and it is queued for its analysis.
    Queued(Box<RecordMetadata>),
}

impl Accepted {
    fn segment(&self) -> Option<&Segment> {
        match self {
            Self::Stored(segment) | Self::Repeated(segment) => Some(segment),
            Self::Queued(_) => None,
        }
    }

    fn channel_index(&self) -> u32 {
        match self {
            Self::Stored(segment) | Self::Repeated(segment) => segment.raw.channel_index,
            Self::Queued(record) => record.raw.channel_index,
        }
    }
}

/// Runs records through all steps.
pub struct Pipeline {
    pub(crate) store: Store,
    pub(crate) workers: Arc<Workers>,
    pub(crate) simulations: Arc<Simulations>,
    pub(crate) raw: Arc<RawObjects>,
    pub(crate) committer: Arc<Committer>,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) role: Role,
    pub(crate) record_counts: Arc<RecordCounts>,
    /// How far a record's time may be ahead of the clock.
    pub(crate) start_time_ahead: Duration,
}

/// Records whose raw bytes are durable: those stored before, and those that are still to be committed or
/// queued.
pub(crate) struct Batch {
    known: Vec<Segment>,
    next: NextStep,
}

/// The remaining step for records that were not stored before.
enum NextStep {
    Nothing,
    Commit(Box<AnalysedBatch>),
    Enqueue(Arc<dyn WorkQueue>, Vec<QueuedRecord>),
}

/// Records that are analysed and whose raw bytes are durable.
struct AnalysedBatch {
    spec: AssetSpec,
    records: Arc<Vec<IdentifiedRecord>>,
    segments: Vec<NewSegment>,
    received_at: Timestamp,
    raw: UncommittedObjects,
}

/// Raw bytes to be stored, by their names, with the metadata needed to decode their records; empty if they
/// are stored already.
#[derive(Default)]
struct NewRawBytes {
    objects: Vec<(String, Bytes)>,
    metadata: Vec<RecordMetadata>,
}

impl Pipeline {
    /// Accepts the bytes of one record (or of one recording of several channels), and returns once everything
    /// is durable; on an API node, once the raw bytes are stored and the record is queued.
    ///
    /// Returns the outcome of each channel, in the order of the channels; for a repeated record, the stored
    /// segment.
    pub async fn accept(
        self: &Arc<Self>,
        asset: &AssetId,
        format: RecordFormat,
        bytes: Bytes,
        metadata: UploadMetadata,
        ticket: Ticket,
    ) -> Result<Vec<Accepted>, ServiceError> {
        let (pipeline, asset) = (Arc::clone(self), asset.clone());
        let upload = async move {
            let _ticket = ticket;
            let take = || pipeline.take_upload(&asset, format, bytes.clone(), metadata.clone());
            let accepted = retry_in_chosen_unit(take).await;
            if matches!(accepted, Err(ServiceError::Recording(_) | ServiceError::Field { .. })) {
                pipeline.record_counts.count(RecordOutcome::Refused, 1);
            }
            accepted
        };
        detached("accept a record", upload).await?
    }

    async fn take_upload(
        &self,
        asset: &AssetId,
        format: RecordFormat,
        bytes: Bytes,
        metadata: UploadMetadata,
    ) -> Result<Vec<Accepted>, ServiceError> {
        let group = SensorGroup::load(&self.store, asset).await?;
        let received_at = self.clock.now();
        let (units, latest) =
            (ChannelUnits::load(&self.store, &group.asset.spec).await?, self.latest(received_at));
        let records = {
            let (spec, bytes) = (group.asset.spec.clone(), bytes.clone());
            let decode_and_identify = move || {
                let records = decode_upload(&spec, &units, format, &bytes, &metadata, received_at)?;
                records.iter().try_for_each(|record| check_time(record.start_time(), latest))?;
                identify_upload(&spec.id, units, format, &bytes, records, metadata.reference_wear_um)
            };
            self.workers.run("decode a record", decode_and_identify).await??
        };
        let name = records.first().map(|record| record.raw.sha256.clone()).unwrap_or_default();
        let stored = known_to_all(&self.store, &records, &group.members).await?;
        for stored in &stored {
            let mut repeats = records.iter().filter(|record| record.id == stored.id);
            repeats.try_for_each(|record| check_repeat(record, stored))?;
        }
        let batch = self.begin(group, records.clone(), stored, vec![(name, bytes)], received_at).await?;
        let mut accepted = self.finish(batch).await?;
        // The same bytes with other values may have been committed meanwhile.
        for record in &records {
            let mut segments = accepted.iter().filter_map(Accepted::segment);
            segments.find(|segment| segment.id == record.id).map_or(Ok(()), |it| check_repeat(record, it))?;
        }
        accepted.sort_by_key(Accepted::channel_index);
        Ok(accepted)
    }

    /// The latest start time that is accepted for a record received at a given time.
    pub(crate) fn latest(&self, received_at: Timestamp) -> Timestamp {
        received_at.saturating_add(self.start_time_ahead).unwrap_or(Timestamp::MAX)
    }

    /// Processes a queued record from the analysis on; returns `None` if its asset was deleted. A repeated
    /// record changes nothing.
    ///
    /// # Errors
    /// Those of the store, which may be temporary; permanent ones if the raw bytes are damaged or are not
    /// those of the queued record.
    pub async fn process(
        self: &Arc<Self>,
        record: &QueuedRecord,
        ticket: Ticket,
    ) -> Result<Option<Accepted>, ServiceError> {
        let (pipeline, record) = (Arc::clone(self), record.clone());
        let work = async move {
            let _ticket = ticket;
            match retry_in_chosen_unit(|| pipeline.take_queued(&record)).await {
                Err(ServiceError::Store(StoreError::AssetUnknown(_))) => Ok(None),
                accepted => accepted,
            }
        };
        detached("store a record", work).await?
    }

    async fn take_queued(&self, queued: &QueuedRecord) -> Result<Option<Accepted>, ServiceError> {
        let metadata = &queued.metadata;
        let group = SensorGroup::load(&self.store, &metadata.asset_id).await?;
        if group.asset.created_at != queued.asset_created_at {
            return Ok(None);
        }
        let known = known_to_all(&self.store, std::slice::from_ref(metadata), &group.members).await?;
        let next = if known.is_empty() {
            let units = ChannelUnits::load(&self.store, &group.asset.spec).await?;
            let record = self.identify_queued(metadata.clone(), units).await?;
            self.analyse(group.asset.spec, vec![record], NewRawBytes::default(), metadata.received_at).await?
        } else {
            NextStep::Nothing
        };
        Ok(self.finish(Batch { known, next }).await?.pop())
    }

    /// Runs all steps up to the commit on the records that are not among the `stored` ones; may run
    /// concurrently with the commit of the previous records.
    async fn begin(
        &self,
        group: SensorGroup,
        mut records: Vec<IdentifiedRecord>,
        stored: Vec<Segment>,
        mut raws: Vec<(String, Bytes)>,
        received_at: Timestamp,
    ) -> Result<Batch, ServiceError> {
        let stored: HashMap<&SegmentId, &Segment> =
            stored.iter().map(|segment| (&segment.id, segment)).collect();
        let known: Vec<Segment> = records
            .iter()
            .filter_map(|record| stored.get(&record.id))
            .map(|segment| Segment::clone(segment))
            .collect();
        if !known.is_empty() {
            self.raw.repair(&known, &raws).await?;
        }
        records.retain(|record| !stored.contains_key(&record.id));
        let names: HashSet<&str> = records.iter().map(|record| record.raw.sha256.as_str()).collect();
        raws.retain(|(name, _)| names.contains(name.as_str()));
        let next = if records.is_empty() {
            NextStep::Nothing
        } else if let Role::ApiNode(queue) = &self.role {
            let queued = self.queued(&group, &records, received_at).await?;
            self.raw.put(raws, queued.iter().map(|queued| queued.metadata.clone()).collect()).await?;
            NextStep::Enqueue(Arc::clone(queue), queued)
        } else {
            let metadata = records.iter().map(|record| record.metadata(&group.asset.spec.id, received_at));
            let new = NewRawBytes { objects: raws, metadata: metadata.collect() };
            self.analyse(group.asset.spec, records, new, received_at).await?
        };
        Ok(Batch { known, next })
    }

    /// Analyses records while their raw bytes are stored.
    async fn analyse(
        &self,
        spec: AssetSpec,
        records: Vec<IdentifiedRecord>,
        new: NewRawBytes,
        received_at: Timestamp,
    ) -> Result<NextStep, ServiceError> {
        let raw = self.raw.uncommitted(new.objects.iter().map(|(name, _)| name.clone()).collect()).await;
        let objects = Arc::clone(&self.raw);
        let put = tokio::spawn(async move {
            if new.objects.is_empty() { Ok(()) } else { objects.put(new.objects, new.metadata).await }
        });
        let records = Arc::new(records);
        let segments = analyse_all(&self.workers, &spec, &records, received_at).await;
        put.await.map_err(|_| ServiceError::WorkerLost("store raw bytes"))??;
        Ok(NextStep::Commit(Box::new(AnalysedBatch { spec, records, segments: segments?, received_at, raw })))
    }

    /// Runs the last steps: the commit with its fold and events, or the queue. Returns the outcomes in
    /// the order of the records, those stored before first.
    async fn finish(&self, batch: Batch) -> Result<Vec<Accepted>, ServiceError> {
        let mut accepted: Vec<Accepted> =
            batch.known.into_iter().map(|segment| Accepted::Repeated(Box::new(segment))).collect();
        match batch.next {
            NextStep::Nothing => {}
            NextStep::Commit(analysed) => accepted.extend(self.commit(*analysed).await?),
            NextStep::Enqueue(queue, records) => {
                queue.enqueue(&records).await?;
                accepted
                    .extend(records.into_iter().map(|record| Accepted::Queued(Box::new(record.metadata))));
            }
        }
        for accepted in &accepted {
            let outcome = match accepted {
                Accepted::Stored(_) => RecordOutcome::Stored,
                Accepted::Repeated(_) => RecordOutcome::Repeated,
                Accepted::Queued(_) => RecordOutcome::Queued,
            };
            self.record_counts.count(outcome, 1);
        }
        Ok(accepted)
    }

    async fn commit(
        &self,
        batch: AnalysedBatch,
    ) -> Result<impl Iterator<Item = Accepted> + use<>, ServiceError> {
        let AnalysedBatch { spec, records, segments, received_at, mut raw } = batch;
        let asset = spec.id.clone();
        let committed = self.commit_segments(spec, &records, segments, received_at).await?;
        raw.are_committed();
        if committed.iter().any(|committed| committed.shares_sensor) {
            self.analyse_for_group(&asset, &records, received_at).await?;
        }
        let accepted = |CommittedSegment { segment, repeated, .. }| match repeated {
            false => Accepted::Stored(Box::new(segment)),
            true => Accepted::Repeated(Box::new(segment)),
        };
        Ok(committed.into_iter().map(accepted))
    }

    /// Commits segments, also if their library is not ready yet. If the asset's description changed in the
    /// meantime, they are analysed again.
    async fn commit_segments(
        &self,
        mut spec: AssetSpec,
        records: &Arc<Vec<IdentifiedRecord>>,
        mut segments: Vec<NewSegment>,
        received_at: Timestamp,
    ) -> Result<Vec<CommittedSegment>, ServiceError> {
        let mut tries = 1;
        loop {
            self.simulations.wait_until_loaded(&spec).await;
            match self.committer.commit(&spec.id, segments).await {
                Err(ServiceError::DescriptionChanged(_)) if tries < MAX_TRIES => tries += 1,
                done => return done,
            }
            spec = described(&self.store, &spec.id).await?.spec;
            segments = analyse_all(&self.workers, &spec, records, received_at).await?;
        }
    }

    /// Analyses records of an asset for the other assets of its sensor. These are read after the records are
    /// stored, so that an asset created concurrently either is among them or finds the records stored. The
    /// caller holds the records' [`UncommittedObjects`].
    async fn analyse_for_group(
        &self,
        asset: &AssetId,
        records: &[IdentifiedRecord],
        received_at: Timestamp,
    ) -> Result<(), ServiceError> {
        for member in SensorGroup::load(&self.store, asset).await?.members {
            let theirs = records.iter().map(|record| record.for_member(&member)).collect();
            self.analyse_for_member(member, theirs, received_at).await?;
        }
        Ok(())
    }

    /// Stores the records that an asset sharing another one's sensor does not have yet; returns their number.
    /// The caller holds their [`UncommittedObjects`].
    pub(crate) async fn analyse_for_member(
        &self,
        member: AssetSpec,
        mut records: Vec<IdentifiedRecord>,
        received_at: Timestamp,
    ) -> Result<usize, ServiceError> {
        let known = known_to_all(&self.store, &records, &[]).await?;
        records.retain(|record| !known.iter().any(|segment| segment.id == record.id));
        if records.is_empty() {
            return Ok(0);
        }
        let records = Arc::new(records);
        let segments = analyse_all(&self.workers, &member, &records, received_at).await?;
        Ok(self.commit_segments(member, &records, segments, received_at).await?.len())
    }

    /// Converts records to queued records.
    async fn queued(
        &self,
        group: &SensorGroup,
        records: &[IdentifiedRecord],
        received_at: Timestamp,
    ) -> Result<Vec<QueuedRecord>, ServiceError> {
        let ids: Vec<SegmentId> = records.iter().map(|record| record.id.clone()).collect();
        let dead_letters = self.store.dead_letters_of(&ids).await?;
        let queued = records.iter().map(|record| QueuedRecord {
            metadata: record.metadata(&group.asset.spec.id, received_at),
            asset_created_at: group.asset.created_at,
            dead_letters: dead_letters.get(&record.id).copied().unwrap_or(0),
        });
        Ok(queued.collect())
    }

    /// Reads a queued record from its raw bytes. The unit of its channel may be known only since it was
    /// queued.
    async fn identify_queued(
        &self,
        queued: RecordMetadata,
        units: ChannelUnits,
    ) -> Result<IdentifiedRecord, ServiceError> {
        let bytes = raw_bytes(&self.store, &queued.raw.sha256).await?;
        let identify = move || {
            let record = StoredRecord::from(&queued).decode(&bytes)?;
            let (record, original_unit) = units.convert(record)?;
            let mut identified =
                IdentifiedRecord::new(&queued.asset_id, record, queued.raw, queued.reference_wear_um)?;
            if identified.id == queued.id {
                // The identifier stays that of the queued record.
                identified.raw.media_type = with_unit(identified.raw.media_type, original_unit.as_deref());
                Ok(identified)
            } else {
                Err(ServiceError::QueuedRecordMismatch { found: identified.id, expected: queued.id })
            }
        };
        self.workers.run("read a record", identify).await?
    }
}

/// Takes a record, and again while the unit of its channel is chosen by another record at the same time.
async fn retry_in_chosen_unit<T, F>(mut take: impl FnMut() -> F) -> Result<T, ServiceError>
where
    F: Future<Output = Result<T, ServiceError>>,
{
    let mut tries = 1;
    loop {
        match take().await {
            Err(ServiceError::UnitChosen { .. }) if tries < MAX_TRIES => tries += 1,
            taken => return taken,
        }
    }
}
