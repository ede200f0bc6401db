//! Recordings of many records: read on a thread, processed and stored in batches.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use std::sync::Arc;

use bytes::Bytes;
use jiff::Timestamp;
use rayon::prelude::*;
use serde::Serialize;
use tokio::sync::OwnedSemaphorePermit;

use super::accept::{Kept, Named, RecordFormat, defaults_of};
use super::hearing::Hearers;
use super::read_ahead::{Batch, RecordStream};
use super::{Crew, Ingest, IngestError, Part, QueuedRecord};
use crate::asset::{AssetId, AssetSpec, RawReference};
use crate::recording::{McapReader, Recorded, RecordingError};
use crate::store::Objects;

/// Refused records that are listed by name; further ones are only counted.
const MOST_REFUSED_LISTED: usize = 1000;

/// A record of a recording that was not taken.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Refused {
    /// Which record of the recording, counted from 0.
    pub record: u64,
    /// Its channel, where it could be read so far.
    pub channel: Option<String>,
    /// Why not.
    pub reason: String,
}

/// What became of a recording.
#[derive(Debug, Clone, Default, PartialEq, Serialize, utoipa::ToSchema)]
pub struct BatchSummary {
    /// Records read.
    pub records: u64,
    /// Of these, stored now.
    pub stored: u64,
    /// Of these, handed over to be analysed; absent where they are analysed before the answer.
    #[serde(skip_serializing_if = "is_none")]
    pub queued: u64,
    /// Of these, stored before.
    pub repeated: u64,
    /// Those that were not taken.
    pub refused: Vec<Refused>,
    /// How many were not taken.
    pub refused_count: u64,
    /// The channels of those that were taken.
    pub channels: BTreeSet<String>,
    /// Start of the earliest record taken.
    pub first_start_time: Option<Timestamp>,
    /// Start of the latest record taken.
    pub last_start_time: Option<Timestamp>,
    /// Length of all records taken, in seconds.
    #[serde(skip)]
    pub record_seconds: f64,
}

fn is_none(queued: &u64) -> bool {
    *queued == 0
}

impl BatchSummary {
    pub(super) fn refuse(&mut self, record: u64, channel: Option<&str>, reason: &impl ToString) {
        self.refused_count += 1;
        if self.refused.len() < MOST_REFUSED_LISTED {
            self.refused.push(Refused {
                record,
                channel: channel.map(str::to_string),
                reason: reason.to_string(),
            });
        }
    }
}

impl Ingest {
    /// Takes every record of an MCAP file, and answers once everything is on the disk.
    ///
    /// A record that cannot be used is listed in the answer and the others are taken; an error is returned only where not one
    /// could be read, or where the service itself failed.
    pub async fn accept_mcap(&self, asset: &AssetId, path: &Path) -> Result<BatchSummary, IngestError> {
        let _turn = self.recording_turn()?;
        let spec = self.hearers(asset).await?.asset.spec;
        let defaults = defaults_of(&spec, self.inner.clock.now());
        let path = path.to_path_buf();
        let mut records = RecordStream::spawn(self.inner.workers.recording_bytes(), move || {
            let file = File::open(&path).map_err(RecordingError::from)?;
            Ok(McapReader::with_defaults(BufReader::with_capacity(1 << 20, file), defaults))
        });
        let mut summary = BatchSummary::default();
        let mut before: Option<KeptBatch<'_>> = None;
        loop {
            // While one batch waits for the disk, the next one is analysed.
            let next = async {
                let mut batch = records.next_batch().await;
                let mut first = BatchSummary::default();
                if matches!(batch.records[..], [(0, Err(_))])
                    && let Some((number, Err(error))) = batch.records.pop()
                {
                    // Nothing but one error: not a recording at all, unless something follows after all.
                    batch = records.next_batch().await;
                    if batch.records.is_empty() {
                        self.count(0, 0, 1);
                        return Err(error.into());
                    }
                    first.records = 1;
                    first.refuse(number, None, &error);
                }
                if batch.records.is_empty() {
                    return Ok(None);
                }
                let mut kept = self.keep_batch(asset, batch).await?;
                first.join(kept.summary);
                kept.summary = first;
                Ok::<_, IngestError>(Some(kept))
            };
            let (next, stored) = tokio::join!(next, self.store_batch(before.take(), &mut summary));
            stored?;
            before = next?;
            if before.is_none() {
                return Ok(summary);
            }
        }
    }

    /// The right to read one more whole recording.
    pub(super) fn recording_turn(&self) -> Result<tokio::sync::OwnedSemaphorePermit, IngestError> {
        Arc::clone(&self.inner.recordings)
            .try_acquire_owned()
            .map_err(|_| IngestError::Busy {
                what: "too many recordings are being read",
                retry_after_s: 5,
            })
    }

