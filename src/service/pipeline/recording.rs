//! Recordings of many records: read on a separate thread, and processed by the pipeline in batches.

use std::io::{self, BufReader, Read};
use std::sync::{Arc, Mutex, PoisonError};

use bytes::Bytes;
use rayon::prelude::*;
use tokio::sync::OwnedSemaphorePermit;

use super::read_ahead::{ReadBatch, RecordStream};
use super::summary::BatchSummary;
use super::{Accepted, Batch, Pipeline};
use crate::asset::AssetId;
use crate::recording::McapReader;
use crate::service::error::ServiceError;
use crate::service::record::{
    ChannelNames, ChannelUnits, check_time, defaults_of, identify_recorded, known_to_all,
};
use crate::service::record_counts::RecordOutcome;
use crate::service::sensor_group::SensorGroup;

/// A batch of a recording whose raw bytes are durable.
pub(crate) struct RecordedBatch {
    batch: Batch,
    summary: BatchSummary,
    /// The share of the recording's memory that its records take until they are stored.
    _memory: Option<OwnedSemaphorePermit>,
}

impl Pipeline {
    /// Accepts every record of an MCAP recording, read from the reader that `open` returns, with `names` for
    /// its channels; returns once everything is durable.
    ///
    /// An invalid record is listed in the summary and the others are accepted. An error is returned only if
    /// no record could be read, or if the service itself failed.
    pub async fn accept_recording<R: Read + Send + 'static>(
        &self,
        asset: &AssetId,
        names: ChannelNames,
        open: impl FnOnce() -> io::Result<R> + Send + 'static,
    ) -> Result<BatchSummary, ServiceError> {
        let _permit = self.workers.admit_recording()?;
        let spec = SensorGroup::load(&self.store, asset).await?.asset.spec;
        let units = ChannelUnits::load(&self.store, &spec).await?;
        let mut defaults = defaults_of(&spec, &units, self.clock.now());
        defaults.channel_units.extend(names.units(&units));
        let missing = Arc::new(Mutex::new(names.recorded()));
        let mut records = RecordStream::spawn(self.workers.recording_bytes(), {
            let missing = Arc::clone(&missing);
            move || {
                let reader = McapReader::with_defaults(BufReader::with_capacity(1 << 20, open()?), defaults);
                Ok(reader.map(move |recorded| {
                    let recorded = recorded?;
                    missing.lock().unwrap_or_else(PoisonError::into_inner).remove(recorded.record.channel());
                    Ok(names.applied_to(recorded))
                }))
            }
        });
        let mut summary = BatchSummary::default();
        let mut learned = ChannelUnits::default();
        let mut before: Option<RecordedBatch> = None;
        loop {
            // While one batch waits for the disk, the next one is analysed.
            let next = async {
                let mut batch = records.next_batch().await;
                let mut first = BatchSummary::default();
                if matches!(batch.records[..], [(0, Err(_))])
                    && let Some((number, Err(error))) = batch.records.pop()
                {
                    // Only an error: not a recording at all, unless records follow.
                    batch = records.next_batch().await;
                    if batch.records.is_empty() {
                        self.record_counts.count(RecordOutcome::Refused, 1);
                        return Err(error.into());
                    }
                    first.records = 1;
                    first.refuse(number, None, &error);
                }
                if batch.records.is_empty() {
                    return Ok(None);
                }
                let mut begun = self.begin_batch(asset, batch, &mut learned).await?;
                first.join(begun.summary);
                begun.summary = first;
                Ok::<_, ServiceError>(Some(begun))
            };
            let (next, stored) = tokio::join!(next, self.finish_batch(before.take(), &mut summary));
            stored?;
            before = next?;
            if before.is_none() {
                let missing = &mut *missing.lock().unwrap_or_else(PoisonError::into_inner);
                summary.missing_channels = std::mem::take(missing);
                return Ok(summary);
            }
        }
    }

    /// Runs all steps up to the commit for a batch of records of one recording; invalid ones are listed in
    /// its summary. `learned` has the units of channels from earlier batches, and gets those of this one.
    pub(crate) async fn begin_batch(
        &self,
        asset: &AssetId,
        read: ReadBatch,
        learned: &mut ChannelUnits,
    ) -> Result<RecordedBatch, ServiceError> {
        let ReadBatch { records, memory } = read;
        let group = SensorGroup::load(&self.store, asset).await?;
        let received_at = self.clock.now();
        let (mut units, latest) =
            (ChannelUnits::load(&self.store, &group.asset.spec).await?, self.latest(received_at));
        units.extend(learned);
        for (_, recorded) in &records {
            if let Ok(recorded) = recorded {
                units.learn_unit(&recorded.record);
            }
        }
        learned.clone_from(&units);
        let identified = {
            let asset = asset.clone();
            let identify = move || {
                let identify = |record| {
                    let identified = identify_recorded(&asset, &units, record)?;
                    let record = &identified.0.record;
                    match check_time(record.start_time(), latest) {
                        Ok(()) => Ok(identified),
                        Err(error) => Err((Some(record.channel().to_owned()), error)),
                    }
                };
                let identified = records.into_par_iter().map(|(n, record)| (n, identify(record)));
                identified.collect::<Vec<_>>()
            };
            self.workers.run("identify records", identify).await?
        };
        let mut summary = BatchSummary::default();
        let (mut records, mut raws) =
            (Vec::with_capacity(identified.len()), Vec::with_capacity(identified.len()));
        for (number, identified) in identified {
            summary.records += 1;
            match identified {
                Ok((record, raw)) => {
                    summary.add(&record.record);
                    raws.push((record.raw.sha256.clone(), Bytes::from(raw)));
                    records.push(record);
                }
                Err((channel, error)) => summary.refuse(number, channel.as_deref(), &error),
            }
        }
        let stored = known_to_all(&self.store, &records, &group.members).await?;
        let batch = self.begin(group, records, stored, raws, received_at).await?;
        Ok(RecordedBatch { batch, summary, _memory: memory })
    }

    /// Commits a batch, if there is one, in one transaction and adds its outcomes to `summary`.
    pub(crate) async fn finish_batch(
        &self,
        begun: Option<RecordedBatch>,
        summary: &mut BatchSummary,
    ) -> Result<(), ServiceError> {
        let Some(RecordedBatch { batch, summary: mut of_batch, _memory }) = begun else {
            return Ok(());
        };
        for accepted in self.finish(batch).await? {
            match accepted {
                Accepted::Stored(segment) => {
                    of_batch.stored += 1;
                    of_batch.take(&segment.id);
                }
                Accepted::Repeated(_) => of_batch.repeated += 1,
                Accepted::Queued(record) => {
                    of_batch.queued += 1;
                    of_batch.take(&record.id);
                }
            }
        }
        self.record_counts.count(RecordOutcome::Refused, of_batch.refused_count);
        summary.join(of_batch);
        Ok(())
    }
}
