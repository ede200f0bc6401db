//! Backfill: analyses the records of a shared sensor that one of its assets lacks because it was created
//! later, or because a process ended in between.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::Duration;

use super::clock::Clock;
use super::error::ServiceError;
use super::failure_cause::FailureCause;
use super::pipeline::Pipeline;
use super::raw::RawObjects;
use super::record::{IdentifiedRecord, StoredRecord};
use super::sensor_group::described;
use super::work_queue::Role;
use super::workers::Workers;
use crate::asset::{AssetId, Segment, SegmentId};
use crate::signal::MAX_RECORD_SAMPLES;
use crate::store::{ChannelSummary, SegmentFilter, SegmentKey, Store, StoreError};

/// Maximum number of records analysed in one batch.
const RECORDS_PER_BATCH: u32 = 32;

/// Time after which a failed backfill is tried again.
const RETRY_AFTER: Duration = Duration::from_secs(60);

/// Analyses earlier records for assets that share another one's sensor.
pub(crate) struct Backfill {
    pub(crate) store: Store,
    pub(crate) workers: Arc<Workers>,
    pub(crate) pipeline: Arc<Pipeline>,
    pub(crate) raw: Arc<RawObjects>,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) role: Role,
    /// Held during a backfill.
    pub(crate) running: tokio::sync::Mutex<()>,
}

impl Backfill {
    /// Analyses, in the background, the records that these members of a sensor group lack. Does nothing on an
    /// API node, where workers are notified of the assets instead.
    pub(crate) fn in_background(self: &Arc<Self>, mut members: Vec<AssetId>) {
        if members.is_empty() || self.role.is_api_node() {
            return;
        }
        let backfill = Arc::clone(self);
        tokio::spawn(async move {
            loop {
                members = backfill.assets(members).await;
                // On a shared store the upkeep tries again.
                if members.is_empty() || backfill.store.is_shared() {
                    return;
                }
                tokio::time::sleep(RETRY_AFTER).await;
                if backfill.store.is_closed() {
                    return;
                }
            }
        });
    }

    /// Analyses the records that these assets lack; returns the assets to be tried again.
    async fn assets(&self, members: Vec<AssetId>) -> Vec<AssetId> {
        let _running = self.running.lock().await;
        let mut failed = Vec::new();
        for member in members {
            match self.asset(&member).await {
                Ok(0) | Err(ServiceError::Store(StoreError::AssetUnknown(_))) => {}
                Ok(records) => {
                    tracing::info!(asset = %member, records, "analysed earlier records of a shared sensor");
                }
                Err(error) => {
                    tracing::warn!(asset = %member, %error, "failed to analyse earlier records of a shared sensor");
                    if error.cause() == FailureCause::External {
                        failed.push(member);
                    }
                }
            }
        }
        failed
    }

    /// Whether a backfill is running.
    pub(crate) fn is_busy(&self) -> bool {
        self.running.try_lock().is_err()
    }

    async fn asset(&self, member: &AssetId) -> Result<usize, ServiceError> {
        let Some(of) = self.store.asset(member).await?.spec.sensor.of else {
            return Ok(0);
        };
        let mut records = 0;
        for channel in self.store.channels(&of).await? {
            let own = self.store.channel(member, &channel.channel).await?;
            // A member has only records of its sensor, so an equal number means that it has all.
            if own.is_none_or(|own| own.segments < channel.segments) {
                records += self.channel(member, &channel).await?;
            }
        }
        self.store.mark_backfilled(member, &of).await?;
        Ok(records)
    }

    async fn channel(&self, member: &AssetId, channel: &ChannelSummary) -> Result<usize, ServiceError> {
        let mut filter = SegmentFilter { channel: Some(channel.channel.clone()), ..SegmentFilter::default() };
        let mut records = 0;
        loop {
            let segments = self.store.segments(&channel.asset_id, &filter, RECORDS_PER_BATCH).await?;
            let Some(last) = segments.last() else {
                return Ok(records);
            };
            filter.after = Some(SegmentKey { start_time: last.start_time, id: last.id.clone() });
            let mut segments = self.missing(member, segments).await?;
            while !segments.is_empty() {
                let rest = segments.split_off(held_at_once(&segments));
                let spec = described(&self.store, member).await?.spec;
                let _uncommitted = self.raw.uncommitted(Vec::new()).await;
                let (store, id) = (self.store.clone(), member.clone());
                let samples = segments.iter().map(samples_of).sum();
                let read = move || {
                    let records = segments.iter().filter_map(|segment| record_for(&store, &id, segment));
                    records.collect::<Result<Vec<_>, _>>()
                };
                let again = self.workers.run_analysis("read records", samples, read).await??;
                records += self.pipeline.analyse_for_member(spec, again, self.clock.now()).await?;
                segments = rest;
            }
        }
    }

    /// Returns the segments of its sensor that an asset lacks.
    async fn missing(
        &self,
        member: &AssetId,
        mut segments: Vec<Segment>,
    ) -> Result<Vec<Segment>, ServiceError> {
        let own_id =
            |segment: &Segment| SegmentId::derive(member, &segment.channel, segment.start_time, &segment.raw);
        let ids: Vec<SegmentId> = segments.iter().map(own_id).collect();
        let known = self.store.segments_by_id(&ids).await?;
        let known: HashSet<&SegmentId> = known.iter().map(|segment| &segment.id).collect();
        segments.retain(|segment| !known.contains(&own_id(segment)));
        Ok(segments)
    }
}

fn samples_of(segment: &Segment) -> usize {
    usize::try_from(segment.samples).unwrap_or(usize::MAX)
}

/// Number of the first segments whose records are held in memory together: they have at most as many samples
/// as the largest record may have.
fn held_at_once(segments: &[Segment]) -> usize {
    let mut samples = 0_usize;
    let held = segments.iter().take_while(|segment| {
        samples = samples.saturating_add(samples_of(segment));
        samples <= MAX_RECORD_SAMPLES
    });
    held.count().max(1)
}

/// Reads a stored record for another asset of its sensor; returns `None` if its raw bytes are lost.
fn record_for(
    store: &Store,
    member: &AssetId,
    segment: &Segment,
) -> Option<Result<IdentifiedRecord, ServiceError>> {
    match StoredRecord::from(segment).read(store) {
        Ok(record) => {
            Some(Ok(IdentifiedRecord::of_stored(member, record, segment.raw.clone(), segment.excluded)))
        }
        Err(error) if error.is_record_lost() => {
            tracing::debug!(segment = %segment.id, %error, "failed to read a record for another asset of its sensor");
            None
        }
        Err(error) => Some(Err(error)),
    }
}