    /// Analyses a batch of records of one recording and keeps their raw bytes; those that are stored already are only counted.
    pub(super) async fn keep_batch(&self, asset: &AssetId, batch: Batch) -> Result<KeptBatch<'_>, IngestError> {
        let Batch { records, room } = batch;
        let Hearers { asset, listeners } = self.hearers(asset).await?;
        let received_at = self.inner.clock.now();
        let named = {
            let spec = asset.spec.clone();
            let name = move || {
                records
                    .into_par_iter()
                    .map(|(n, record)| (n, name(&spec, record)))
                    .collect::<Vec<_>>()
            };
            self.inner.workers.run("name records", name).await?
        };
        let mut summary = BatchSummary::default();
        let mut fresh: Vec<(Named, Vec<u8>)> = Vec::with_capacity(named.len());
        for (number, named) in named {
            summary.records += 1;
            match named {
                Ok(taken) => {
                    summary.add(&taken.0);
                    fresh.push(taken);
                }
                Err((channel, error)) => summary.refuse(number, channel.as_deref(), &error),
            }
        }
        let taken = fresh.len();
        let known = {
            let named: Vec<&Named> = fresh.iter().map(|(named, _)| named).collect();
            self.known_to_all(&named, &listeners).await?
        };
        fresh.retain(|(named, _)| !known.iter().any(|segment| segment.id == named.id));
        let mut kept = KeptRecords::None;
        if !fresh.is_empty() {
            let (named, raws): (Vec<Named>, Vec<_>) = fresh
                .into_iter()
                .map(|(named, raw)| {
                    let name = named.raw.sha256.clone();
                    (named, (name, Bytes::from(raw)))
                })
                .unzip();
            kept = if let Part::Entrance(crew) = &self.inner.part {
                let records = self.keep_for_others(&asset, &named, raws, received_at).await?;
                KeptRecords::ForOthers(crew, records)
            } else {
                self.libraries_are_there(&asset.spec, &listeners).await?;
                KeptRecords::Analysed(Box::new(self.analyse_and_keep(asset.spec, named, raws, received_at).await?))
            };
        }
        Ok(KeptBatch {
            kept,
            taken,
            summary,
            room,
        })
    }

    /// Stores a batch, where there is one, in one transaction and adds what became of its records to `summary`.
    pub(super) async fn store_batch(&self, batch: Option<KeptBatch<'_>>, summary: &mut BatchSummary) -> Result<(), IngestError> {
        let Some(KeptBatch {
            kept,
            taken,
            summary: mut of_batch,
            room: _until_stored,
        }) = batch
        else {
            return Ok(());
        };
        let (mut stored, mut queued) = (0, 0);
        match kept {
            KeptRecords::None => {}
            KeptRecords::Analysed(kept) => {
                let answer = self.store_kept(*kept).await?;
                stored = answer.iter().filter(|stored| !stored.repeated).count();
            }
            KeptRecords::ForOthers(crew, records) => {
                crew.hand_over(&records).await?;
                queued = records.len();
            }
        }
        let repeated = taken - stored - queued;
        of_batch.stored = stored as u64;
        of_batch.queued = queued as u64;
        of_batch.repeated = repeated as u64;
        self.count_queued(queued);
        self.count(stored, repeated, of_batch.refused_count as usize);
        summary.join(of_batch);
        Ok(())
    }
}

/// Records whose raw bytes are kept.
enum KeptRecords<'a> {
    /// There are none.
    None,
    /// They are analysed.
    Analysed(Box<Kept<'a>>),
    /// Others are to analyse them.
    ForOthers(&'a Arc<dyn Crew>, Vec<QueuedRecord>),
}

/// A batch whose raw bytes are on the disk.
pub(super) struct KeptBatch<'a> {
    /// Those that were not stored before.
    kept: KeptRecords<'a>,
    /// Records that can be used, those stored before among them.
    taken: usize,
    summary: BatchSummary,
    /// What they take of their recording's memory.
    room: Option<OwnedSemaphorePermit>,
}

impl BatchSummary {
    /// Adds what became of later records.
    fn join(&mut self, later: Self) {
        self.records += later.records;
        self.stored += later.stored;
        self.queued += later.queued;
        self.repeated += later.repeated;
        self.refused_count += later.refused_count;
        let room = MOST_REFUSED_LISTED.saturating_sub(self.refused.len());
        self.refused.extend(later.refused.into_iter().take(room));
        self.channels.extend(later.channels);
        self.first_start_time = self.first_start_time.into_iter().chain(later.first_start_time).min();
        self.last_start_time = self.last_start_time.max(later.last_start_time);
        self.record_seconds += later.record_seconds;
    }

    fn add(&mut self, named: &Named) {
        let record = &named.record;
        if !self.channels.contains(record.channel()) {
            self.channels.insert(record.channel().to_string());
        }
        let start = record.start_time();
        self.first_start_time = Some(self.first_start_time.map_or(start, |first| first.min(start)));
        self.last_start_time = Some(self.last_start_time.map_or(start, |last| last.max(start)));
        self.record_seconds += record.duration_s();
    }
}

/// A named record with its raw bytes, or its channel and why it is refused.
type NamedOrRefused = Result<(Named, Vec<u8>), (Option<String>, IngestError)>;

fn name(spec: &AssetSpec, record: Result<Recorded, RecordingError>) -> NamedOrRefused {
    let recorded = record.map_err(|error| (None, error.into()))?;
    let channel = recorded.record.channel().to_string();
    let raw = RawReference {
        sha256: Objects::name(&recorded.raw),
        bytes: recorded.raw.len() as u64,
        media_type: RecordFormat::of_block(recorded.encoding).media_type(),
        channel_index: 0,
    };
    match Named::new(&spec.id, recorded.record, raw, recorded.reference_wear_um) {
        Ok(named) => Ok((named, recorded.raw)),
        Err(error) => Err((Some(channel), error)),
    }
}
